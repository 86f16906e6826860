"""How near object and hand come to each other, for many poses of either."""

import warp as wp

from inhand.kernels.fields import Fields, field_at
from inhand.kernels.transforms import rigid, to_local


@wp.kernel
def link_clearances(
    T_camera_object: wp.array(dtype=wp.mat44),
    points: wp.array(dtype=wp.vec3),
    n_points: int,
    fields: Fields,
    T_camera_link: wp.array(dtype=wp.mat44),
    farthest: float,
    clearance: wp.array(dtype=float),
    first: int,
):
    """One work item a pair of object pose and link: smallest signed distance of the object's
    surface to the link [m].

    Args (beyond the obvious):
        points: surface samples of the object, object frame; the first `n_points` are used.
        farthest: larger distances are cut off here [m].
        clearance: out, flat (pose, link); negative is the depth of the penetration.
    """
    i = first + wp.tid()
    n_links = fields.start.shape[0]
    link = i % n_links
    T_object = T_camera_object[i // n_links]
    T_link = T_camera_link[link]
    inverse = wp.transpose(T_link[:3, :3])
    T = rigid(inverse @ T_object[:3, :3], to_local(T_link, T_object[:3, 3]))
    s = fields.sphere[link]
    # The sphere goes to the points: most of them need no transform then.
    centre = to_local(T, s[:3])
    nearest = farthest
    k = int(-1)
    while k + 1 < n_points:
        k += 1
        offset = points[k] - centre
        bound = s[3] + wp.max(nearest, 0.0)
        if wp.dot(offset, offset) < bound * bound:
            local = wp.transform_point(T, points[k])
            outside = wp.max(fields.low[link] - local, local - fields.high[link])
            if wp.max(outside) < wp.max(nearest, 0.0):
                nearest = wp.min(nearest, field_at(fields, link, local)[0])
    clearance[i] = nearest


@wp.kernel
def configuration_clearances(
    T_camera_object: wp.array(dtype=wp.mat44),
    fields: Fields,
    T_camera_link: wp.array(dtype=wp.mat44),
    n_links: int,
    n_configurations: int,
    points: wp.array(dtype=wp.vec3),
    link: wp.array(dtype=int),
    n_points: int,
    farthest: float,
    clearance: wp.array(dtype=float),
    first: int,
):
    """One work item a pair of object pose and finger configuration: smallest signed distance of the
    finger's surface to the object [m].

    Args (beyond the obvious):
        fields: the object's distance field.
        T_camera_link: link poses of all configurations, flat (c * n_links).
        points, link: surface samples of the finger and the link each is on; the first `n_points`
            are used.
        farthest: larger distances are cut off here [m].
        clearance: out, flat (pose, configuration).
    """
    i = first + wp.tid()
    T = T_camera_object[i // n_configurations]
    links = (i % n_configurations) * n_links
    nearest = farthest
    k = int(-1)
    while k + 1 < n_points:
        k += 1
        p = wp.transform_point(T_camera_link[links + link[k]], points[k])
        local = to_local(T, p)
        outside = wp.max(fields.low[0] - local, local - fields.high[0])
        if wp.max(outside) < wp.max(nearest, 0.0):
            nearest = wp.min(nearest, field_at(fields, 0, local)[0])
    clearance[i] = nearest
