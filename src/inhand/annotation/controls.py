"""The controls of the labelling page: they say what the user wants, and show what is."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.annotation.angles import angles_of, rotation_of
from inhand.annotation.commands import NUDGES, Command, Nudge, groups, keys_table
from inhand.annotation.session import Array, Label
from inhand.geometry.se3 import transform
from inhand.hand import Hand
from inhand.kinematics import REVOLUTE
from inhand.object_model import ObjectModel

LAYERS = ("Cloud", "Hand", "Object")
"""What can be hidden in the 3D view."""
CENTRE, TURN = "Centre [mm]", "Turn [°]"
"""Names of the fields for the object's position and rotation."""
SHOWN = 0.002
"""How far a pose may be from what the fields show [mm, degree]: they show three decimals."""
STEPS = (1.0, 2.0)
"""Steps of the keys that move and turn the object [mm, degree]."""


def on_user(handle: Any, react: Callable[[], None]) -> None:
    """Call `react` when a user changes a value, but not when the program does."""
    handle.on_update(lambda event: react() if event.client_id is not None else None)


class CommandButtons:
    """Rows of buttons, and keys that do the same.

    Args:
        gui: `server.gui` of viser.
        act: called with the command that the user wants.
    """

    def __init__(self, gui: Any, act: Callable[[Command], None]) -> None:
        for group, commands in groups().items():
            self._add_row(gui, group, commands, act)
            for command in commands:
                for key in command.keys:
                    hotkey = gui.add_command(
                        f"{group}: {command.name}", hotkey=key.key, modifier=key.modifier
                    )
                    hotkey.on_trigger(lambda _, command=command: act(command))

    @staticmethod
    def _add_row(
        gui: Any, group: str, commands: Sequence[Command], act: Callable[[Command], None]
    ) -> None:
        by_name = {command.name: command for command in commands}
        hint = ", ".join(f"{c.name}: {c.meaning} ({c.keys[0]})" for c in commands)
        row = gui.add_button_group(group, tuple(by_name), hint=hint)
        row.on_click(lambda event: act(by_name[event.target.value]))


class ObjectControls:
    """Which object is in the hand, where its centre is, and how it is turned.

    Args:
        gui: `server.gui` of viser.
        names: names of the objects that may be in the hand.
        chosen: called with the name that the user chose.
        placed: called with the centre that the user typed [m], camera frame, shape (3,).
        turned: called with the rotation that the user typed, camera frame, shape (3, 3).
        nudged: called with a nudge and the sizes of the steps [mm, degree].
    """

    def __init__(
        self,
        gui: Any,
        names: Sequence[str],
        chosen: Callable[[str], None],
        placed: Callable[[Array], None],
        turned: Callable[[Array], None],
        nudged: Callable[[Nudge, float, float], None],
    ) -> None:
        with gui.add_folder("Object"):
            self._name = gui.add_dropdown("In the hand", tuple(names), visible=len(names) > 1)
            self._centre = gui.add_vector3(
                CENTRE, (0.0, 0.0, 0.0), step=0.1, hint="right, down, away from the camera"
            )
            self._angles = gui.add_vector3(
                TURN,
                (0.0, 0.0, 0.0),
                step=0.1,
                hint="about the camera's axes: first right, then down, then away",
            )
            self._shift, self._turn = (
                gui.add_number(label, value, min=0.01, max=100.0, step=0.01, hint="of the keys")
                for label, value in zip(("Step [mm]", "Step [°]"), STEPS, strict=True)
            )
        on_user(self._name, lambda: chosen(self._name.value))
        on_user(self._centre, lambda: placed(np.array(self._centre.value) / 1000))
        on_user(self._angles, lambda: turned(rotation_of(np.array(self._angles.value))))
        for nudge in NUDGES:
            key = gui.add_command(
                f"Object: {nudge.meaning}", hotkey=nudge.key.key, modifier=nudge.key.modifier
            )
            key.on_trigger(
                lambda _, nudge=nudge: nudged(nudge, self._shift.value, self._turn.value)
            )

    def show(self, label: Label, obj: ObjectModel, moving: str = "") -> None:
        """Show where an object is; the field that is typed into, by its name, stays untouched."""
        set_value(self._name, label.object_name)
        centre = 1000 * transform(label.T_camera_object, obj.centre[None])[0]
        if moving != CENTRE and np.abs(centre - self._centre.value).max() > SHOWN:
            self._centre.value = tuple(centre.round(3).tolist())
        # Other angles may be the same rotation: what the user typed then stays.
        rotation, typed = label.T_camera_object[:3, :3], np.array(self._angles.value)
        if moving != TURN and np.abs(rotation_of(typed) - rotation).max() > np.radians(SHOWN):
            self._angles.value = tuple(angles_of(rotation).round(3).tolist())


