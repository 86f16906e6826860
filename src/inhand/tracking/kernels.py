"""The object's Gauss-Newton system, summed where a pose is."""

import warp as wp

from inhand.kernels.fields import Fields, field_at
from inhand.kernels.hand_fit import TERMS, add_term, pixel_of, redescending
from inhand.kernels.object_fit import ObjectEvidence, hand_depth_at

wp.set_module_options({"enable_backward": False})


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
    terms: wp.array(dtype=float),
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
        terms: out, flat (block, TERMS); rotation before translation, camera axes.
    """
    block = first + wp.tid()
    at = block * TERMS
    for k in range(at, at + TERMS):
        terms[k] = 0.0
    pivot = wp.transform_point(T, centre)
    inverse = wp.transpose(T)
    t = wp.vec3(T[0, 3], T[1, 3], T[2, 3])
    for s in range(block * segment_stride, e.points.shape[0], n_blocks * segment_stride):
        p = e.points[s]
        value = field_at(fields, 0, wp.transform_vector(inverse, p - t))
        g = wp.transform_vector(T, wp.vec3(value[1], value[2], value[3]))
        w = e.weights[s] * redescending(value[0], width) * wp.max(0.0, wp.dot(g, e.normals[s]))
        if w > 0.0:
            add_term(terms, at, wp.cross(p - pivot, g), g, value[0], w)
    for s in range(block, n_points, n_blocks):
        p = wp.transform_point(T, points[s])
        n = wp.transform_vector(T, normals[s])
        facing = -wp.dot(n, p) / wp.length(p)
        if facing < 0.15:
            continue
        pixel = pixel_of(e.view.camera, p)
        if pixel < 0:
            continue
        d = e.view.depth[pixel]
        if d <= 0.0 or wp.abs(d - p[2]) > width:
            continue
        hand = hand_depth_at(e, pixel)
        if hand > 0.0 and wp.abs(hand - d) < 0.5 * e.near:
            continue
        r = (d / p[2] - 1.0) * wp.dot(n, p)
        w = image_weight * facing * redescending(r, width)
        w = w * wp.max(0.0, wp.dot(n, e.view.normals[pixel]))
        if w > 0.0:
            add_term(terms, at, wp.cross(p - pivot, n), n, r, w)
