"""Gauss-Newton over wrist and joints, from the sums of `kernels.hand_terms`.

A work item is a start of the fit: the few threads of a CPU have one each, for all its iterations.
"""

import warp as wp

from inhand.kernels.hand_terms import TERMS, FitProblem, FitState, add_terms
from inhand.kernels.kinematics import (
    Twist,
    joint_twist,
    place_links,
    position_of,
    rigid,
    rotation_of,
)

wp.set_module_options({"enable_backward": False})

Matrix6 = wp.types.matrix(shape=(6, 6), dtype=wp.float64)


@wp.func
def assemble(problem: FitProblem, state: FitState, s: int):
    """Bring the links of start `s` to their places and make their sums one system H x = g.

    The parameters are rotation and translation of the wrist and the n independent joints. The twist
    of a link is that of the wrist plus those of the joints that carry it.
    """
    chain = problem.chain
    H, g, twists = state.H, state.g, state.twists
    wrist_pose = state.T_camera_hand[s]
    place_links(chain, state.q, wrist_pose, s, state.T_camera_joint, state.T_camera_link)
    add_terms(problem, state, s)
    for i in range(g.shape[1]):
        g[s, i] = wp.float64(0.0)
        for j in range(g.shape[1]):
            H[s, i, j] = wp.float64(0.0)
    wrist = position_of(wrist_pose)
    for joint in range(chain.parent.shape[0]):
        twists[s, joint] = Twist()
        if problem.free[chain.source[joint]] != 0:
            twists[s, joint] = joint_twist(chain, joint, state.T_camera_joint[s, joint], wrist)
    links = chain.link_joint.shape[0]
    for link in range(links):
        A = Matrix6()
        b = Twist()
        k = (s * links + link) * TERMS
        for row in range(6):
            for column in range(row, 6):
                A[row, column] = wp.float64(state.terms[k])
                k += 1
        for row in range(6):
            b[row] = wp.float64(state.terms[k])
            k += 1
        for row in range(6):
            g[s, row] = g[s, row] + b[row]
            for column in range(row):
                A[row, column] = A[column, row]
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
def solve_in_place(H: wp.array3d(dtype=wp.float64), g: wp.array2d(dtype=wp.float64), s: int):
    """Replace g[s] by the solution of H[s] x = g[s], by Cholesky; H[s] is overwritten."""
    n = g.shape[1]
    for i in range(n):
        for j in range(i + 1):
            rest = H[s, i, j]
            for k in range(j):
                rest -= H[s, i, k] * H[s, j, k]
            if i == j:
                H[s, i, i] = wp.sqrt(rest)
            else:
                H[s, i, j] = rest / H[s, j, j]
    for i in range(n):
        rest = g[s, i]
        for k in range(i):
            rest -= H[s, i, k] * g[s, k]
        g[s, i] = rest / H[s, i, i]
    for back in range(n):
        i = n - 1 - back
        rest = g[s, i]
        for k in range(i + 1, n):
            rest -= H[s, k, i] * g[s, k]
        g[s, i] = rest / H[s, i, i]


@wp.func
def rotation_vector(R: wp.mat33d):
    """Axis times angle [rad] of a rotation."""
    q = wp.quat_from_matrix(R)
    half = wp.vec3d(q[0], q[1], q[2])
    sine = wp.length(half)
    scale = wp.float64(2.0)
    if q[3] < wp.float64(0.0):
        scale = -scale
    if sine > wp.float64(1.0e-12):
        scale *= wp.atan2(sine, wp.abs(q[3])) / sine
    return scale * half


@wp.func
def turned(R: wp.mat33d, turn: wp.vec3d):
    """Rotation `R` followed by a rotation vector [rad]."""
    angle = wp.length(turn)
    if angle < wp.float64(1.0e-12):
        return R
    return wp.quat_to_matrix(wp.quat_from_axis_angle(turn / angle, angle)) * R


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
    R = rotation_of(T)
    tilt = rotation_vector(rotation_of(problem.prior.T_camera_hand) * wp.transpose(R))
    way = position_of(problem.prior.T_camera_hand) - position_of(T)
    for a in range(3):
        H[s, a, a] = H[s, a, a] + problem.prior.rotation
        g[s, a] = g[s, a] + problem.prior.rotation * tilt[a]
        H[s, 3 + a, 3 + a] = H[s, 3 + a, 3 + a] + problem.prior.translation
        g[s, 3 + a] = g[s, 3 + a] + problem.prior.translation * way[a]
    for a in range(6, n):
        H[s, a, a] = H[s, a, a] + problem.joint_damping
    solve_in_place(H, g, s)
    most = wp.float64(0.3)
    for a in range(6, n):
        moved = state.q[s, a - 6] + wp.clamp(g[s, a], -most, most)
        state.q[s, a - 6] = wp.clamp(moved, problem.lower[a - 6], problem.upper[a - 6])
    step = wp.vec3d(g[s, 3], g[s, 4], g[s, 5])
    turn = wp.vec3d(g[s, 0], g[s, 1], g[s, 2])
    state.T_camera_hand[s] = rigid(turned(R, turn), position_of(T) + step)
    state.iteration[s] = state.iteration[s] + 1


@wp.kernel
def assemble_systems(problem: FitProblem, state: FitState, first: int):
    """One work item a start: its system, without priors, where its joints and wrist are."""
    assemble(problem, state, first + wp.tid())


@wp.kernel
def refine_states(problem: FitProblem, state: FitState, first: int):
    """One work item a start: all its iterations."""
    s = first + wp.tid()
    for _ in range(problem.widths.shape[0]):
        assemble(problem, state, s)
        take_step(problem, state, s)
