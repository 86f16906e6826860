"""Agreement of posed objects with the depth image and the object segment; their refinement."""

import warp as wp

from inhand.kernels.block import block_sum, sum_rows, wait_for_block
from inhand.kernels.fields import Fields, field_at
from inhand.kernels.hand_fit import (
    DepthView,
    Visibility,
    coarse_pixel,
    judge_point,
    pixel_of,
    redescending,
    sample_residual,
)
from inhand.kernels.normal_equations import Matrix6, Vector6, row_of, solve_in_place
from inhand.kernels.transforms import rigid, to_local, turn

# A convex surface shows a quarter of its area on average (Cauchy), weighted by the facing angle.
VISIBLE_SHARE = wp.constant(0.25)


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
def hand_depth_at(e: ObjectEvidence, p: wp.vec3):
    """Rendered depth [m] of the hand at the pixel that shows point `p`, 0 where it is not."""
    return e.hand_depth[coarse_pixel(e.view.camera, e.hand_step, p)]


@wp.func
def visible_score(
    e: ObjectEvidence,
    rule: Visibility,
    T: wp.mat44,
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    n_points: int,
    lane: int,
):
    """Sum of the judgements of the camera-facing surface samples, per expected visible sample."""
    total = float(0.0)
    i = lane - wp.block_dim()
    while i + wp.block_dim() < n_points:
        i += wp.block_dim()
        p = wp.transform_point(T, points[i])
        n = wp.transform_vector(T, normals[i])
        facing = -wp.dot(n, p)
        if facing * facing < 0.01 * wp.dot(p, p) or facing < 0.0:
            continue
        facing = facing / wp.length(p)
        pixel = pixel_of(e.view.camera, p)
        if pixel < 0:
            continue
        hand = hand_depth_at(e, p)
        if hand > 0.0 and hand < p[2] - rule.tolerance:
            continue
        total += facing * judge_point(e.view, rule, p, n, pixel)
    return block_sum(total) / (VISIBLE_SHARE * wp.max(1.0, float(n_points)))


@wp.func
def explained_share(
    e: ObjectEvidence,
    T: wp.mat44,
    fields: Fields,
    near: float,
    stride: int,
    total: float,
    least: float,
    lane: int,
):
    """Weighted share of the segment's points that lie on the posed model's surface.

    Once it is certain to be less than `least`, counting ends with what it can be at most. Each
    thread of a block is certain by its own points alone.
    """
    explained = float(0.0)
    missed = float(0.0)
    step = wp.block_dim() * stride
    i = lane * stride - step
    while i + step < e.points.shape[0]:
        i += step
        if missed > (1.0 - least) * total:
            break
        w = e.weights[i]
        value = field_at(fields, 0, to_local(T, e.points[i]))
        x = wp.abs(value[0]) / near
        agreement = float(0.0)
        if x < 1.0:
            gradient = wp.transform_vector(T, value[1:4])
            agreement = (1.0 - x * x) * wp.max(0.0, wp.dot(gradient, e.normals[i]))
        explained += w * agreement
        missed += w * (1.0 - agreement)
    missed = block_sum(missed)
    if missed > (1.0 - least) * total:
        return 1.0 - missed / total
    return block_sum(explained) / total


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
    item, lane = wp.tid()
    i = first + item
    T = T_camera_object[i]
    seen = visible_score(e, rule, T, points, normals, n_points, lane)
    least = (worth - seen) / wp.max(e.share_weight, 1.0e-6)
    share = explained_share(e, T, fields, near, segment_stride, segment_weight, least, lane)
    agreement[i] = wp.vec2(seen, e.share_weight * share)


@wp.func
def moved(T: wp.mat44, x: Vector6, pivot: wp.vec3):
    """`T` after the rotation vector x[0:3] about `pivot` and the translation x[3:6]."""
    R = turn(x[:3])
    return rigid(R @ T[:3, :3], R @ (T[:3, 3] - pivot) + pivot + x[3:6])


@wp.func
def visible_residual(e: ObjectEvidence, p: wp.vec3, n: wp.vec3, width: float):
    """`sample_residual` of the object; the weight is 0 where the image shows the hand as well."""
    r, w, pixel = sample_residual(e.view, p, n, width)
    if w > 0.0:
        hand = hand_depth_at(e, p)
        if hand > 0.0 and wp.abs(hand - e.view.depth[pixel]) < 0.5 * e.near:
            w = 0.0
    return r, w


@wp.func
def block_system(A: Matrix6, b: Vector6, sums: wp.array3d(dtype=Vector6), i: int, lane: int):
    """Sums over the threads of the block of their parts of the system A x = b of pose `i`, which
    `sums`, (thread, pose, 7), has in the first thread's place afterwards."""
    for k in range(6):
        sums[lane, i, k] = A[k]
    sums[lane, i, 6] = b
    sum_rows(sums, i, lane)
    for k in range(6):
        A[k] = sums[0, i, k]
    b = sums[0, i, 6]
    # The first thread's next part must not come before the others have read this.
    wait_for_block()
    return A, b


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
    sums: wp.array3d(dtype=Vector6),
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
        sums: scratch by every thread of a block, (thread, pose, 7); the first thread's become the
            rows of A, and b, of the last iteration's system A x = b.
    """
    item, lane = wp.tid()
    i = first + item
    T = T_start[i]
    step = wp.block_dim() * segment_stride
    width = first_width
    shrink = wp.pow(last_width / first_width, 1.0 / wp.max(1.0, float(iterations - 1)))
    for _iteration in range(iterations):
        A = Matrix6()
        b = Vector6()
        pivot = wp.transform_point(T, centre)
        s = lane * segment_stride - step
        while s + step < e.points.shape[0]:
            s += step
            p = e.points[s]
            value = field_at(fields, 0, to_local(T, p))
            w = e.weights[s] * redescending(value[0], width)
            if w <= 0.0:
                continue
            g = wp.transform_vector(T, value[1:4])
            w = w * wp.max(0.0, wp.dot(g, e.normals[s]))
            if w <= 0.0:
                continue
            row = row_of(p - pivot, g)
            A += wp.outer(w * row, row)
            b += w * value[0] * row
        if image_weight > 0.0:
            s = lane - wp.block_dim()
            while s + wp.block_dim() < n_points:
                s += wp.block_dim()
                p = wp.transform_point(T, points[s])
                n = wp.transform_vector(T, normals[s])
                r, w = visible_residual(e, p, n, width)
                if w <= 0.0:
                    continue
                row = row_of(p - pivot, n)
                A += wp.outer(image_weight * w * row, row)
                b += image_weight * w * r * row
        A, b = block_system(A, b, sums, i, lane)
        trace = A[3, 3] + A[4, 4] + A[5, 5]
        damping = 0.003 * trace + 1.0e-6
        for k in range(3):
            A[k, k] += damping * scale * scale
            A[k + 3, k + 3] += damping
        T = moved(T, solve_in_place(A, b, 6), pivot)
        width = width * shrink
    T_refined[i] = T
