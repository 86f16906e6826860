"""The nearest of several posed rigid bodies, such as the links of a hand."""

import warp as wp

from inhand.kernels.fields import Fields, field_at
from inhand.kernels.transforms import to_local


@wp.func
def nearest_body(
    fields: Fields,
    T_world_body: wp.array(dtype=wp.mat44),
    first_pose: int,
    used: wp.array(dtype=int),
    first_used: int,
    p: wp.vec3,
    farthest: float,
):
    """Signed distance [m], unit gradient, world frame, and index of the body nearest to point `p`.

    Distances from `farthest` on are cut off there, with a zero gradient and index -1.

    Args (beyond the obvious):
        T_world_body: poses, those of interest from `first_pose` on.
        used: per body, from `first_used` on; 0 leaves it out.
    """
    best = farthest
    nearest = int(-1)
    gradient = wp.vec3(0.0, 0.0, 0.0)
    body = int(-1)
    while body + 1 < fields.start.shape[0]:
        body += 1
        if used[first_used + body] == 0:
            continue
        T = T_world_body[first_pose + body]
        s = fields.sphere[body]
        offset = p - wp.transform_point(T, s[:3])
        bound = s[3] + wp.max(best, 0.0)
        if wp.dot(offset, offset) > bound * bound:
            continue
        local = to_local(T, p)
        outside = wp.max(fields.low[body] - local, local - fields.high[body])
        if wp.max(outside) > wp.max(best, 0.0):
            continue
        value = field_at(fields, body, local)
        if value[0] < best:
            best = value[0]
            nearest = body
            gradient = wp.transform_vector(T, value[1:4])
    return best, gradient, nearest


@wp.kernel
def body_distances(
    points: wp.array(dtype=wp.vec3),
    fields: Fields,
    T_world_body: wp.array(dtype=wp.mat44),
    used: wp.array(dtype=int),
    farthest: float,
    distance: wp.array(dtype=float),
    first: int,
):
    """One work item a pair of scene and point: signed distance [m] to the nearest of the scene's
    bodies, cut off at `farthest`.

    Args (beyond the obvious):
        T_world_body: poses of the bodies in all scenes, flat (c * b).
        used: per body; 0 leaves it out.
        distance: out, flat (scene, point).
    """
    i = first + wp.tid()
    bodies = i // points.shape[0] * used.shape[0]
    p = points[i % points.shape[0]]
    nearest, _gradient, _body = nearest_body(fields, T_world_body, bodies, used, 0, p, farthest)
    distance[i] = nearest
