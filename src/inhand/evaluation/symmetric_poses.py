"""The poses of an object that look like its true one."""

import numpy as np
from numpy.typing import NDArray

from inhand.geometry.se3 import inverse, rotation_angle, skew, transform
from inhand.object_symmetry import Symmetry, rotations_about

Array = NDArray[np.float64]

SYMMETRY_STEPS = 315
"""Rotations that stand for a continuous symmetry in MSSD and MSPD: apart from each other by 1 % of
the diameter along the object's rim, as in BOP."""


def symmetric_poses(symmetry: Symmetry, T_estimate: Array, T_truth: Array) -> Array:
    """The poses that look like the truth, shape (k, 4, 4); of a sphere, the nearest one."""
    if _is_sphere(symmetry):
        return _turned_to(T_estimate, T_truth, symmetry.centre)[None]
    return np.asarray(T_truth @ symmetry.representatives(SYMMETRY_STEPS))


def nearest_symmetric(symmetry: Symmetry, T_estimate: Array, T_truth: Array) -> Array:
    """The pose, (4, 4), among those that look like the truth, whose rotation is nearest."""
    if _is_sphere(symmetry):
        return _turned_to(T_estimate, T_truth, symmetry.centre)
    alike = T_truth @ symmetry.rotations
    if symmetry.axis is not None:
        angles = _nearest_spin((inverse(alike) @ T_estimate)[:, :3, :3], symmetry.axis)
        alike = alike @ rotations_about(symmetry.centre, symmetry.axis, angles)
    differences = rotation_angle(alike[:, :3, :3], T_estimate[None, :3, :3])
    return np.asarray(alike[np.argmin(differences)])


def _is_sphere(symmetry: Symmetry) -> bool:
    return symmetry.axis is not None and len(symmetry.rotations) > 2


def _nearest_spin(R: Array, axis: Array) -> Array:
    """Angles [rad] of the rotations about `axis` that are nearest to R, shape (k, 3, 3).

    S(a) = cos a I + sin a K + (1 - cos a) axis axis' maximises trace(S(a)' R) at
    a = atan2(<K, R>, trace R - axis' R axis).
    """
    along = np.einsum("i,kij,j->k", axis, R, axis)
    return np.arctan2(np.einsum("ij,kij->k", skew(axis), R), np.trace(R, axis1=1, axis2=2) - along)


def _turned_to(T_estimate: Array, T_truth: Array, centre: Array) -> Array:
    """The truth, turned about the object's centre to the estimate's rotation."""
    turned = np.array(T_estimate)
    turned[:3, 3] += transform(T_truth, centre[None])[0] - transform(T_estimate, centre[None])[0]
    return turned
