"""Agreement of a posed hand with the depth image."""

import warp as wp

from inhand.kernels.block import block_sum
from inhand.kernels.bodies import nearest_body
from inhand.kernels.depth import Pinhole
from inhand.kernels.fields import Fields


@wp.struct
class DepthView:
    """The region of interest as kernels see it; images are flat, row by row."""

    camera: Pinhole
    depth: wp.array(dtype=float)
    """Depth [m], 0 where there is no reading."""
    normals: wp.array(dtype=wp.vec3)
    """Unit normals towards the camera, 0 where unknown."""
    missing: wp.array(dtype=float)
    """Share of missing readings around every pixel without a reading."""


@wp.struct
class Visibility:
    """How a surface point that faces the camera is judged by the pixel it falls on."""

    tolerance: float
    """Depth difference up to which the point agrees with the reading [m]."""
    violation: float
    """Penalty when the reading lies behind the point: the camera saw through it."""
    missing: float
    """Penalty in the middle of an area without readings."""
    hidden: float
    """Penalty when the reading lies in front of the point."""


@wp.func
def column_and_row(camera: Pinhole, p: wp.vec3):
    """Of the pixel that shows point `p`, as whole floating point numbers."""
    u = wp.floor(camera.fx * p[0] / p[2] + camera.cx + 0.5)
    v = wp.floor(camera.fy * p[1] / p[2] + camera.cy + 0.5)
    return u, v


@wp.func
def pixel_of(camera: Pinhole, p: wp.vec3):
    """Index of the pixel that shows point `p`, -1 outside the image."""
    if p[2] <= 1.0e-3:
        return -1
    column, row = column_and_row(camera, p)
    u, v = int(column), int(row)
    if u < 0 or v < 0 or u >= camera.width or v >= camera.height:
        return -1
    return v * camera.width + u


