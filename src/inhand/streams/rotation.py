"""Unit quaternions (x, y, z, w), the order of ROS."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ALMOST_ONE = 1 - 1e-9
"""Cosine beyond which two quaternions are mixed linearly."""


def slerp(a: Array, b: Array, share: float) -> Array:
    """The rotation `share` (0..1) of the shorter way from `a` to `b`, all of shape (4,)."""
    cosine = float(a @ b)
    if cosine < 0:  # q and -q are the same rotation
        b, cosine = -b, -cosine
    if cosine > ALMOST_ONE:
        mixed = (1 - share) * a + share * b
    else:
        angle = np.arccos(cosine)
        mixed = np.sin((1 - share) * angle) * a + np.sin(share * angle) * b
    return np.asarray(mixed / np.linalg.norm(mixed))


def matrix(quaternion: Array) -> Array:
    """Rotation matrix, shape (3, 3), of a unit quaternion, shape (4,)."""
    x, y, z, w = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def from_matrix(R: Array) -> Array:
    """Unit quaternion, shape (4,), of a rotation matrix, shape (3, 3).

    It is the eigenvector of the largest eigenvalue of a symmetric matrix (Bar-Itzhack 2000), which
    is well conditioned for every rotation.
    """
    K = np.zeros((4, 4))
    K[:3, :3] = R + R.T - np.trace(R) * np.eye(3)
    K[:3, 3] = K[3, :3] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    K[3, 3] = np.trace(R)
    return np.asarray(np.linalg.eigh(K)[1][:, -1])
