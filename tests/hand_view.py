"""Images of a hand alone, or with other things in front of it."""

from collections.abc import Sequence

import numpy as np

from inhand.camera import Camera
from inhand.config import ObservationConfig
from inhand.geometry.mesh import TriangleMesh
from inhand.geometry.se3 import exp, rotation_angle
from inhand.kernels.depth import DepthRenderer
from inhand.packed import PackedHand
from inhand.stages.observation import Observation, observe

CAMERA = Camera(fx=500, fy=500, cx=159.5, cy=119.5, width=320, height=240)


def wrist(
    turn: Sequence[float] = (0.5, -0.4, 0.3), distance: float = 0.4, height: float = 0.03
) -> np.ndarray:
    """A wrist pose with the point `height` [m] above the palm's origin in the image's middle.

    The z axis, out of the palm, is up in the image before the hand is turned by a rotation vector.
    """
    T = exp(np.array([*turn, 0, 0, 0]))
    T[:3, :3] = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]) @ T[:3, :3]
    T[:3, 3] = [0, 0, distance] - height * T[:3, 2]
    return T


def seen(
    hand: PackedHand,
    q: np.ndarray,
    T_camera_hand: np.ndarray,
    camera: Camera = CAMERA,
    *,
    without: Sequence[int] = (),
    others: Sequence[tuple[TriangleMesh, np.ndarray]] = (),
) -> Observation:
    """What the camera sees of the hand.

    Args:
        without: indices of links that are not there.
        others: meshes and poses of what else is there.
    """
    poses = hand.link_poses(q[None], T_camera_hand[None])[0]
    posed = [(x.mesh, T) for x, T in zip(hand.hand.links, poses, strict=True)]
    shown = [x for i, x in enumerate(posed) if i not in without] + list(others)
    depth, _ = DepthRenderer([mesh for mesh, _ in shown]).render(
        camera, np.stack([T for _, T in shown])
    )
    config = ObservationConfig()
    return observe(depth, camera, T_camera_hand, hand.hand.reach, 0.05, config, "cpu")


def off_by(T: np.ndarray, T_true: np.ndarray) -> tuple[float, float]:
    """Distance [m] and angle [degrees] between two poses."""
    angle = rotation_angle(T[:3, :3], T_true[:3, :3])
    return float(np.linalg.norm(T[:3, 3] - T_true[:3, 3])), float(np.degrees(angle))
