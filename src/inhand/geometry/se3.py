"""Rigid motions as 4x4 float64 matrices; `T_a_b` maps points of frame b into frame a."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from inhand.checks import number_array
from inhand.errors import InputError

Array = NDArray[np.float64]


def check_rigid(T: Any, name: str) -> Array:
    """Return `T` as a (4, 4) float64 matrix.

    Raises:
        InputError: `T` is not a finite, right-handed rigid transform with last row 0 0 0 1.
    """
    matrix = number_array(T, name, "a 4x4 matrix of numbers").astype(np.float64)
    if matrix.shape != (4, 4):
        raise InputError(f"{name} must be a 4x4 homogeneous matrix, got shape {matrix.shape}")
    if not np.isfinite(matrix).all():
        raise InputError(f"{name} holds NaN or infinite numbers")
    if not (np.abs(matrix[3] - [0, 0, 0, 1]) <= 1e-5).all():
        raise InputError(
            f"{name}: the last row must be 0 0 0 1, got {matrix[3].tolist()}; "
            "a transposed matrix has its translation there"
        )
    rotation = matrix[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        skewed = np.abs(rotation @ rotation.T - np.eye(3))
    if not (skewed <= 1e-3).all():  # so that NaN, of numbers that are too large, is refused
        raise InputError(
            f"{name}: the upper-left 3x3 is not a rotation (its rows are not orthonormal); "
            "remove scale and shear"
        )
    if np.linalg.det(rotation) < 0:
        raise InputError(
            f"{name}: the rotation is left-handed (determinant -1), that is a mirror image; "
            "flip one axis to make the frame right-handed"
        )
    u, _, vt = np.linalg.svd(rotation)
    matrix[:3, :3] = u @ vt
    matrix[3] = [0, 0, 0, 1]
    return matrix


def inverse(T: Array) -> Array:
    """Inverse of rigid transforms, shape (..., 4, 4)."""
    R_t = np.swapaxes(T[..., :3, :3], -1, -2)
    out = np.zeros_like(T)
    out[..., :3, :3] = R_t
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", R_t, T[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


def transform(T: Array, points: NDArray[Any]) -> Array:
    """Apply a (4, 4) transform to points of shape (n, 3)."""
    return np.asarray(points @ T[:3, :3].T + T[:3, 3])


def skew(v: Array) -> Array:
    """Cross-product matrices, shape (..., 3, 3), of vectors of shape (..., 3)."""
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def exp_so3(w: Array) -> Array:
    """Rotation matrices, shape (..., 3, 3), of rotation vectors [rad], shape (..., 3)."""
    angle = np.linalg.norm(w, axis=-1)[..., None, None]
    k = skew(w)
    small = angle < 1e-8
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1.0, np.sin(safe) / safe)
    b = np.where(small, 0.5, (1 - np.cos(safe)) / safe**2)
    return np.asarray(np.eye(3) + a * k + b * (k @ k))


def exp(xi: Array) -> Array:
    """Transforms, shape (..., 4, 4), from rotation vector [rad] and translation [m], (..., 6).

    The two halves are applied separately (x -> R x + t), not as a screw motion.
    """
    xi = np.asarray(xi, dtype=np.float64)
    out = np.zeros((*xi.shape[:-1], 4, 4))
    out[..., :3, :3] = exp_so3(xi[..., :3])
    out[..., :3, 3] = xi[..., 3:]
    out[..., 3, 3] = 1.0
    return out


def moved(T: Array, twist: Array, pivot: Array) -> Array:
    """`T`, (4, 4), after twists (..., 6) about a pivot of the body, as of shape (..., 4, 4).

    Args:
        T: the pose.
        twist: rotation vectors [rad] and then translations [m], along the axes `T` maps to.
        pivot: what rotations are about, in the body's frame [m], shape (3,).
    """
    out = exp(twist)
    centre = T[:3, :3] @ pivot + T[:3, 3]
    out[..., :3, 3] += centre
    out[..., :3, :3] @= T[:3, :3]
    out[..., :3, 3] -= out[..., :3, :3] @ pivot
    return out


def rotation_angle(R_a: Array, R_b: Array) -> Array:
    """Geodesic distance on SO(3) [rad] of rotations of shape (..., 3, 3) (paper, section IV-B)."""
    trace = np.einsum("...ij,...ij->...", R_a, R_b)
    return np.asarray(np.arccos(np.clip((trace - 1) / 2, -1, 1)))


def random_rotation(rng: np.random.Generator) -> Array:
    """A rotation drawn uniformly from SO(3), shape (3, 3)."""
    w, x, y, z = rng.normal(size=4)
    return np.asarray(Rotation.from_quat([x, y, z, w]).as_matrix())


def rotation_between(a: Array, b: Array) -> Array:
    """The smallest rotation, shape (3, 3), that takes unit vector `a` to unit vector `b`."""
    cross = np.cross(a, b)
    sine, cosine = np.linalg.norm(cross), float(a @ b)
    if sine < 1e-9:
        if cosine > 0:
            return np.eye(3)
        perpendicular = np.cross(a, np.eye(3)[np.argmin(np.abs(a))])
        return exp_so3(np.pi * perpendicular / np.linalg.norm(perpendicular))
    return exp_so3(cross / sine * np.arctan2(sine, cosine))
