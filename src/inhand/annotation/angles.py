"""Rotations as a user types them: three angles about the camera's axes, one after the other."""

import numpy as np
from scipy.spatial.transform import Rotation

from inhand.annotation.session import Array

LOCKED = 1e-6
"""Cosine of the middle angle below which the other two turn about the same axis."""


def rotation_of(angles: Array) -> Array:
    """The rotation, shape (3, 3), about the camera's axes x, then y, then z.

    Args:
        angles: about x, y and z [degree], shape (3,).
    """
    return np.asarray(Rotation.from_euler("xyz", angles, degrees=True).as_matrix())


def angles_of(rotation: Array) -> Array:
    """The angles [degree], shape (3,), whose `rotation_of` is this rotation, shape (3, 3).

    That about y is within 90 degrees. At 90 degrees, where those about x and z do the same, that
    about x is 0.
    """
    R = rotation
    cosine = np.hypot(R[0, 0], R[1, 0])
    y = np.arctan2(-R[2, 0], cosine)
    if cosine < LOCKED:
        return np.degrees([0.0, y, np.arctan2(-R[0, 1], R[1, 1])])
    return np.degrees([np.arctan2(R[2, 1], R[2, 2]), y, np.arctan2(R[1, 0], R[0, 0])])
