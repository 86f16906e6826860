"""What the tracker computes on the device: the object's points and its fit."""

import warp as wp

from inhand.kernels.bodies import nearest_body
from inhand.kernels.fields import Fields, field_at
from inhand.kernels.hand_fit import redescending
from inhand.kernels.normal_equations import Matrix6, Vector6, row_of
from inhand.kernels.object_fit import ObjectEvidence, visible_residual
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


@wp.kernel
def object_terms(
    e: ObjectEvidence,
    T: wp.mat44,
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    n_points: int,
    fields: Fields,
    centre: wp.vec3,
    width: float,
    segment_stride: int,
    image_weight: float,
    n_blocks: int,
    A: wp.array(dtype=Matrix6),
    b: wp.array(dtype=Vector6),
    first: int,
):
    """One work item a block of points: the sums of `kernels.object_fit.refine_poses` at one pose.

    Args (beyond the obvious):
        T: pose of the object in the camera.
        points, normals: model surface samples, object frame; the first `n_points` are used.
        centre: what rotations are about, object frame [m].
        width: width of the redescending weight [m].
        segment_stride: every how many segment points one is used.
        image_weight: weight of one visible model sample against one segment point.
        n_blocks: blocks, which take turns in taking points.
        A, b: out, sums of every block; rotation before translation, camera axes.
    """
    block = first + wp.tid()
    matrix = Matrix6()
    side = Vector6()
    pivot = wp.transform_point(T, centre)
    for s in range(block * segment_stride, e.points.shape[0], n_blocks * segment_stride):
        p = e.points[s]
        value = field_at(fields, 0, to_local(T, p))
        g = wp.transform_vector(T, value[1:4])
        w = e.weights[s] * redescending(value[0], width) * wp.max(0.0, wp.dot(g, e.normals[s]))
        if w > 0.0:
            row = row_of(p - pivot, g)
            matrix += wp.outer(w * row, row)
            side += w * value[0] * row
    for s in range(block, n_points, n_blocks):
        p = wp.transform_point(T, points[s])
        n = wp.transform_vector(T, normals[s])
        r, w = visible_residual(e, p, n, width)
        if w > 0.0:
            row = row_of(p - pivot, n)
            matrix += wp.outer(image_weight * w * row, row)
            side += image_weight * w * r * row
    A[block] = matrix
    b[block] = side
