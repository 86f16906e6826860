"""From where the camera looks at a hand."""

import numpy as np
import trimesh
from numpy.typing import NDArray

from inhand.geometry import se3

Array = NDArray[np.float64]

SPHERES = 4
"""Spheres of viewpoints, evenly between the nearest and the farthest. The paper states 648
viewpoints and radii of 0.3 to 0.9 m; 4 spheres of the 162 vertices of a twice divided icosahedron
make 648, which is a choice of ours."""
AIM = 0.02
"""Sd of how far the camera looks past the centre of the hand's reach, along either axis [m]; a
choice of ours, so that the hand is not always in the middle."""


def viewpoints(distance: tuple[float, float]) -> Array:
    """The 648 places of the camera from the centre of the hand's reach [m], shape (648, 3).

    Args:
        distance: radii of the smallest and the largest sphere [m].
    """
    directions = trimesh.creation.icosphere(subdivisions=2, radius=1.0).vertices
    radii = np.linspace(*distance, SPHERES)
    return np.asarray((radii[:, None, None] * directions).reshape(-1, 3))


def look_from(viewpoint: Array, centre: Array, rng: np.random.Generator) -> Array:
    """`T_camera_hand`, (4, 4), of a camera that looks about at the centre of the hand's reach.

    Args:
        viewpoint: place of the camera from that centre [m], axes of the hand frame, shape (3,).
        centre: the centre [m], hand frame, shape (3,).
        rng: source of the roll and the aim.
    """
    distance = float(np.linalg.norm(viewpoint))
    roll = se3.exp_so3(np.array([0.0, 0.0, rng.uniform(0, 2 * np.pi)]))
    T = np.eye(4)
    T[:3, :3] = roll @ se3.rotation_between(-viewpoint / distance, np.array([0.0, 0.0, 1.0]))
    aim = np.array([*rng.normal(scale=AIM, size=2), distance])
    T[:3, 3] = aim - T[:3, :3] @ centre
    return T
