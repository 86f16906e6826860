"""Forward kinematics of a tree of joints, for many configurations at once."""

import warp as wp

from inhand.kernels.transforms import rigid, turn

Twist = wp.types.vector(length=6, dtype=wp.float64)
"""Rotation [rad], then motion of the body's point at the wrist [m]."""


@wp.struct
class Chain:
    """Joints and links as `inhand.kinematics.KinematicArrays` has them."""

    parent: wp.array(dtype=int)
    T_parent_joint: wp.array(dtype=wp.mat44d)
    axis: wp.array(dtype=wp.vec3d)
    kind: wp.array(dtype=int)
    """0 for a joint that turns, 1 for one that slides."""
    source: wp.array(dtype=int)
    multiplier: wp.array(dtype=wp.float64)
    offset: wp.array(dtype=wp.float64)
    link_joint: wp.array(dtype=int)
    T_joint_link: wp.array(dtype=wp.mat44d)


@wp.func
def joint_motion(chain: Chain, joint: int, position: wp.float64):
    """The transform by which a joint moves what it carries."""
    axis = chain.axis[joint]
    if chain.kind[joint] == 1:
        return rigid(wp.identity(n=3, dtype=wp.float64), position * axis)
    return rigid(turn(position * axis), wp.vec3d())


@wp.func
def place_links(
    chain: Chain,
    q: wp.array2d(dtype=wp.float64),
    T_camera_root: wp.mat44d,
    c: int,
    T_camera_joint: wp.array2d(dtype=wp.mat44d),
    T_camera_link: wp.array(dtype=wp.mat44),
):
    """Write where joints and links of configuration `c` are."""
    for joint in range(chain.parent.shape[0]):
        T = T_camera_root
        if chain.parent[joint] >= 0:
            T = T_camera_joint[c, chain.parent[joint]]
        position = q[c, chain.source[joint]] * chain.multiplier[joint] + chain.offset[joint]
        T_camera_joint[c, joint] = (
            T * chain.T_parent_joint[joint] * joint_motion(chain, joint, position)
        )
    links = chain.link_joint.shape[0]
    for link in range(links):
        T = T_camera_root
        if chain.link_joint[link] >= 0:
            T = T_camera_joint[c, chain.link_joint[link]]
        T_camera_link[c * links + link] = wp.mat44(T * chain.T_joint_link[link])


@wp.kernel
def pose_links(
    chain: Chain,
    q: wp.array2d(dtype=wp.float64),
    T_camera_hand: wp.array(dtype=wp.mat44d),
    T_camera_joint: wp.array2d(dtype=wp.mat44d),
    T_camera_link: wp.array(dtype=wp.mat44),
    first: int,
):
    """One work item a configuration: where its joints and links are.

    Args (beyond the obvious):
        q: positions of the independent joints [rad, m], (c, n).
        T_camera_hand: poses of the root, one for all configurations or one for each.
        T_camera_joint: out, frames the joints move, (c, j).
        T_camera_link: out, flat (c * L).
    """
    c = first + wp.tid()
    root = T_camera_hand[wp.min(c, T_camera_hand.shape[0] - 1)]
    place_links(chain, q, root, c, T_camera_joint, T_camera_link)


@wp.func
def joint_twist(chain: Chain, joint: int, T_camera_joint: wp.mat44d, wrist: wp.vec3d):
    """Twist, per unit of the independent joint, of what the joint carries; camera frame."""
    axis = T_camera_joint[:3, :3] * chain.axis[joint] * chain.multiplier[joint]
    if chain.kind[joint] == 1:
        zero = wp.float64(0.0)
        return Twist(zero, zero, zero, axis[0], axis[1], axis[2])
    motion = wp.cross(T_camera_joint[:3, 3] - wrist, axis)
    return Twist(axis[0], axis[1], axis[2], motion[0], motion[1], motion[2])
