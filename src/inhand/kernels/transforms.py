"""Rigid transforms inside kernels, of either precision."""

from typing import Any

import warp as wp


@wp.func
def rigid(R: Any, t: Any):
    """The 4x4 transform of a rotation and a translation."""
    T = wp.identity(n=4, dtype=R.dtype)
    T[:3, :3] = R
    T[:3, 3] = t
    return T


@wp.func
def to_local(T: Any, p: Any):
    """Point `p` of the outer frame in the frame that is posed at `T`."""
    return wp.transpose(T[:3, :3]) @ (p - T[:3, 3])


@wp.func
def turn(w: Any):
    """The rotation of a rotation vector [rad]."""
    return wp.quat_to_matrix(wp.quat_from_axis_angle(wp.normalize(w), wp.length(w)))
