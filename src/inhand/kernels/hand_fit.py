"""Agreement of a posed hand with the depth image: scores, and the terms of its Gauss-Newton fit."""

import warp as wp

from inhand.kernels.bodies import nearest_body
from inhand.kernels.depth import Pinhole
from inhand.kernels.fields import Fields
from inhand.kernels.kinematics import position_of

wp.set_module_options({"enable_backward": False})

# Per block and link: 21 numbers of the symmetric 6x6 matrix, 6 of the right-hand side, the weight.
TERMS = 28


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
def pixel_of(camera: Pinhole, p: wp.vec3):
    """Index of the pixel that shows point `p`, -1 outside the image."""
    if p[2] <= 1.0e-3:
        return -1
    u = int(wp.floor(camera.fx * p[0] / p[2] + camera.cx + 0.5))
    v = int(wp.floor(camera.fy * p[1] / p[2] + camera.cy + 0.5))
    if u < 0 or v < 0 or u >= camera.width or v >= camera.height:
        return -1
    return v * camera.width + u


@wp.func
def coarse_pixel(width: int, step: int, pixel: int):
    """Index in an image of every `step`-th pixel, for a pixel of an image of `width`."""
    coarse_width = (width + step - 1) // step
    return (pixel // width) // step * coarse_width + (pixel % width) // step


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
    score: wp.array(dtype=float),
    seen: wp.array(dtype=float),
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
        score: out, mean judgement weighted by the projected area.
        seen: out, share of the projected area that nothing hides.
    """
    c = first + wp.tid()
    total = float(0.0)
    open_area = float(0.0)
    area = float(1.0e-6)
    for i in range(n_samples):
        if i > 0 and i == early_samples and total < hopeless * area:
            break
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
        other = fixed_depth[coarse_pixel(view.camera.width, fixed_step, pixel)]
        if other > 0.0 and other < p[2] + rule.tolerance:
            continue
        d = view.depth[pixel]
        if d <= 0.0 or d > p[2] - rule.tolerance:
            open_area += facing
        total += facing * judge_point(view, rule, p, n, pixel)
    score[c] = total / area
    seen[c] = open_area / area


@wp.func
def add_term(
    out: wp.array(dtype=float), at: int, moment: wp.vec3, direction: wp.vec3, r: float, w: float
):
    """Add w j j^T and w j r to the terms at `at`, for j = (moment, direction)."""
    j = wp.vector(
        moment[0],
        moment[1],
        moment[2],
        direction[0],
        direction[1],
        direction[2],
    )
    k = at
    for a in range(6):
        wa = w * j[a]
        for b in range(a, 6):
            out[k] = out[k] + wa * j[b]
            k += 1
    for a in range(6):
        out[k] = out[k] + w * j[a] * r
        k += 1
    out[k] = out[k] + w


@wp.func
def redescending(r: float, width: float):
    """Tukey's weight: 1 at zero, 0 from `width` on."""
    x = r / width
    if x * x >= 1.0:
        return 0.0
    return (1.0 - x * x) * (1.0 - x * x)


@wp.kernel
def scene_to_hand_terms(
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    fields: Fields,
    spheres: wp.array(dtype=wp.vec4),
    used: wp.array(dtype=int),
    T_camera_link: wp.array(dtype=wp.mat44),
    T_camera_hand: wp.array(dtype=wp.mat44d),
    widths: wp.array(dtype=float),
    iteration: wp.array(dtype=int),
    n_blocks: int,
    stride: int,
    terms: wp.array(dtype=float),
    first: int,
):
    """One work item a start and block of scene points: distance to the nearest link's surface.

    Args (beyond the obvious):
        spheres: bounding sphere of every link's field, link frame (centre, radius) [m].
        used: per link, 0 leaves it out.
        T_camera_link: link poses of all starts, flat (s * n_links).
        T_camera_hand: wrists of all starts; rotations are about their origins.
        widths: width of the redescending weight in every iteration [m].
        iteration: which iteration every start is at.
        n_blocks: blocks per start, which take turns in taking points.
        stride: every so-many-th point takes part.
        terms: out, flat (s, block, link, TERMS).
    """
    item = first + wp.tid()
    start = item // n_blocks
    n_links = used.shape[0]
    for k in range(item * n_links * TERMS, (item + 1) * n_links * TERMS):
        terms[k] = 0.0
    c = wp.vec3(position_of(T_camera_hand[start]))
    width = widths[iteration[start]]
    for i in range(item % n_blocks * stride, points.shape[0], n_blocks * stride):
        p = points[i]
        distance, gradient, k = nearest_body(
            fields, spheres, T_camera_link, start * n_links, used, 0, p, width
        )
        if k < 0:
            continue
        w = redescending(distance, width) * wp.max(0.0, wp.dot(gradient, normals[i]))
        if w <= 0.0:
            continue
        at = (item * n_links + k) * TERMS
        add_term(terms, at, wp.cross(p - c, gradient), gradient, distance, w)


@wp.kernel
def hand_to_scene_terms(
    view: DepthView,
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    link: wp.array(dtype=int),
    used: wp.array(dtype=int),
    T_camera_link: wp.array(dtype=wp.mat44),
    T_camera_hand: wp.array(dtype=wp.mat44d),
    widths: wp.array(dtype=float),
    iteration: wp.array(dtype=int),
    n_blocks: int,
    stride: int,
    terms: wp.array(dtype=float),
    first: int,
):
    """One work item a start and block of surface samples: plane distance to the pixel they fall on.

    Arguments as `scene_to_hand_terms`; terms are added to what is there.
    """
    item = first + wp.tid()
    start = item // n_blocks
    block = item % n_blocks
    n_links = used.shape[0]
    c = wp.vec3(position_of(T_camera_hand[start]))
    width = widths[iteration[start]]
    for i in range(block * stride, points.shape[0], n_blocks * stride):
        k = link[i]
        if used[k] == 0:
            continue
        T = T_camera_link[start * n_links + k]
        p = wp.transform_point(T, points[i])
        n = wp.transform_vector(T, normals[i])
        facing = -wp.dot(n, p) / wp.length(p)
        if facing < 0.15:
            continue
        pixel = pixel_of(view.camera, p)
        if pixel < 0:
            continue
        d = view.depth[pixel]
        if d <= 0.0:
            continue
        # The reading on the ray through the sample.
        r = (d / p[2] - 1.0) * wp.dot(n, p)
        if wp.abs(d - p[2]) > width:
            continue
        w = facing * redescending(r, width) * wp.max(0.0, wp.dot(n, view.normals[pixel]))
        if w <= 0.0:
            continue
        at = (item * n_links + k) * TERMS
        add_term(terms, at, wp.cross(p - c, n), n, r, w)


@wp.kernel
def hand_distances(
    points: wp.array(dtype=wp.vec3),
    fields: Fields,
    spheres: wp.array(dtype=wp.vec4),
    T_camera_link: wp.array(dtype=wp.mat44),
    used: wp.array(dtype=int),
    farthest: float,
    distance: wp.array(dtype=float),
    first: int,
):
    """One work item a point: signed distance [m] to the posed hand, cut off at `farthest`."""
    i = first + wp.tid()
    nearest, _gradient, _link = nearest_body(
        fields, spheres, T_camera_link, 0, used, 0, points[i], farthest
    )
    distance[i] = nearest


@wp.kernel
def explained_weights(
    points: wp.array(dtype=wp.vec3),
    weights: wp.array(dtype=float),
    fields: Fields,
    spheres: wp.array(dtype=wp.vec4),
    T_camera_link: wp.array(dtype=wp.mat44),
    used: wp.array(dtype=int),
    near: float,
    explained: wp.array(dtype=float),
    first: int,
):
    """One work item a hand state: weight of the points within `near` of its surface [m].

    Args (beyond the obvious):
        T_camera_link: link poses of all hand states, flat (c * L).
        used: per link; 0 leaves it out.
        explained: out; a point counts less the farther away it is.
    """
    c = first + wp.tid()
    total = float(0.0)
    for i in range(points.shape[0]):
        distance, _gradient, _link = nearest_body(
            fields, spheres, T_camera_link, c * spheres.shape[0], used, 0, points[i], near
        )
        total += weights[i] * wp.max(0.0, 1.0 - wp.abs(distance) / near)
    explained[c] = total
