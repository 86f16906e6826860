"""Forward kinematics of a tree of joints, as flat arrays that numpy and the kernels share."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inhand.errors import InputError
from inhand.geometry.se3 import Array, exp
from inhand.urdf import Robot, UrdfJoint

REVOLUTE, PRISMATIC = 0, 1


@dataclass(frozen=True, eq=False)
class KinematicArrays:
    """The movable joints of a hand in topological order, and the links they carry.

    A movable joint stands behind the joints that carry it; fixed joints are folded into the
    transforms. Positions of mimic joints follow from the n independent ones, q.
    """

    parent: NDArray[np.int32]
    """Index of the movable joint that carries each joint, -1 for the root link; shape (j,)."""
    T_parent_joint: Array
    """Pose of each joint's frame at position zero in the frame of `parent`, shape (j, 4, 4)."""
    axis: Array
    """Unit axis in the joint's frame, shape (j, 3)."""
    kind: NDArray[np.int32]
    """REVOLUTE (0) or PRISMATIC (1), shape (j,)."""
    source: NDArray[np.int32]
    """Index of the independent joint in q that each joint follows, shape (j,)."""
    multiplier: Array
    """Joint position = multiplier * q[source] + offset, shape (j,)."""
    offset: Array
    """See `multiplier` [rad, m], shape (j,)."""
    link_joint: NDArray[np.int32]
    """Index of the movable joint that carries each link, -1 for the root link; shape (L,)."""
    T_joint_link: Array
    """Pose of each link in the frame of its `link_joint`, or of the root; shape (L, 4, 4)."""

    def joint_positions(self, q: Array) -> Array:
        """Positions [rad, m] of all movable joints, shape (..., j), from q, shape (..., n)."""
        return np.asarray(q[..., self.source] * self.multiplier + self.offset)

    def joint_poses(self, q: Array) -> Array:
        """Poses of the frames the joints move, in the root frame: (..., n) -> (..., j, 4, 4)."""
        motion = self.joint_positions(q)[..., None] * self.axis
        turns = np.where(self.kind[:, None] == REVOLUTE, motion, 0.0)
        steps = self.T_parent_joint @ exp(np.concatenate([turns, motion - turns], axis=-1))
        poses = np.empty_like(steps)
        for i, parent in enumerate(self.parent):
            step = steps[..., i, :, :]
            poses[..., i, :, :] = step if parent < 0 else poses[..., parent, :, :] @ step
        return poses

    def link_poses(self, q: Array) -> Array:
        """Poses of the links in the root frame: (..., n) -> (..., L, 4, 4)."""
        joints = self.joint_poses(q)
        root = np.broadcast_to(np.eye(4), (*joints.shape[:-3], 1, 4, 4))
        frames = np.concatenate([joints, root], axis=-3)  # index -1 is the root
        return np.asarray(frames[..., self.link_joint, :, :] @ self.T_joint_link)

    def part(self, links: Sequence[int]) -> tuple["KinematicArrays", NDArray[np.intp]]:
        """The joints that carry some links, with these alone, and the elements of q they follow."""
        joints = sorted({joint for link in links for joint in self.path(link)})
        place = {joint: i for i, joint in enumerate([-1, *joints], start=-1)}
        sources, source = np.unique(self.source[joints], return_inverse=True)
        part = KinematicArrays(
            parent=np.array([place[int(self.parent[j])] for j in joints], dtype=np.int32),
            T_parent_joint=self.T_parent_joint[joints],
            axis=self.axis[joints],
            kind=self.kind[joints],
            source=source.astype(np.int32),
            multiplier=self.multiplier[joints],
            offset=self.offset[joints],
            link_joint=np.array([place[int(self.link_joint[i])] for i in links], dtype=np.int32),
            T_joint_link=self.T_joint_link[list(links)],
        )
        return part, sources.astype(np.intp)

    def path(self, link: int) -> list[int]:
        """The joints that carry a link, from the link to the root."""
        joints, joint = [], int(self.link_joint[link])
        while joint >= 0:
            joints.append(joint)
            joint = int(self.parent[joint])
        return joints


def build_chain(robot: Robot, link_names: Sequence[str]) -> KinematicArrays:
    """The movable joints of `robot` as arrays, with the links `link_names` in that order.

    Raises:
        InputError: a mimic joint follows a joint that does not exist or does not move, or itself.
    """
    movable = {joint.name: joint for joint in robot.joints if joint.movable}
    independent = {name: i for i, name in enumerate(independent_joints(robot))}
    # Frame of each link: the movable joint that carries it, and its pose in that joint's frame.
    frames: dict[str, tuple[int, Array]] = {robot.root: (-1, np.eye(4))}
    parents, poses = [], []
    for joint in robot.joints:
        carrier, T_carrier_parent = frames[joint.parent]
        T_carrier_child = T_carrier_parent @ joint.T_parent_child
        if joint.movable:
            parents.append(carrier)
            poses.append(T_carrier_child)
            frames[joint.child] = (len(parents) - 1, np.eye(4))
        else:
            frames[joint.child] = (carrier, T_carrier_child)
    slides = [joint.kind == "prismatic" for joint in movable.values()]
    rules = [_follow_mimic(joint, movable) for joint in movable.values()]
    return KinematicArrays(
        parent=np.array(parents, dtype=np.int32),
        T_parent_joint=np.stack(poses),
        axis=np.stack([joint.axis for joint in movable.values()]),
        kind=np.where(slides, PRISMATIC, REVOLUTE).astype(np.int32),
        source=np.array([independent[name] for name, _, _ in rules], dtype=np.int32),
        multiplier=np.array([multiplier for _, multiplier, _ in rules]),
        offset=np.array([offset for _, _, offset in rules]),
        link_joint=np.array([frames[name][0] for name in link_names], dtype=np.int32),
        T_joint_link=np.stack([frames[name][1] for name in link_names]),
    )


def independent_joints(robot: Robot) -> tuple[str, ...]:
    """Names of the movable joints that are no mimics, in topological order."""
    return tuple(joint.name for joint in robot.joints if joint.movable and joint.mimic is None)


def _follow_mimic(joint: UrdfJoint, movable: dict[str, UrdfJoint]) -> tuple[str, float, float]:
    """The independent joint that `joint` follows in the end, with multiplier and offset."""
    multiplier, offset = 1.0, 0.0
    current, passed = joint, [joint.name]
    while (mimic := current.mimic) is not None:
        offset += multiplier * mimic.offset
        multiplier *= mimic.multiplier
        if mimic.joint in passed:
            raise InputError(f"mimic joints follow each other in a circle: {', '.join(passed)}")
        if mimic.joint not in movable:
            raise InputError(
                f'joint "{current.name}" mimics "{mimic.joint}", which is no movable joint of '
                f"the URDF; movable joints: {', '.join(movable)}"
            )
        current = movable[mimic.joint]
        passed.append(current.name)
    return current.name, multiplier, offset
