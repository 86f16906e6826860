"""How far the surface of one posed model is from that of another."""

import warp as wp

from inhand.kernels.fields import Fields, field_at
from inhand.kernels.transforms import to_local


@wp.func
def distance_between(
    T_a: wp.mat44,
    T_b: wp.mat44,
    points: wp.array(dtype=wp.vec3),
    n_points: int,
    fields: Fields,
    centre: wp.vec3,
    farthest: float,
    limit: float,
):
    """Mean distance [m] of the surface at `T_a` to the model at `T_b`.

    It is `farthest` where the centres lie farther apart than that, and anything above `limit`
    where it is above. No symmetry has to be known: symmetric poses have the same surface.
    """
    apart = wp.transform_point(T_a, centre) - wp.transform_point(T_b, centre)
    if wp.length(apart) > farthest:
        return farthest
    total = float(0.0)
    for s in range(n_points):
        p = wp.transform_point(T_a, points[s])
        total += wp.abs(field_at(fields, 0, to_local(T_b, p))[0])
        if total > limit * float(n_points):
            break
    return total / float(n_points)


@wp.kernel
def surface_distances(
    T_a: wp.array(dtype=wp.mat44),
    T_b: wp.mat44,
    points: wp.array(dtype=wp.vec3),
    n_points: int,
    fields: Fields,
    centre: wp.vec3,
    farthest: float,
    distance: wp.array(dtype=float),
    first: int,
):
    """One work item a pose of `T_a`: mean distance [m] of its surface to the model posed at `T_b`.

    Args (beyond the obvious):
        points: surface samples, object frame; the first `n_points` are used.
        centre: centre of the model, object frame [m].
        farthest: poses whose centres lie farther apart get this [m].
    """
    i = first + wp.tid()
    distance[i] = distance_between(
        T_a[i], T_b, points, n_points, fields, centre, farthest, farthest
    )


@wp.kernel
def compare_poses(
    T: wp.array(dtype=wp.mat44),
    others: wp.array(dtype=int),
    n_chosen: int,
    begin: int,
    points: wp.array(dtype=wp.vec3),
    n_points: int,
    fields: Fields,
    centre: wp.vec3,
    near: float,
    alike: wp.array2d(dtype=int),
    first: int,
):
    """One work item a pose of a block: which earlier poses have their surface where it has its own.

    Args (beyond the obvious):
        T: all poses; the block's are those from `begin` on.
        others: indices of the poses to compare with: first `n_chosen` that come before the block,
            at the first of which that is alike the comparison ends, then the block's own.
        near: surfaces that are no farther apart than this on average are alike [m].
        alike: in as zeros, out 1 where alike, (block, others).
    """
    i = first + wp.tid()
    own = T[begin + i]
    for k in range(n_chosen + i):
        apart = distance_between(
            own, T[others[k]], points, n_points, fields, centre, wp.max(3.0 * near, 0.001), near
        )
        if apart <= near:
            alike[i, k] = 1
            if k < n_chosen:
                return
