"""Sliders that move joints, object and wrist by hand, from where a stage has put them."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.geometry.se3 import Array, exp_so3, transform
from inhand.hand import Hand
from inhand.kinematics import REVOLUTE
from inhand.overlay import Placement
from inhand.viewer.controls import on_user

SHIFT = 30.0
"""How far the pose sliders move [mm]."""
TURN = 90.0
"""How far they turn [degree]."""
_AXES = ("x", "y", "z")
_ORIGIN = np.zeros(3)


def moved(T: Array, shift: Array, turn: Array, centre: Array) -> Array:
    """A pose, (4, 4), turned about a point of the body and shifted, along the camera's axes.

    Args:
        T: the pose in the camera.
        shift: translation [m], camera frame, shape (3,).
        turn: rotation vector [rad], camera frame, shape (3,).
        centre: the point [m], body frame, shape (3,).
    """
    middle = transform(T, centre[None])[0]
    out = np.eye(4)
    out[:3, :3] = exp_so3(turn) @ T[:3, :3]
    out[:3, 3] = middle + shift - out[:3, :3] @ centre
    return out


class PoseSliders:
    """Six sliders that move a body along, and turn it about, the camera's axes.

    Args:
        gui: `server.gui` of viser.
        changed: called when the user moved one.
    """

    def __init__(self, gui: Any, changed: Callable[[], None]) -> None:
        self._shift = [
            gui.add_slider(f"{a} [mm]", min=-SHIFT, max=SHIFT, step=0.1, initial_value=0.0)
            for a in _AXES
        ]
        self._turn = [
            gui.add_slider(f"turn {a} [°]", min=-TURN, max=TURN, step=0.5, initial_value=0.0)
            for a in _AXES
        ]
        for slider in (*self._shift, *self._turn):
            on_user(slider, changed)

    def reset(self, enabled: bool) -> None:
        """Put them back to zero."""
        for slider in (*self._shift, *self._turn):
            slider.value = 0.0
            slider.disabled = not enabled

    def applied(self, T: Array, centre: Array) -> Array:
        """A pose, (4, 4), moved by them, turned about a point of the body [m], shape (3,)."""
        shift = np.array([slider.value for slider in self._shift]) / 1000
        turn = np.radians([slider.value for slider in self._turn])
        return moved(T, shift, turn, centre)


class JointSliders:
    """A slider for every independent joint of a hand, in degrees or millimetres.

    Args:
        gui: `server.gui` of viser.
        hand: the hand.
        changed: called when the user moved one.
    """

    def __init__(self, gui: Any, hand: Hand, changed: Callable[[], None]) -> None:
        kinds = dict(zip(hand.all_joint_names, hand.chain.kind, strict=True))
        revolute = np.array([kinds[name] == REVOLUTE for name in hand.joint_names])
        self._rest = hand.rest
        self._per_unit: NDArray[np.float64] = np.where(revolute, np.degrees(1), 1000.0)
        low, high = self._per_unit * hand.lower, self._per_unit * hand.upper
        self._sliders = [
            gui.add_slider(
                f"{name} [{'°' if turns else 'mm'}]",
                min=float(low[i]),
                max=float(high[i]),
                step=0.1,
                initial_value=float(np.clip(0.0, low[i], high[i])),
            )
            for i, (name, turns) in enumerate(zip(hand.joint_names, revolute, strict=True))
        ]
        for slider in self._sliders:
            on_user(slider, changed)

    def reset(self, joint_vector: Array | None) -> None:
        """Put them where the joints are [rad, m], shape (n,), or to rest if that is unknown."""
        q = self._rest if joint_vector is None else joint_vector
        for slider, value in zip(self._sliders, self._per_unit * q, strict=True):
            slider.value = float(np.clip(value, slider.min, slider.max))
            slider.disabled = joint_vector is None

    def joint_vector(self) -> Array:
        """Positions of the independent joints [rad, m], shape (n,)."""
        return np.array([slider.value for slider in self._sliders]) / self._per_unit


class AdjustControls:
    """All sliders that move something.

    Args:
        gui: `server.gui` of viser.
        hand: the hand.
        changed: called when the user moved one.
    """

    def __init__(self, gui: Any, hand: Hand, changed: Callable[[], None]) -> None:
        self._changed = changed
        self.base = Placement()
        """Where hand and object were before a slider moved."""
        self._centre, self._touched = _ORIGIN, False
        with gui.add_folder("Try by hand", expand_by_default=False):
            gui.add_markdown("From the chosen pose, along the camera's axes: right, down, away.")
            with gui.add_folder("Object"):
                self._object = PoseSliders(gui, self._moved)
            with gui.add_folder("Joints"):
                self._joints = JointSliders(gui, hand, self._moved)
            with gui.add_folder("Wrist", expand_by_default=False):
                self._wrist = PoseSliders(gui, self._moved)
            gui.add_button("Put back").on_click(lambda _: self._put_back())

    def start_from(self, base: Placement, centre: Array) -> None:
        """Put the sliders to where hand and object are.

        Args:
            base: where they are.
            centre: the point that the object is turned about [m], object frame, shape (3,).
        """
        self.base, self._centre, self._touched = base, centre, False
        self._object.reset(base.T_camera_object is not None)
        self._wrist.reset(base.T_camera_hand is not None)
        self._joints.reset(base.joint_vector)

    def placement(self) -> Placement:
        """Where hand and object are by the sliders; exactly where they started if none moved."""
        placed = self.base
        if not self._touched:
            return placed
        if placed.T_camera_object is not None:
            T = self._object.applied(placed.T_camera_object, self._centre)
            placed = replace(placed, T_camera_object=T)
        if placed.T_camera_hand is not None and placed.joint_vector is not None:
            T, q = self._wrist.applied(placed.T_camera_hand, _ORIGIN), self._joints.joint_vector()
            placed = replace(placed, T_camera_hand=T, joint_vector=q)
        return placed

    def _moved(self) -> None:
        self._touched = True
        self._changed()

    def _put_back(self) -> None:
        self.start_from(self.base, self._centre)
        self._changed()
