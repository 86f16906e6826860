"""What pulls at a posed hand: the terms of its Gauss-Newton fit to the depth image."""

import warp as wp

from inhand.kernels.bodies import nearest_body
from inhand.kernels.fields import Fields
from inhand.kernels.hand_fit import DepthView, redescending, sample_residual
from inhand.kernels.kinematics import Chain, Twist
from inhand.kernels.normal_equations import Vector6, row_of


@wp.struct
class FittedHand:
    """A hand as it is fitted."""

    fields: Fields
    points: wp.array(dtype=wp.vec3)
    """Surface samples of the links [m], link frames."""
    normals: wp.array(dtype=wp.vec3)
    link: wp.array(dtype=int)
    chain: Chain
    lower: wp.array(dtype=wp.float64)
    """Limits of the independent joints [rad, m]."""
    upper: wp.array(dtype=wp.float64)


@wp.struct
class FitProblem:
    """What a hand is fitted to, and how."""

    view: DepthView
    hand: FittedHand
    points: wp.array(dtype=wp.vec3)
    """Scene points [m], camera frame."""
    normals: wp.array(dtype=wp.vec3)
    used: wp.array(dtype=int)
    """Per link, 0 leaves it out."""
    free: wp.array(dtype=int)
    """Per independent joint, 0 holds it."""
    stride: int
    """Every so-many-th point takes part."""
    information: wp.float64
    """Information of one point [1/m^2]."""
    joint_damping: wp.float64
    """Information that holds every joint where it is in a step [1/rad^2]."""
    prior: wp.mat44d
    """What is known of the wrist's pose before looking."""
    prior_rotation: wp.float64
    """Information of it per axis [1/rad^2]."""
    prior_translation: wp.float64
    """[1/m^2]."""


@wp.struct
class FitState:
    """Where the fits of several starts are, and their sums."""

    q: wp.array2d(dtype=wp.float64)
    """Positions of the independent joints [rad, m], (s, n)."""
    T_camera_hand: wp.array(dtype=wp.mat44d)
    """Wrists, (s); rotations are about their origins."""
    T_camera_joint: wp.array2d(dtype=wp.mat44d)
    T_camera_link: wp.array(dtype=wp.mat44)
    """Flat (s * L)."""
    sums: wp.array3d(dtype=Vector6)
    """Sums by every thread of a block over the points of every link, (thread, s, 7 L): the rows of
    a matrix over rotation and translation about the wrist's origin, and the right-hand side."""
    twists: wp.array2d(dtype=Twist)
    """Twist of what each joint carries per unit of its source, (s, j)."""
    H: wp.array3d(dtype=wp.float64)
    """Matrix of the system over wrist and joints, (s, 6 + n, 6 + n)."""
    g: wp.array2d(dtype=wp.float64)
    """Its right-hand side, (s, 6 + n)."""


@wp.func
def add_term(state: FitState, start: int, lane: int, link: int, row: Vector6, r: float, w: float):
    """Add a residual [m] of a link, with its row of the Jacobian and its weight."""
    sums = state.sums
    for k in range(6):
        sums[lane, start, 7 * link + k] = sums[lane, start, 7 * link + k] + w * row[k] * row
    sums[lane, start, 7 * link + 6] = sums[lane, start, 7 * link + 6] + w * r * row


@wp.func
def add_scene_terms(problem: FitProblem, state: FitState, width: float, start: int, lane: int):
    """Add the distances of the scene points to the nearest link's surface."""
    links = problem.used.shape[0]
    c = wp.vec3(state.T_camera_hand[start][:3, 3])
    step = wp.block_dim() * problem.stride
    i = lane * problem.stride - step
    while i + step < problem.points.shape[0]:
        i += step
        p = problem.points[i]
        distance, gradient, k = nearest_body(
            problem.hand.fields, state.T_camera_link, start * links,
            problem.used, 0, p, width,
        )  # fmt: skip
        if k < 0:
            continue
        facing = wp.max(0.0, wp.dot(gradient, problem.normals[i]))
        w = redescending(distance, width) * facing
        if w > 0.0:
            add_term(state, start, lane, k, row_of(p - c, gradient), distance, w)


@wp.func
def add_hand_terms(problem: FitProblem, state: FitState, width: float, start: int, lane: int):
    """Add the plane distances of the surface samples to the readings on their rays."""
    hand, links = problem.hand, problem.used.shape[0]
    c = wp.vec3(state.T_camera_hand[start][:3, 3])
    step = wp.block_dim() * problem.stride
    i = lane * problem.stride - step
    while i + step < hand.points.shape[0]:
        i += step
        k = hand.link[i]
        if problem.used[k] == 0:
            continue
        T = state.T_camera_link[start * links + k]
        p = wp.transform_point(T, hand.points[i])
        n = wp.transform_vector(T, hand.normals[i])
        r, w, _pixel = sample_residual(problem.view, p, n, width)
        if w > 0.0:
            add_term(state, start, lane, k, row_of(p - c, n), r, w)


@wp.func
def add_terms(problem: FitProblem, state: FitState, width: float, start: int, lane: int):
    """Sum over this thread's share of the points of the scene and of the hand.

    `width`: of the redescending weight [m].
    """
    for k in range(state.sums.shape[2]):
        state.sums[lane, start, k] = Vector6()
    add_scene_terms(problem, state, width, start, lane)
    add_hand_terms(problem, state, width, start, lane)
