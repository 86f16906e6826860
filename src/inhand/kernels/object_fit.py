"""Agreement of posed objects with the depth image and the object segment; their refinement."""

import warp as wp

from inhand.kernels.fields import Fields, field_at
from inhand.kernels.hand_fit import (
    DepthView,
    Visibility,
    coarse_pixel,
    judge_point,
    pixel_of,
    redescending,
)

wp.set_module_options({"enable_backward": False})

# A convex surface shows a quarter of its area on average (Cauchy), weighted by the facing angle.
VISIBLE_SHARE = wp.constant(0.25)

Matrix6 = wp.types.matrix(shape=(6, 6), dtype=float)
Vector6 = wp.types.vector(length=6, dtype=float)


@wp.struct
class ObjectEvidence:
    """What an object pose is held against."""

    view: DepthView
    hand_depth: wp.array(dtype=float)
    """Rendered depth of the estimated hand [m], every `hand_step`-th pixel, 0 where it is not."""
    hand_step: int
    points: wp.array(dtype=wp.vec3)
    """Segment points [m], camera frame."""
    normals: wp.array(dtype=wp.vec3)
    weights: wp.array(dtype=float)
    """Probability that each segment point is the object's."""
    near: float
    """A segment point this near to the model's surface is explained [m]."""
    share_weight: float
    """Weight of the explained share of the segment against the visible share of the model."""


@wp.func
def hand_depth_at(e: ObjectEvidence, pixel: int):
    """Rendered depth [m] of the hand at a pixel of the region of interest, 0 where it is not."""
    return e.hand_depth[coarse_pixel(e.view.camera.width, e.hand_step, pixel)]


@wp.func
def visible_score(
    e: ObjectEvidence,
    rule: Visibility,
    T: wp.mat44,
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    n_points: int,
):
    """Sum of the judgements of the camera-facing surface samples, per expected visible sample."""
    total = float(0.0)
    for i in range(n_points):
        p = wp.transform_point(T, points[i])
        n = wp.transform_vector(T, normals[i])
        facing = -wp.dot(n, p)
        if facing * facing < 0.01 * wp.dot(p, p) or facing < 0.0:
            continue
        facing = facing / wp.length(p)
        pixel = pixel_of(e.view.camera, p)
        if pixel < 0:
            continue
        hand = hand_depth_at(e, pixel)
        if hand > 0.0 and hand < p[2] - rule.tolerance:
            continue
        total += facing * judge_point(e.view, rule, p, n, pixel)
    return total / (VISIBLE_SHARE * wp.max(1.0, float(n_points)))


@wp.func
def explained_share(
    e: ObjectEvidence,
    T: wp.mat44,
    fields: Fields,
    near: float,
    stride: int,
    total: float,
    least: float,
):
    """Weighted share of the segment's points that lie on the posed model's surface.

    Once it is certain to be less than `least`, counting ends with what it can be at most.
    """
    explained = float(0.0)
    missed = float(0.0)
    inverse = wp.transpose(T)
    t = wp.vec3(T[0, 3], T[1, 3], T[2, 3])
    for i in range(0, e.points.shape[0], stride):
        if missed > (1.0 - least) * total:
            return 1.0 - missed / total
        w = e.weights[i]
        value = field_at(fields, 0, wp.transform_vector(inverse, e.points[i] - t))
        x = wp.abs(value[0]) / near
        agreement = float(0.0)
        if x < 1.0:
            gradient = wp.transform_vector(T, wp.vec3(value[1], value[2], value[3]))
            agreement = (1.0 - x * x) * wp.max(0.0, wp.dot(gradient, e.normals[i]))
        explained += w * agreement
        missed += w * (1.0 - agreement)
    return explained / total


@wp.kernel
def score_poses(
    e: ObjectEvidence,
    rule: Visibility,
    T_camera_object: wp.array(dtype=wp.mat44),
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    n_points: int,
    fields: Fields,
    near: float,
    segment_stride: int,
    segment_weight: float,
    worth: float,
    agreement: wp.array(dtype=wp.vec2),
    first: int,
):
    """One work item a pose: how well it explains the image and the segment.

    Args (beyond the obvious):
        points, normals: model surface samples, object frame; the first `n_points` are used.
        near: a segment point this near to the model's surface is explained [m].
        segment_stride: every how many segment points one is used.
        segment_weight: sum of the weights of these.
        worth: a pose that is certain to score less is left with some score below this.
        agreement: out, scores of what is seen and of the explained share, whose sum is the score.
    """
    i = first + wp.tid()
    T = T_camera_object[i]
    seen = visible_score(e, rule, T, points, normals, n_points)
    least = (worth - seen) / wp.max(e.share_weight, 1.0e-6)
    share = explained_share(e, T, fields, near, segment_stride, segment_weight, least)
    agreement[i] = wp.vec2(seen, e.share_weight * share)


@wp.func
def solve6(A: Matrix6, b: Vector6):
    """Solution of A x = b for a symmetric positive definite A, by Cholesky."""
    L = Matrix6()
    y = Vector6()
    for i in range(6):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                L[i, i] = wp.sqrt(wp.max(s, 1.0e-12))
            else:
                L[i, j] = s / L[j, j]
    for i in range(6):
        s = b[i]
        for k in range(i):
            s -= L[i, k] * y[k]
        y[i] = s / L[i, i]
    x = Vector6()
    for r in range(6):
        i = 5 - r
        s = y[i]
        for k in range(i + 1, 6):
            s -= L[k, i] * x[k]
        x[i] = s / L[i, i]
    return x


