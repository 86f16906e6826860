"""Depth images of posed rigid bodies, traced through their distance fields."""

import warp as wp

from inhand.kernels.depth import Pinhole
from inhand.kernels.fields import Fields, field_at
from inhand.kernels.transforms import to_local

AHEAD = wp.constant(1.0e-3)
"""A ray has met a surface that is so near ahead [m]."""
MOST_STEPS = wp.constant(200)
"""A ray that has met nothing by then never does."""


@wp.func
def in_box(low: wp.vec3, high: wp.vec3, origin: wp.vec3, direction: wp.vec3):
    """Where the line origin + t direction enters and leaves a box; it misses if it leaves first."""
    enter = float(-1.0e6)
    leave = float(1.0e6)
    for k in range(3):
        # Of a ray along a face the tiny component says on which side it is.
        slope = direction[k]
        if wp.abs(slope) < 1.0e-9:
            slope = 1.0e-9
        a = (low[k] - origin[k]) / slope
        b = (high[k] - origin[k]) / slope
        enter = wp.max(enter, wp.min(a, b))
        leave = wp.min(leave, wp.max(a, b))
    return enter, leave


@wp.kernel
def trace_bodies(
    camera: Pinhole,
    fields: Fields,
    T_camera_body: wp.array(dtype=wp.mat44),
    windows: wp.array(dtype=wp.vec4i),
    around: wp.vec4i,
    depth: wp.array(dtype=float),
    shown: wp.array(dtype=int),
    first: int,
):
    """One work item a pixel of a window: depth z [m] of the nearest body along its ray.

    From where the ray enters a body's box it goes ahead by the distance to the body, which is free,
    or a little less, as the distance is good to half a voxel.

    Args (beyond the obvious):
        windows: per body, the pixels (u0, v0, u1, v1) that it can show in, the ends not included.
        around: a window around these.
        depth: in and out, of the whole image: what else is there [m], or 0.
        shown: in and out, the body that every pixel shows; left alone if it is empty.
    """
    item = first + wp.tid()
    columns = around[2] - around[0]
    u = around[0] + item % columns
    v = around[1] + item // columns
    ray = wp.vec3((float(u) - camera.cx) / camera.fx, (float(v) - camera.cy) / camera.fy, 1.0)
    length = wp.length(ray)
    pixel = v * camera.width + u
    nearest = depth[pixel]
    winner = int(-1)
    if nearest <= 0.0:
        nearest = 1.0e6
    body = int(-1)
    while body + 1 < windows.shape[0]:
        body += 1
        window = windows[body]
        if u < window[0] or v < window[1] or u >= window[2] or v >= window[3]:
            continue
        T = T_camera_body[body]
        # The ray has unit z, so that its parameter is the depth.
        direction = wp.transform_vector(wp.transpose(T), ray)
        origin = to_local(T, wp.vec3())
        enter, leave = in_box(fields.low[body], fields.high[body], origin, direction)
        z = wp.max(enter, 0.0)
        end = wp.min(leave, nearest)
        step = int(0)
        while z < end and step < MOST_STEPS:
            value = field_at(fields, body, origin + z * direction)
            approach = -wp.dot(value[1:4], direction)
            if value[0] * length < AHEAD * approach:
                nearest = wp.min(nearest, z + value[0] / wp.max(approach, 0.1))
                winner = body
                end = 0.0
            z += wp.max(0.9 * value[0], 0.5 * AHEAD) / length
            step += 1
    if winner >= 0:
        depth[pixel] = nearest
        if shown.shape[0] > 0:
            shown[pixel] = winner
