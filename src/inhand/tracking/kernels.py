"""What the tracker computes on the device: which points are the object's."""

import warp as wp

from inhand.kernels.bodies import nearest_body
from inhand.kernels.fields import Fields, field_at
from inhand.kernels.transforms import to_local


@wp.func
def not_hand(distance: float, none: float, all: float):
    """Probability that a point at this distance from the hand [m] is not the hand's."""
    if distance <= none:
        return 0.0
    return wp.clamp((distance - none) / (all - none), 0.1, 1.0)


@wp.kernel
def object_weights(
    points: wp.array(dtype=wp.vec3),
    links: Fields,
    T_camera_link: wp.array(dtype=wp.mat44),
    certain: wp.array(dtype=int),
    uncertain: wp.array(dtype=int),
    obj: Fields,
    T_camera_object: wp.mat44,
    near: float,
    none: float,
    all: float,
    share: float,
    weight: wp.array(dtype=float),
    first: int,
):
    """One work item a scene point: probability that it is the object's.

    Args (beyond the obvious):
        certain, uncertain: per link, 1 if the image supports it, and if it does not.
        T_camera_object: where the object is expected.
        near: a point farther from it than this is not the object's [m].
        none, all: distances to the hand up to which a point is the hand's, and from which on it is
            certainly not [m].
        share: weight of a point that only an uncertain link explains.
        weight: out.
    """
    i = first + wp.tid()
    p = points[i]
    weight[i] = 0.0
    if field_at(obj, 0, to_local(T_camera_object, p))[0] > near:
        return
    to_certain, _g, _k = nearest_body(links, T_camera_link, 0, certain, 0, p, all)
    to_uncertain, _h, _l = nearest_body(links, T_camera_link, 0, uncertain, 0, p, all)
    doubt = not_hand(wp.min(to_certain, to_uncertain), none, all)
    weight[i] = not_hand(to_certain, none, all) * (share + (1.0 - share) * doubt)