@wp.func
def moved(T: wp.mat44, x: Vector6, pivot: wp.vec3):
    """`T` after the rotation vector x[0:3] about `pivot` and the translation x[3:6]."""
    w = wp.vec3(x[0], x[1], x[2])
    angle = wp.length(w)
    R = wp.identity(n=3, dtype=float)
    if angle > 1.0e-9:
        R = wp.quat_to_matrix(wp.quat_from_axis_angle(w / angle, angle))
    old = wp.mat33(T[0, 0], T[0, 1], T[0, 2], T[1, 0], T[1, 1], T[1, 2], T[2, 0], T[2, 1], T[2, 2])
    t = wp.vec3(T[0, 3], T[1, 3], T[2, 3])
    R_new = R @ old
    t_new = R @ (t - pivot) + pivot + wp.vec3(x[3], x[4], x[5])
    return wp.mat44(
        R_new[0, 0], R_new[0, 1], R_new[0, 2], t_new[0],
        R_new[1, 0], R_new[1, 1], R_new[1, 2], t_new[1],
        R_new[2, 0], R_new[2, 1], R_new[2, 2], t_new[2],
        0.0, 0.0, 0.0, 1.0,
    )  # fmt: skip


@wp.func
def sample_residual(e: ObjectEvidence, p: wp.vec3, n: wp.vec3, width: float):
    """Distance [m] of a posed model sample to the plane of the reading on its ray, and its weight.

    The weight is 0 where the image does not show the sample, or shows the hand there.
    """
    facing = -wp.dot(n, p) / wp.length(p)
    if facing < 0.15:
        return 0.0, 0.0
    pixel = pixel_of(e.view.camera, p)
    if pixel < 0:
        return 0.0, 0.0
    d = e.view.depth[pixel]
    if d <= 0.0 or wp.abs(d - p[2]) > width:
        return 0.0, 0.0
    hand = hand_depth_at(e, pixel)
    if hand > 0.0 and wp.abs(hand - d) < 0.5 * e.near:
        return 0.0, 0.0
    r = (d / p[2] - 1.0) * wp.dot(n, p)
    w = facing * redescending(r, width) * wp.max(0.0, wp.dot(n, e.view.normals[pixel]))
    return r, w


@wp.kernel
def refine_poses(
    e: ObjectEvidence,
    T_start: wp.array(dtype=wp.mat44),
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    n_points: int,
    fields: Fields,
    centre: wp.vec3,
    scale: float,
    iterations: int,
    first_width: float,
    last_width: float,
    segment_stride: int,
    image_weight: float,
    T_refined: wp.array(dtype=wp.mat44),
    first: int,
):
    """One work item a pose: Gauss-Newton of the segment onto the model's distance field.

    Visible model samples are pulled to the reading on their ray as well, so that the fit also
    sees model surface that the segment misses.

    Args (beyond the obvious):
        centre: centre of the model, object frame [m]; rotations are about it.
        scale: radius of the model [m]; makes rotations and translations comparable in the damping.
        first_width, last_width: width of the redescending weight, narrowing geometrically [m].
        image_weight: weight of one visible model sample against one segment point.
    """
    i = first + wp.tid()
    T = T_start[i]
    width = first_width
    shrink = wp.pow(last_width / first_width, 1.0 / wp.max(1.0, float(iterations - 1)))
    for _iteration in range(iterations):
        A = Matrix6()
        b = Vector6()
        pivot = wp.transform_point(T, centre)
        inverse = wp.transpose(T)
        t = wp.vec3(T[0, 3], T[1, 3], T[2, 3])
        for s in range(0, e.points.shape[0], segment_stride):
            p = e.points[s]
            value = field_at(fields, 0, wp.transform_vector(inverse, p - t))
            w = e.weights[s] * redescending(value[0], width)
            if w <= 0.0:
                continue
            g = wp.transform_vector(T, wp.vec3(value[1], value[2], value[3]))
            w = w * wp.max(0.0, wp.dot(g, e.normals[s]))
            if w <= 0.0:
                continue
            m = wp.cross(p - pivot, g)
            j = Vector6(m[0], m[1], m[2], g[0], g[1], g[2])
            for r in range(6):
                wr = w * j[r]
                b[r] += wr * value[0]
                for c in range(r + 1):
                    A[r, c] += wr * j[c]
        if image_weight > 0.0:
            for s in range(n_points):
                p = wp.transform_point(T, points[s])
                n = wp.transform_vector(T, normals[s])
                r0, w = sample_residual(e, p, n, width)
                if w <= 0.0:
                    continue
                w = image_weight * w
                m = wp.cross(p - pivot, n)
                j = Vector6(m[0], m[1], m[2], n[0], n[1], n[2])
                for r in range(6):
                    wr = w * j[r]
                    b[r] += wr * r0
                    for c in range(r + 1):
                        A[r, c] += wr * j[c]
        trace = A[3, 3] + A[4, 4] + A[5, 5]
        damping = 0.003 * trace + 1.0e-6
        for r in range(3):
            A[r, r] += damping * scale * scale
            A[r + 3, r + 3] += damping
        T = moved(T, solve6(A, b), pivot)
        width = width * shrink
    T_refined[i] = T
