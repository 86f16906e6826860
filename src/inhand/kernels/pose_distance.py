"""How far the surface of one posed model is from that of another."""

import warp as wp

from inhand.kernels.fields import Fields, field_at
from inhand.kernels.transforms import to_local


@wp.struct
class Surface:
    """The surface whose poses are compared, object frame."""

    points: wp.array(dtype=wp.vec3)
    """Samples of it [m]."""
    fields: Fields
    """Its distance field, one body."""
    centre: wp.vec3
    """Centre of the model [m]."""


@wp.func
def distance_between(surface: Surface, T_a: wp.mat44, T_b: wp.mat44, farthest: float, limit: float):
    """Mean distance [m] of the surface at `T_a` to the model at `T_b`.

    It is `farthest` where the centres lie farther apart than that, and anything above `limit`
    where it is above. No symmetry has to be known: symmetric poses have the same surface.
    """
    apart = wp.transform_point(T_a, surface.centre) - wp.transform_point(T_b, surface.centre)
    if wp.length(apart) > farthest:
        return farthest
    n_points = surface.points.shape[0]
    total = float(0.0)
    s = int(-1)
    while s + 1 < n_points:
        s += 1
        p = wp.transform_point(T_a, surface.points[s])
        total += wp.abs(field_at(surface.fields, 0, to_local(T_b, p))[0])
        if total > limit * float(n_points):
            break
    return total / float(n_points)


@wp.kernel
def surface_distances(
    surface: Surface,
    T_a: wp.array(dtype=wp.mat44),
    T_b: wp.mat44,
    farthest: float,
    distance: wp.array(dtype=float),
    first: int,
):
    """One work item a pose of `T_a`: mean distance [m] of its surface to the model posed at `T_b`.

    Args (beyond the obvious):
        farthest: poses whose centres lie farther apart get this [m].
    """
    i = first + wp.tid()
    distance[i] = distance_between(surface, T_a[i], T_b, farthest, farthest)


@wp.kernel
def compare_poses(
    surface: Surface,
    T: wp.array(dtype=wp.mat44),
    others: wp.array(dtype=int),
    n_chosen: int,
    begin: int,
    near: float,
    alike: wp.array2d(dtype=int),
    first: int,
):
    """One work item a pose of a batch: which earlier poses have their surface where it has its own.

    Args (beyond the obvious):
        T: all poses; the batch's are those from `begin` on.
        others: indices of the poses to compare with: first `n_chosen` that come before the batch,
            at the first of which that is alike a thread's comparison ends, then the batch's own.
        near: surfaces that are no farther apart than this on average are alike [m].
        alike: in as zeros, out 1 where alike, (batch, others).
    """
    item, lane = wp.tid()
    i = first + item
    own = T[begin + i]
    farthest = wp.max(3.0 * near, 0.001)
    k = lane - wp.block_dim()
    while k + wp.block_dim() < n_chosen + i:
        k += wp.block_dim()
        if distance_between(surface, own, T[others[k]], farthest, near) <= near:
            alike[i, k] = 1
            if k < n_chosen:
                return
