"""What pulls at a posed hand: the terms of its Gauss-Newton fit to the depth image."""

import warp as wp

from inhand.kernels.bodies import nearest_body
from inhand.kernels.fields import Fields
from inhand.kernels.hand_fit import DepthView, pixel_of, redescending
from inhand.kernels.kinematics import Chain, Twist, position_of

wp.set_module_options({"enable_backward": False})

# Per link: 21 numbers of the symmetric 6x6 matrix, 6 of the right-hand side, the weight.
TERMS = 28


@wp.struct
class WristPrior:
    """What is known of the wrist before looking, with the information it is known with."""

    T_camera_hand: wp.mat44d
    rotation: wp.float64
    """Per axis [1/rad^2]."""
    translation: wp.float64
    """Per axis [1/m^2]."""


@wp.struct
class FitProblem:
    """What a hand is fitted to, and how."""

    view: DepthView
    points: wp.array(dtype=wp.vec3)
    """Scene points [m], camera frame."""
    normals: wp.array(dtype=wp.vec3)
    fields: Fields
    spheres: wp.array(dtype=wp.vec4)
    """Bounding sphere of every link's field, link frame (centre, radius) [m]."""
    hand_points: wp.array(dtype=wp.vec3)
    """Surface samples of the links [m], link frames."""
    hand_normals: wp.array(dtype=wp.vec3)
    hand_link: wp.array(dtype=int)
    chain: Chain
    lower: wp.array(dtype=wp.float64)
    """Limits of the independent joints [rad, m]."""
    upper: wp.array(dtype=wp.float64)
    used: wp.array(dtype=int)
    """Per link, 0 leaves it out."""
    free: wp.array(dtype=int)
    """Per independent joint, 0 holds it."""
    prior: WristPrior
    information: wp.float64
    """Information of one point [1/m^2]."""
    joint_damping: wp.float64
    """Information that holds every joint where it is in a step [1/rad^2]."""
    widths: wp.array(dtype=float)
    """Width of the redescending weight in every iteration [m]."""
    stride: int
    """Every so-many-th point takes part."""


@wp.struct
class FitState:
    """Where the fits of several starts are, and their sums."""

    q: wp.array2d(dtype=wp.float64)
    """Positions of the independent joints [rad, m], (s, n)."""
    T_camera_hand: wp.array(dtype=wp.mat44d)
    """Wrists, (s); rotations are about their origins."""
    iteration: wp.array(dtype=int)
    """Iterations done, (s)."""
    T_camera_joint: wp.array2d(dtype=wp.mat44d)
    T_camera_link: wp.array(dtype=wp.mat44)
    """Flat (s * L)."""
    terms: wp.array(dtype=float)
    """Sums over the points, flat (s, link, TERMS), about the wrist's origin."""
    twists: wp.array2d(dtype=Twist)
    """Twist of what each joint carries per unit of its source, (s, j)."""
    H: wp.array3d(dtype=wp.float64)
    """Matrix of the system over wrist and joints, (s, 6 + n, 6 + n)."""
    g: wp.array2d(dtype=wp.float64)
    """Its right-hand side, (s, 6 + n)."""


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
def add_scene_terms(problem: FitProblem, state: FitState, start: int):
    """Add the distances of the scene points to the nearest link's surface."""
    links = problem.used.shape[0]
    c = wp.vec3(position_of(state.T_camera_hand[start]))
    width = problem.widths[state.iteration[start]]
    for i in range(0, problem.points.shape[0], problem.stride):
        p = problem.points[i]
        distance, gradient, k = nearest_body(
            problem.fields, problem.spheres, state.T_camera_link, start * links,
            problem.used, 0, p, width,
        )  # fmt: skip
        if k < 0:
            continue
        facing = wp.max(0.0, wp.dot(gradient, problem.normals[i]))
        w = redescending(distance, width) * facing
        if w <= 0.0:
            continue
        at = (start * links + k) * TERMS
        add_term(state.terms, at, wp.cross(p - c, gradient), gradient, distance, w)


@wp.func
def add_hand_terms(problem: FitProblem, state: FitState, start: int):
    """Add the plane distances of the surface samples to the readings on their rays."""
    links = problem.used.shape[0]
    c = wp.vec3(position_of(state.T_camera_hand[start]))
    width = problem.widths[state.iteration[start]]
    for i in range(0, problem.hand_points.shape[0], problem.stride):
        k = problem.hand_link[i]
        if problem.used[k] == 0:
            continue
        T = state.T_camera_link[start * links + k]
        p = wp.transform_point(T, problem.hand_points[i])
        n = wp.transform_vector(T, problem.hand_normals[i])
        facing = -wp.dot(n, p) / wp.length(p)
        if facing < 0.15:
            continue
        pixel = pixel_of(problem.view.camera, p)
        if pixel < 0:
            continue
        d = problem.view.depth[pixel]
        if d <= 0.0:
            continue
        r = (d / p[2] - 1.0) * wp.dot(n, p)
        if wp.abs(d - p[2]) > width:
            continue
        agreement = wp.max(0.0, wp.dot(n, problem.view.normals[pixel]))
        w = facing * redescending(r, width) * agreement
        if w <= 0.0:
            continue
        at = (start * links + k) * TERMS
        add_term(state.terms, at, wp.cross(p - c, n), n, r, w)


@wp.func
def add_terms(problem: FitProblem, state: FitState, start: int):
    """Sum over the points of the scene and of the hand."""
    size = problem.used.shape[0] * TERMS
    for k in range(start * size, (start + 1) * size):
        state.terms[k] = 0.0
    add_scene_terms(problem, state, start)
    add_hand_terms(problem, state, start)
