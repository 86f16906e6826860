"""Difference between the observed depth image and renderings of the object at many poses."""

import warp as wp

from inhand.kernels.depth import Pinhole
from inhand.kernels.transforms import to_local

EMPTY = wp.constant(1.0e3)
"""Depth that stands for "nothing within reach" [m]."""


@wp.kernel
def depth_discrepancy(
    camera: Pinhole,
    observed: wp.array(dtype=float),
    hand: wp.array(dtype=float),
    mesh: wp.array(dtype=wp.uint64),
    sphere: wp.array(dtype=wp.vec4),
    T_camera_object: wp.array(dtype=wp.mat44),
    largest: float,
    discrepancy: wp.array(dtype=float),
    first: int,
):
    """One work item a pose and image row: summed depth differences [m] of hand and object.

    Args (beyond the obvious):
        observed: depth [m], EMPTY where nothing is, 0 where unknown; flat.
        hand: rendered depth of the hand [m], 0 where it does not show; flat.
        mesh, sphere: the object's mesh and bounding sphere (centre, radius) [m], one each.
        largest: differences are cut off here [m].
        discrepancy: out, flat (poses, rows).
    """
    i = first + wp.tid()
    T = T_camera_object[i // camera.height]
    v = i % camera.height
    inverse = wp.transpose(T)
    origin = to_local(T, wp.vec3())
    s = sphere[0]
    centre = wp.transform_point(T, s[:3])
    total = float(0.0)
    for u in range(camera.width):
        seen = observed[v * camera.width + u]
        if seen <= 0.0:
            continue
        rendered = hand[v * camera.width + u]
        if rendered <= 0.0:
            rendered = EMPTY
        ray = wp.vec3((float(u) - camera.cx) / camera.fx, (float(v) - camera.cy) / camera.fy, 1.0)
        length = wp.length(ray)
        miss = centre - wp.dot(centre, ray) / (length * length) * ray
        if wp.dot(miss, miss) < s[3] * s[3]:
            direction = wp.transform_vector(inverse, ray) / length
            # The ray has unit z, so depth is the length along it over the ray's own.
            hit = wp.mesh_query_ray(mesh[0], origin, direction, rendered * length)
            if hit.result:
                rendered = hit.t / length
        total += wp.min(wp.abs(seen - rendered), largest)
    discrepancy[i] = total
