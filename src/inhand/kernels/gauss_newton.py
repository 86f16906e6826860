"""Steps of a Gauss-Newton over wrist and joints, from the sums of `kernels.hand_fit`."""

import warp as wp

from inhand.kernels.hand_fit import TERMS
from inhand.kernels.kinematics import Chain, Twist, joint_twist, position_of, rigid, rotation_of

wp.set_module_options({"enable_backward": False})

Matrix6 = wp.types.matrix(shape=(6, 6), dtype=wp.float64)


@wp.struct
class WristPrior:
    """What is known of the wrist before looking, with the information it is known with."""

    T_camera_hand: wp.mat44d
    rotation: wp.float64
    """Per axis [1/rad^2]."""
    translation: wp.float64
    """Per axis [1/m^2]."""


@wp.kernel
def normal_equations(
    chain: Chain,
    free: wp.array(dtype=int),
    T_camera_hand: wp.array(dtype=wp.mat44d),
    T_camera_joint: wp.array2d(dtype=wp.mat44d),
    terms: wp.array(dtype=float),
    n_blocks: int,
    twists: wp.array2d(dtype=Twist),
    H: wp.array3d(dtype=wp.float64),
    g: wp.array2d(dtype=wp.float64),
    first: int,
):
    """One work item a start: the links' sums as one system H x = g over wrist and joints.

    The parameters are rotation and translation of the wrist and the n independent joints. The twist
    of a link is that of the wrist plus those of the joints that carry it.

    Args (beyond the obvious):
        free: per independent joint, 0 holds it.
        terms: the links' sums, flat (s, block, link, TERMS), about the wrist's origin.
        twists: out, twist of what each joint carries per unit of its source, (s, j).
        H, g: out, (s, 6 + n, 6 + n) and (s, 6 + n).
    """
    s = first + wp.tid()
    for i in range(g.shape[1]):
        g[s, i] = wp.float64(0.0)
        for j in range(g.shape[1]):
            H[s, i, j] = wp.float64(0.0)
    wrist = position_of(T_camera_hand[s])
    for joint in range(chain.parent.shape[0]):
        twists[s, joint] = Twist()
        if free[chain.source[joint]] != 0:
            twists[s, joint] = joint_twist(chain, joint, T_camera_joint[s, joint], wrist)
    links = chain.link_joint.shape[0]
    for link in range(links):
        A = Matrix6()
        b = Twist()
        for block in range(n_blocks):
            k = ((s * n_blocks + block) * links + link) * TERMS
            for row in range(6):
                for column in range(row, 6):
                    A[row, column] += wp.float64(terms[k])
                    k += 1
            for row in range(6):
                b[row] += wp.float64(terms[k])
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


@wp.kernel
def gauss_newton_step(
    H: wp.array3d(dtype=wp.float64),
    g: wp.array2d(dtype=wp.float64),
    information: wp.float64,
    prior: WristPrior,
    joint_damping: wp.float64,
    lower: wp.array(dtype=wp.float64),
    upper: wp.array(dtype=wp.float64),
    q: wp.array2d(dtype=wp.float64),
    T_camera_hand: wp.array(dtype=wp.mat44d),
    iteration: wp.array(dtype=int),
    first: int,
):
    """One work item a start: solve the system with its priors and move joints and wrist.

    Args (beyond the obvious):
        H, g: see `normal_equations`; overwritten.
        information: information of one point [1/m^2].
        joint_damping: information that holds every joint where it is [1/rad^2].
        lower, upper: limits of the joints [rad, m].
        q, T_camera_hand: in and out.
        iteration: in and out, iterations of every start.
    """
    s = first + wp.tid()
    n = g.shape[1]
    for a in range(n):
        g[s, a] = g[s, a] * information
        for b in range(n):
            H[s, a, b] = H[s, a, b] * information
    T = T_camera_hand[s]
    R = rotation_of(T)
    turn = rotation_vector(rotation_of(prior.T_camera_hand) * wp.transpose(R))
    way = position_of(prior.T_camera_hand) - position_of(T)
    for a in range(3):
        H[s, a, a] = H[s, a, a] + prior.rotation
        g[s, a] = g[s, a] + prior.rotation * turn[a]
        H[s, 3 + a, 3 + a] = H[s, 3 + a, 3 + a] + prior.translation
        g[s, 3 + a] = g[s, 3 + a] + prior.translation * way[a]
    for a in range(6, n):
        H[s, a, a] = H[s, a, a] + joint_damping
    solve_in_place(H, g, s)
    most = wp.float64(0.3)
    for a in range(6, n):
        moved = q[s, a - 6] + wp.clamp(g[s, a], -most, most)
        q[s, a - 6] = wp.clamp(moved, lower[a - 6], upper[a - 6])
    step = wp.vec3d(g[s, 3], g[s, 4], g[s, 5])
    T_camera_hand[s] = rigid(turned(R, wp.vec3d(g[s, 0], g[s, 1], g[s, 2])), position_of(T) + step)
    iteration[s] = iteration[s] + 1
