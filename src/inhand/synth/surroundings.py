"""What a hand is seen in: random light, and what stands behind it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.geometry import se3
from inhand.hand import Hand
from inhand.synth.renderer import CLUTTER_SHAPES, Props

Array = NDArray[np.float64]

DEEPEST = 0.4
"""How far behind the hand's reach clutter may stand [m]."""
TILT = float(np.radians(12))
"""Sd of a wall's tilt about either axis [rad]."""


class Surroundings(NamedTuple):
    """What a hand is seen in."""

    lamp: Array
    """Unit direction to the lamp, camera frame, shape (3,)."""
    props: Props
    """What else stands there."""


class SurroundingsMaker:
    """Makes random surroundings.

    Args:
        hand: the hand.
        camera: the camera.
        diameters: diameters of the solids that may stand there, by number [m].
        clutter: how many of them do.
        backdrop: range of the distance of a wall from the hand's reach [m]; None: there is none.
    """

    def __init__(
        self,
        hand: Hand,
        camera: Camera,
        diameters: Sequence[float],
        clutter: int,
        backdrop: tuple[float, float] | None,
    ) -> None:
        self._reach, self._camera, self._diameters = hand.reach, camera, diameters
        self._clutter, self._backdrop = clutter, backdrop

    def make(self, T_camera_hand: Array, rng: np.random.Generator) -> Surroundings:
        """Random light, and a wall and clutter behind a hand at a wrist pose, (4, 4)."""
        lamp = se3.random_rotation(rng)[2]
        lamp[2] = -abs(lamp[2])  # on the camera's side
        return Surroundings(lamp, self._behind(T_camera_hand, rng))

    def _behind(self, T_camera_hand: Array, rng: np.random.Generator) -> Props:
        centre = se3.transform(T_camera_hand, self._reach[0][None])[0]
        shape = rng.integers(CLUTTER_SHAPES, size=self._clutter)
        poses = [self._clutter_pose(centre, int(i), rng) for i in shape]
        if self._backdrop is not None:
            shape = np.append(shape, CLUTTER_SHAPES)
            poses.append(self._wall_pose(centre, self._backdrop, rng))
        colours = rng.uniform(0.2, 0.9, size=(len(poses), 3))
        return Props(shape, np.array(poses).reshape(-1, 4, 4), colours)

    def _clutter_pose(self, centre: Array, shape: int, rng: np.random.Generator) -> Array:
        """Pose, (4, 4), of a solid somewhere in the image, wholly behind the hand's reach."""
        camera, radius = self._camera, self._diameters[shape] / 2
        z = centre[2] + self._reach[1] + radius + rng.uniform(0, DEEPEST)
        u, v = rng.uniform([0, 0], [camera.width, camera.height])
        T = np.eye(4)
        T[:3, :3] = se3.random_rotation(rng)
        T[:3, 3] = z * np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0])
        return T

    def _wall_pose(
        self, centre: Array, distance: tuple[float, float], rng: np.random.Generator
    ) -> Array:
        """Pose, (4, 4), of a wall (normal: its z axis) that stands clear of the hand's reach."""
        tilt = rng.normal(scale=TILT, size=2)
        T = se3.exp(np.array([tilt[0], tilt[1], 0, 0, 0, 0]))
        T[:3, 3] = centre + (self._reach[1] + rng.uniform(*distance)) * T[:3, 2]
        return T
