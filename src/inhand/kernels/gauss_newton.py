"""Gauss-Newton over wrist and joints, from the sums of `kernels.hand_terms`.

A work item is a start of the fit, with all its iterations; its block's threads share the points.
"""

import warp as wp

from inhand.kernels.block import sum_rows, wait_for_block
from inhand.kernels.hand_fit import DepthView
from inhand.kernels.hand_terms import FitProblem, FitState, FittedHand, add_terms
from inhand.kernels.kinematics import Twist, joint_twist, place_links
from inhand.kernels.normal_equations import Vector6, solve_in_place
from inhand.kernels.transforms import rigid, turn

Matrix6d = wp.types.matrix(shape=(6, 6), dtype=wp.float64)


@wp.func
def begin_system(problem: FitProblem, state: FitState, s: int):
    """Bring the links of start `s` to their places, and its system to zero."""
    chain, H, g = problem.hand.chain, state.H, state.g
    wrist_pose = state.T_camera_hand[s]
    place_links(chain, state.q, wrist_pose, s, state.T_camera_joint, state.T_camera_link)
    for i in range(g.shape[1]):
        g[s, i] = wp.float64(0.0)
        for j in range(g.shape[1]):
            H[s, i, j] = wp.float64(0.0)
    wrist = wrist_pose[:3, 3]
    for joint in range(chain.parent.shape[0]):
        state.twists[s, joint] = Twist()
        if problem.free[chain.source[joint]] != 0:
            T_joint = state.T_camera_joint[s, joint]
            state.twists[s, joint] = joint_twist(chain, joint, T_joint, wrist)


@wp.func
def add_link(problem: FitProblem, state: FitState, s: int, link: int):
    """Add the sums of a link to the system of start `s`.

    The twist of a link is that of the wrist plus those of the joints that carry it.
    """
    chain, H, g, twists = problem.hand.chain, state.H, state.g, state.twists
    A = Matrix6d()
    for row in range(6):
        A[row] = Twist(state.sums[0, s, 7 * link + row])
    b = Twist(state.sums[0, s, 7 * link + 6])
    for row in range(6):
        g[s, row] = g[s, row] + b[row]
        for column in range(6):
            H[s, row, column] = H[s, row, column] + A[row, column]
    joint = chain.link_joint[link]
    while joint >= 0:
        twist = twists[s, joint]
        pull = A * twist
        p = 6 + chain.source[joint]
        g[s, p] = g[s, p] + wp.dot(twist, b)
        for row in range(6):
            H[s, row, p] = H[s, row, p] + pull[row]
            H[s, p, row] = H[s, p, row] + pull[row]
        other = chain.link_joint[link]
        while other >= 0:
            r = 6 + chain.source[other]
            H[s, p, r] = H[s, p, r] + wp.dot(twists[s, other], pull)
            other = chain.parent[other]
        joint = chain.parent[joint]


@wp.func
def assemble(problem: FitProblem, state: FitState, width: float, s: int, lane: int):
    """Bring the links of start `s` to their places and make their sums one system H x = g.

    The parameters are rotation and translation of the wrist and the n independent joints.
    """
    if lane == 0:
        begin_system(problem, state, s)
    wait_for_block()
    add_terms(problem, state, width, s, lane)
    sum_rows(state.sums, s, lane)
    if lane == 0:
        for link in range(problem.hand.chain.link_joint.shape[0]):
            add_link(problem, state, s, link)


@wp.func
def take_step(problem: FitProblem, state: FitState, s: int):
    """Solve the system of start `s` with its priors and move joints and wrist."""
    H, g = state.H, state.g
    n = g.shape[1]
    for a in range(n):
        g[s, a] = g[s, a] * problem.information
        for b in range(n):
            H[s, a, b] = H[s, a, b] * problem.information
    T = state.T_camera_hand[s]
    R = T[:3, :3]
    T_prior = problem.prior
    axis, angle = wp.quat_to_axis_angle(wp.quat_from_matrix(T_prior[:3, :3] * wp.transpose(R)))
    tilt = angle * axis
    way = T_prior[:3, 3] - T[:3, 3]
    for a in range(3):
        H[s, a, a] = H[s, a, a] + problem.prior_rotation
        g[s, a] = g[s, a] + problem.prior_rotation * tilt[a]
        H[s, 3 + a, 3 + a] = H[s, 3 + a, 3 + a] + problem.prior_translation
        g[s, 3 + a] = g[s, 3 + a] + problem.prior_translation * way[a]
    for a in range(6, n):
        H[s, a, a] = H[s, a, a] + problem.joint_damping
    solve_in_place(H[s], g[s], n)
    most = wp.float64(0.3)
    for a in range(6, n):
        moved = state.q[s, a - 6] + wp.clamp(g[s, a], -most, most)
        state.q[s, a - 6] = wp.clamp(moved, problem.hand.lower[a - 6], problem.hand.upper[a - 6])
    rotation = wp.vec3d(g[s, 0], g[s, 1], g[s, 2])
    step = wp.vec3d(g[s, 3], g[s, 4], g[s, 5])
    state.T_camera_hand[s] = rigid(turn(rotation) * R, T[:3, 3] + step)


@wp.kernel
def refine_states(
    view: DepthView,
    hand: FittedHand,
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    used: wp.array(dtype=int),
    free: wp.array(dtype=int),
    stride: int,
    information: wp.float64,
    joint_damping: wp.float64,
    prior: wp.mat44d,
    prior_rotation: wp.float64,
    prior_translation: wp.float64,
    widths: wp.array(dtype=float),
    moving: int,
    q: wp.array2d(dtype=wp.float64),
    T_camera_hand: wp.array(dtype=wp.mat44d),
    T_camera_joint: wp.array2d(dtype=wp.mat44d),
    T_camera_link: wp.array(dtype=wp.mat44),
    sums: wp.array3d(dtype=Vector6),
    twists: wp.array2d(dtype=Twist),
    H: wp.array3d(dtype=wp.float64),
    g: wp.array2d(dtype=wp.float64),
    first: int,
):
    """One work item a start: all its iterations.

    Args (beyond the members of `FitProblem` and `FitState`):
        widths: width of the redescending weight in every iteration [m].
        moving: 0 leaves joints and wrists where they are, and the last systems without priors.
    """
    item, lane = wp.tid()
    problem = FitProblem(  # type: ignore[call-arg]
        view, hand, points, normals, used, free, stride, information, joint_damping,
        prior, prior_rotation, prior_translation,
    )  # fmt: skip
    state = FitState(  # type: ignore[call-arg]
        q, T_camera_hand, T_camera_joint, T_camera_link, sums, twists, H, g
    )
    for i in range(widths.shape[0]):
        assemble(problem, state, widths[i], first + item, lane)
        if moving != 0 and lane == 0:
            take_step(problem, state, first + item)
