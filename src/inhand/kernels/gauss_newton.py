"""Gauss-Newton over wrist and joints, from the sums of `kernels.hand_terms`.

A work item is a start of the fit, with all its iterations; its block's threads share the points.
"""

import warp as wp

from inhand.kernels.block import sum_rows, wait_for_block
from inhand.kernels.hand_terms import FitProblem, FitState, add_terms
from inhand.kernels.kinematics import Twist, joint_twist, place_links
from inhand.kernels.normal_equations import solve_in_place
from inhand.kernels.transforms import rigid, turn

Matrix6d = wp.types.matrix(shape=(6, 6), dtype=wp.float64)


@wp.func
def begin_system(problem: FitProblem, state: FitState, s: int):
    """Bring the links of start `s` to their places, and its system to zero."""
    chain, H, g = problem.chain, state.H, state.g
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
    chain, H, g, twists = problem.chain, state.H, state.g, state.twists
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
def assemble(problem: FitProblem, state: FitState, s: int, lane: int):
    """Bring the links of start `s` to their places and make their sums one system H x = g.

    The parameters are rotation and translation of the wrist and the n independent joints.
    """
    if lane == 0:
        begin_system(problem, state, s)
    wait_for_block()
    add_terms(problem, state, s, lane)
    sum_rows(state.sums, s, lane)
    if lane == 0:
        for link in range(problem.chain.link_joint.shape[0]):
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
    T_prior = problem.prior.T_camera_hand
    axis, angle = wp.quat_to_axis_angle(wp.quat_from_matrix(T_prior[:3, :3] * wp.transpose(R)))
    tilt = angle * axis
    way = T_prior[:3, 3] - T[:3, 3]
    for a in range(3):
        H[s, a, a] = H[s, a, a] + problem.prior.rotation
        g[s, a] = g[s, a] + problem.prior.rotation * tilt[a]
        H[s, 3 + a, 3 + a] = H[s, 3 + a, 3 + a] + problem.prior.translation
        g[s, 3 + a] = g[s, 3 + a] + problem.prior.translation * way[a]
    for a in range(6, n):
        H[s, a, a] = H[s, a, a] + problem.joint_damping
    solve_in_place(H[s], g[s], n)
    most = wp.float64(0.3)
    for a in range(6, n):
        moved = state.q[s, a - 6] + wp.clamp(g[s, a], -most, most)
        state.q[s, a - 6] = wp.clamp(moved, problem.lower[a - 6], problem.upper[a - 6])
    rotation = wp.vec3d(g[s, 0], g[s, 1], g[s, 2])
    step = wp.vec3d(g[s, 3], g[s, 4], g[s, 5])
    state.T_camera_hand[s] = rigid(turn(rotation) * R, T[:3, 3] + step)
    state.iteration[s] = state.iteration[s] + 1


@wp.kernel
def assemble_systems(problem: FitProblem, state: FitState, first: int):
    """One work item a start: its system, without priors, where its joints and wrist are."""
    item, lane = wp.tid()
    assemble(problem, state, first + item, lane)


@wp.kernel
def refine_states(problem: FitProblem, state: FitState, first: int):
    """One work item a start: all its iterations."""
    item, lane = wp.tid()
    s = first + item
    for _ in range(problem.widths.shape[0]):
        assemble(problem, state, s, lane)
        if lane == 0:
            take_step(problem, state, s)
