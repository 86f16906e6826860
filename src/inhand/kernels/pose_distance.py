"""How far the surface of one posed model is from that of another."""

import warp as wp

from inhand.kernels.fields import Fields, field_at

wp.set_module_options({"enable_backward": False})


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

    Poses whose centres lie farther apart than `farthest` get that as their distance. No symmetry
    has to be known: symmetric poses have the same surface.
    """
    i = first + wp.tid()
    T = T_a[i]
    apart = wp.transform_point(T, centre) - wp.transform_point(T_b, centre)
    if wp.length(apart) > farthest:
        distance[i] = farthest
        return
    inverse = wp.transpose(T_b)
    t = wp.vec3(T_b[0, 3], T_b[1, 3], T_b[2, 3])
    total = float(0.0)
    limit = farthest * float(n_points)
    for s in range(n_points):
        p = wp.transform_point(T, points[s])
        value = field_at(fields, 0, wp.transform_vector(inverse, p - t))
        total += wp.abs(value[0])
        if total > limit:
            break
    distance[i] = total / float(n_points)