@wp.func
def coarse_pixel(camera: Pinhole, step: int, p: wp.vec3):
    """Index, in an image of every `step`-th pixel, for the pixel that shows point `p`."""
    column, row = column_and_row(camera, p)
    # A half away from whole multiples rounding does no harm; dividing integers takes far longer.
    share = 1.0 / float(step)
    u, v = int((column + 0.5) * share), int((row + 0.5) * share)
    return v * ((camera.width + step - 1) // step) + u


@wp.func
def judge_point(view: DepthView, rule: Visibility, p: wp.vec3, n: wp.vec3, pixel: int):
    """Score of one camera-facing surface point, between -violation and 1."""
    d = view.depth[pixel]
    if d <= 0.0:
        return -rule.missing * view.missing[pixel]
    behind = d - p[2]
    if behind > rule.tolerance:
        return -rule.violation
    if behind < -rule.tolerance:
        return -rule.hidden
    near = 1.0 - wp.abs(behind) / rule.tolerance
    return (0.4 + 0.6 * near) * wp.max(0.0, wp.dot(n, view.normals[pixel]))


@wp.kernel
def score_configurations(
    view: DepthView,
    rule: Visibility,
    T_camera_link: wp.array(dtype=wp.mat44),
    n_links: int,
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    link: wp.array(dtype=int),
    n_samples: int,
    early_samples: int,
    hopeless: float,
    fixed_depth: wp.array(dtype=float),
    fixed_step: int,
    nearest: wp.array(dtype=float),
    score: wp.array(dtype=wp.vec3),
    first: int,
):
    """One work item a configuration: mean judgement of its camera-facing surface samples.

    Args (beyond the obvious):
        T_camera_link: link poses of all configurations, flat (c * n_links).
        n_samples: the first so many surface samples take part.
        early_samples, hopeless: a configuration that scores less after so many samples is left at
            that; 0 leaves none.
        fixed_depth: rendered depth [m] of the parts that do not move, at every `fixed_step`-th
            pixel; what they hide is left out.
        nearest: least depth [m] around these pixels, 0 or infinite for none: samples that are
            looked through are excused where it is no farther than they are.
        score: out, mean judgement weighted by the projected area, the share of the projected area
            that nothing hides, and the mean judgement where the excused count 0.
    """
    item, lane = wp.tid()
    c = first + item
    total = float(0.0)
    excused = float(0.0)
    open_area = float(0.0)
    area = wp.where(lane == 0, 1.0e-6, 0.0)
    sums = wp.vec4()
    early = wp.min(early_samples, n_samples)
    for span in range(2):
        start, end = wp.where(span == 0, 0, early), wp.where(span == 0, early, n_samples)
        i = start + lane - wp.block_dim()
        while i + wp.block_dim() < end:
            i += wp.block_dim()
            T = T_camera_link[c * n_links + link[i]]
            p = wp.transform_point(T, points[i])
            n = wp.transform_vector(T, normals[i])
            facing = -wp.dot(n, p) / wp.length(p)
            if facing < 0.1:
                continue
            area += facing
            pixel = pixel_of(view.camera, p)
            if pixel < 0:
                continue
            # What something else hides, or explains already, says nothing.
            coarse = coarse_pixel(view.camera, fixed_step, p)
            other = fixed_depth[coarse]
            if other > 0.0 and other < p[2] + rule.tolerance:
                continue
            d = view.depth[pixel]
            if d <= 0.0 or d > p[2] - rule.tolerance:
                open_area += facing
            total += facing * judge_point(view, rule, p, n, pixel)
            if d > p[2] + rule.tolerance:
                beside = nearest[coarse]
                if beside > 0.0 and beside < p[2] + rule.tolerance:
                    excused += facing * rule.violation
        sums = wp.vec4(
            block_sum(total), block_sum(open_area), block_sum(total + excused), block_sum(area)
        )
        if span == 0 and early > 0 and sums[2] < hopeless * sums[3]:
            break
    score[c] = wp.vec3(sums[0], sums[1], sums[2]) / sums[3]


SupportSums = wp.types.vector(length=6, dtype=float)
"""Sums over camera-facing surface samples: the area; the judgements and the area that nothing hides
of what no other part hides or explains; both of the rest; the judgements of missing readings."""


@wp.kernel
def link_support(
    view: DepthView,
    rule: Visibility,
    T_camera_link: wp.array(dtype=wp.mat44),
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    start: wp.array(dtype=int),
    most: int,
    fields: Fields,
    apart: wp.array(dtype=int),
    hand_depth: wp.array(dtype=float),
    hand_link: wp.array(dtype=int),
    hand_step: int,
    sums: wp.array(dtype=SupportSums),
    first: int,
):
    """One work item a link: judgements of its camera-facing surface samples.

    Args (beyond the obvious):
        points, normals: surface samples of all links, link frames.
        start: first sample of every link, and the end of the last.
        most: about how many samples of a link are used.
        fields: distance fields of the links.
        apart: flat (L, L), whether two links belong to different parts of the hand; what another
            part hides, or explains as well, is summed apart.
        hand_depth, hand_link: rendered depth [m] of the hand and the link that it shows, -1 for
            none, at every `hand_step`-th pixel.
        sums: out, see `SupportSums`, for all samples of the link.
    """
    item, lane = wp.tid()
    k = first + item
    T = T_camera_link[k]
    sum = SupportSums()
    sum[0] = wp.where(lane == 0, 1.0e-6, 0.0)
    stride = wp.max(1, (start[k + 1] - start[k]) // most)
    parts = k * fields.start.shape[0]
    step = wp.block_dim() * stride
    i = start[k] + lane * stride - step
    while i + step < start[k + 1]:
        i += step
        p = wp.transform_point(T, points[i])
        n = wp.transform_vector(T, normals[i])
        facing = -wp.dot(n, p) / wp.length(p)
        if facing < 0.1:
            continue
        sum[0] += facing
        pixel = pixel_of(view.camera, p)
        if pixel < 0:
            continue
        _distance, _gradient, other = nearest_body(
            fields, T_camera_link, 0, apart, parts, p, rule.tolerance
        )
        coarse = coarse_pixel(view.camera, hand_step, p)
        shown = hand_link[coarse]
        hidden = shown >= 0 and hand_depth[coarse] < p[2] + rule.tolerance
        at = int(1)
        if other >= 0 or (hidden and apart[parts + wp.max(shown, 0)] != 0):
            at = int(3)
        judgement = facing * judge_point(view, rule, p, n, pixel)
        sum[at] += judgement
        d = view.depth[pixel]
        if d <= 0.0 or d > p[2] - rule.tolerance:
            sum[at + 1] += facing
        if d <= 0.0:
            sum[5] += judgement
    for at in range(6):
        sum[at] = block_sum(sum[at])
    sums[k] = float(stride) * sum


@wp.func
def redescending(r: float, width: float):
    """Tukey's weight: 1 at zero, 0 from `width` on."""
    x = r / width
    if x * x >= 1.0:
        return 0.0
    return (1.0 - x * x) * (1.0 - x * x)


@wp.func
def sample_residual(view: DepthView, p: wp.vec3, n: wp.vec3, width: float):
    """Distance [m] of a posed surface sample to the plane of the reading on its ray, its weight,
    which is 0 where the image does not show the sample, and the pixel, -1 if it cannot."""
    facing = -wp.dot(n, p) / wp.length(p)
    if facing < 0.15:
        return 0.0, 0.0, -1
    pixel = pixel_of(view.camera, p)
    if pixel < 0:
        return 0.0, 0.0, -1
    d = view.depth[pixel]
    if d <= 0.0 or wp.abs(d - p[2]) > width:
        return 0.0, 0.0, pixel
    r = (d / p[2] - 1.0) * wp.dot(n, p)
    w = facing * redescending(r, width) * wp.max(0.0, wp.dot(n, view.normals[pixel]))
    return r, w, pixel