class JointControls:
    """A slider for every independent joint, in degrees or millimetres.

    Args:
        gui: `server.gui` of viser.
        hand: the hand.
        moved: called with a joint's name and its position [rad, m] when the user moved its slider.
    """

    def __init__(self, gui: Any, hand: Hand, moved: Callable[[str, float], None]) -> None:
        kinds = dict(zip(hand.all_joint_names, hand.chain.kind, strict=True))
        self._units: NDArray[np.float64] = np.array(
            [np.degrees(1) if kinds[n] == REVOLUTE else 1000.0 for n in hand.joint_names]
        )
        # Ends in steps of 0.1, within the limits.
        low = np.ceil(10 * self._units * hand.lower) / 10
        high = np.floor(10 * self._units * hand.upper) / 10
        self._sliders: dict[str, Any] = {}
        with gui.add_folder("Fingers"):
            for i, name in enumerate(hand.joint_names):
                unit = "°" if kinds[name] == REVOLUTE else "mm"
                self._sliders[name] = gui.add_slider(
                    f"{name} [{unit}]",
                    min=float(low[i]),
                    max=float(high[i]),
                    step=0.1,
                    initial_value=float(np.clip(0.0, low[i], high[i])),
                )
                on_user(self._sliders[name], lambda i=i, name=name: moved(name, self._position(i)))  # type: ignore[misc]

    def show(self, q: Array, moving: str = "") -> None:
        """Show where the joints are [rad, m], shape (n,); the slider of one stays untouched."""
        for name, value in zip(self._sliders, self._units * q, strict=True):
            if name != moving:
                slider = self._sliders[name]
                set_value(slider, float(np.clip(value, slider.min, slider.max)))

    def _position(self, index: int) -> float:
        return float(list(self._sliders.values())[index].value / self._units[index])


class LayerControls:
    """What is to be seen in the 3D view.

    Args:
        gui: `server.gui` of viser.
        changed: called when the user wants to see something else.
        look: called when the user wants to see what the depth camera sees.
    """

    def __init__(self, gui: Any, changed: Callable[[], None], look: Callable[[], None]) -> None:
        with gui.add_folder("Show"):
            self._boxes = {name: gui.add_checkbox(name, True) for name in LAYERS}
            gui.add_button("Look from the camera").on_click(lambda _: look())
        for box in self._boxes.values():
            on_user(box, changed)

    def hidden(self) -> tuple[bool, ...]:
        """Which of `LAYERS` are not to be seen."""
        return tuple(not box.value for box in self._boxes.values())


def add_keys(gui: Any) -> None:
    """A folder that lists all keys."""
    with gui.add_folder("Keys", expand_by_default=False):
        gui.add_markdown(
            keys_table() + "\n\nW, A, S, D, Q, E and the arrows move the view. Keys do nothing "
            "while a field is being typed into."
        )


def set_value(handle: Any, value: Any) -> None:
    """Show a value, if it is another than the one that is shown."""
    if handle.value != value:
        handle.value = value
