"""Poses with a Gaussian error, and what is known of them before and after looking.

The error of a pose is a twist: a rotation vector [rad] about a pivot of the body, then the motion
of that pivot [m], both along the camera's axes.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from inhand.geometry import se3
from inhand.geometry.se3 import moved

Array = NDArray[np.float64]


def twist_between(T_from: Array, T_to: Array, pivot: Array) -> Array:
    """The twist, shape (6,), that moves one pose (4, 4) to another."""
    turn = rotation_vector(T_to[:3, :3] @ T_from[:3, :3].T)
    way = (T_to - T_from)[:3, :3] @ pivot + (T_to - T_from)[:3, 3]
    return np.concatenate([turn, way])


def rotation_vector(R: Array) -> Array:
    """Axis times angle [rad], shape (3,), of a rotation (3, 3)."""
    cosine = (np.trace(R) - 1) / 2
    if cosine < -0.9:  # near half a turn the axis does not show in the next line
        return np.asarray(Rotation.from_matrix(R).as_rotvec())
    sines = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
    sine = np.sqrt(sines @ sines)
    return np.asarray(sines * (np.arctan2(sine, cosine) / sine if sine > 1e-12 else 1.0))


def carried(covariance: Array, R: Array) -> Array:
    """Covariance (6 + n, 6 + n) of a twist, and what else there is, after the rotation `R`."""
    whole = np.eye(len(covariance))
    whole[:3, :3] = whole[3:6, 3:6] = R
    return np.asarray(whole @ covariance @ whole.T)


def fused(
    one: tuple[Array, Array], other: tuple[Array, Array], pivot: Array
) -> tuple[Array, Array]:
    """What two independent poses say together, each a pose (4, 4) and its covariance (6, 6)."""
    (T, covariance), (T_other, covariance_other) = one, other
    gain = covariance @ np.linalg.inv(covariance + covariance_other)
    step = np.asarray(gain @ twist_between(T, T_other, pivot))
    left = covariance - gain @ covariance
    return moved(T, step, pivot), np.asarray((left + left.T) / 2)


def about_origin(covariance: Array, T: Array, pivot: Array) -> Array:
    """Covariance (6, 6) of a pose `T` (4, 4) for a twist about the body's origin, not its pivot."""
    J = np.eye(6)
    J[3:, :3] = se3.skew(T[:3, :3] @ pivot)
    return np.asarray(J @ covariance @ J.T)
