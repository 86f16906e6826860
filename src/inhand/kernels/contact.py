"""How near an object comes to the hand, for many object poses."""

import warp as wp

from inhand.kernels.bodies import nearest_body
from inhand.kernels.fields import Fields

wp.set_module_options({"enable_backward": False})


@wp.kernel
def hand_clearance(
    T_camera_object: wp.array(dtype=wp.mat44),
    points: wp.array(dtype=wp.vec3),
    n_points: int,
    fields: Fields,
    spheres: wp.array(dtype=wp.vec4),
    T_camera_link: wp.array(dtype=wp.mat44),
    used: wp.array(dtype=int),
    farthest: float,
    clearance: wp.array(dtype=float),
    first: int,
):
    """One work item an object pose: smallest signed distance of its surface to the hand [m].

    Args (beyond the obvious):
        points: surface samples of the object, object frame; the first `n_points` are used.
        used: per link, 0 leaves it out.
        farthest: larger distances are cut off here [m].
        clearance: out; negative is the depth of the penetration.
    """
    i = first + wp.tid()
    nearest = farthest
    for k in range(n_points):
        p = wp.transform_point(T_camera_object[i], points[k])
        nearest, _gradient, _link = nearest_body(
            fields, spheres, T_camera_link, 0, used, 0, p, nearest
        )
    clearance[i] = nearest
