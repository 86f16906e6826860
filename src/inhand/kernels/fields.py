"""Signed distance fields of several rigid bodies, packed for kernels."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.geometry.distance_field import DistanceField
from inhand.geometry.mesh import TriangleMesh
from inhand.kernels.depth import bounding_sphere
from inhand.kernels.launch import in_struct, pack


@wp.struct
class Fields:
    """Distance fields of bodies 0..b-1, one after the other in `values`."""

    values: wp.array(dtype=wp.vec4h)
    """Signed distance [m], negative inside, and its unit gradient, at the voxel centres."""
    start: wp.array(dtype=int)
    size: wp.array(dtype=wp.vec3i)
    origin: wp.array(dtype=wp.vec3)
    voxel: wp.array(dtype=float)
    low: wp.array(dtype=wp.vec3)
    """Corners of the box around the surface, body frame [m]."""
    high: wp.array(dtype=wp.vec3)
    sphere: wp.array(dtype=wp.vec4)
    """Bounding sphere of the surface, body frame (centre, radius) [m]."""


def pack_fields(
    fields: Sequence[DistanceField], meshes: Sequence[TriangleMesh], device: str
) -> Any:
    """The distance fields of meshes as one kernel argument."""
    counts = [int(np.prod(f.values.shape[:3])) for f in fields]
    low, high = zip(*map(_surface_box, fields), strict=True)
    return pack(
        Fields,
        device,
        values=np.concatenate([f.values.reshape(-1, 4).astype(np.float16) for f in fields]),
        start=np.cumsum([0, *counts[:-1]]),
        size=[f.values.shape[:3] for f in fields],
        origin=[f.origin for f in fields],
        voxel=[f.voxel for f in fields],
        low=low,
        high=high,
        sphere=[bounding_sphere(mesh) for mesh in meshes],
    )


def fields_of(fields: Any, bodies: Sequence[int], device: str) -> Any:
    """The fields of some bodies, by their indices, as one kernel argument; values are shared."""
    part = Fields()
    part.values = fields.values
    for name in ("start", "size", "origin", "voxel", "low", "high", "sphere"):
        array = getattr(fields, name)
        setattr(part, name, in_struct(array.numpy()[list(bodies)], array.dtype, device))
    return part


def _surface_box(field: DistanceField) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners [m] of a box around all points of distance 0 or less."""
    # A point is nearer than 1.3 voxels to some voxel's centre on either side of it.
    inside = field.values[..., 0] < 1.5 * field.voxel
    axes = [np.flatnonzero(inside.any(axis=other)) for other in ((1, 2), (0, 2), (0, 1))]
    first, last = np.array([[cells[0], cells[-1]] for cells in axes]).T
    return field.origin + first * field.voxel, field.origin + last * field.voxel


@wp.func
def field_at(fields: Fields, body: int, p: wp.vec3):
    """Signed distance [m] and unit gradient at point `p` of the body's frame.

    As `DistanceField.distance`: first-order from the nearest voxel's centre; outside the grid, the
    value at the nearest point of the grid plus the distance to it.
    """
    size = fields.size[body]
    voxel = fields.voxel[body]
    local = (p - fields.origin[body]) * (1.0 / voxel)
    inside = wp.vec3(
        wp.clamp(local[0], 0.0, float(size[0] - 1)),
        wp.clamp(local[1], 0.0, float(size[1] - 1)),
        wp.clamp(local[2], 0.0, float(size[2] - 1)),
    )
    i = int(inside[0] + 0.5)
    j = int(inside[1] + 0.5)
    k = int(inside[2] + 0.5)
    value = fields.values[fields.start[body] + (i * size[1] + j) * size[2] + k]
    gradient = wp.vec3(float(value[1]), float(value[2]), float(value[3]))
    offset = inside - wp.vec3(float(i), float(j), float(k))
    beyond = wp.length(local - inside)
    distance = float(value[0]) + voxel * (wp.dot(gradient, offset) + beyond)
    return wp.vec4(distance, gradient[0], gradient[1], gradient[2])
