"""Grouping of poses around leaders: poses are taken in the order given, and each joins the first
leader that is near enough or becomes one.

Unlike with single linkage, groups cannot grow along chains of neighbours. The decisions depend on
one another, so a whole group is one work item, and the work stays on the CPU.
"""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.kernels.launch import launch

DEVICE = "cpu"


@wp.func
def symmetric_angle(a: wp.mat33, b: wp.mat33, symmetries: wp.array(dtype=wp.mat33), axis: wp.vec3):
    """Smallest rotation [rad] between orientations a and b of an object with symmetries.

    Args (beyond the obvious):
        symmetries: rotations that map the object to itself, about its own axes.
        axis: unit axis of continuous symmetry, 0 without one.
    """
    difference = wp.transpose(a) * b
    best = float(-1.0)
    for k in range(symmetries.shape[0]):
        if wp.dot(axis, axis) > 0.0:
            # The rotation about the axis is free, so what counts is how far the axis tilts.
            tilt = wp.dot(wp.transpose(symmetries[k]) * axis, difference * axis)
            best = wp.max(best, tilt)
        else:
            best = wp.max(best, 0.5 * (wp.trace(difference * symmetries[k]) - 1.0))
    return wp.acos(wp.min(best, 1.0))


@wp.kernel
def follow_leaders(
    group_start: wp.array(dtype=int),
    points: wp.array(dtype=wp.vec3),
    rotations: wp.array(dtype=wp.mat33),
    symmetries: wp.array(dtype=wp.mat33),
    axis: wp.vec3,
    distance: float,
    angle: float,
    leaders: wp.array(dtype=int),
    leader: wp.array(dtype=int),
    first: int,
):
    """One work item a group: the leader of every pose of the group.

    Args (beyond the obvious):
        group_start: first pose of every group and, last, the number of poses.
        distance: poses nearer than this [m] and `angle` follow.
        angle: [rad]; pi or more: rotations are not compared.
        leaders: scratch.
        leader: out, index of the leading pose.
    """
    group = first + wp.tid()
    start = group_start[group]
    count = int(0)
    for i in range(start, group_start[group + 1]):
        leader[i] = i
        for k in range(count):
            other = leaders[start + k]
            if wp.length(points[i] - points[other]) >= distance:
                continue
            turn = float(0.0)
            if angle < wp.PI:
                turn = symmetric_angle(rotations[other], rotations[i], symmetries, axis)
            if turn >= angle:
                continue
            leader[i] = other
            break
        if leader[i] == i:
            leaders[start + count] = i
            count += 1


def pose_leaders(
    group_start: NDArray[Any],
    points: NDArray[Any],
    rotations: NDArray[Any],
    symmetries: NDArray[Any],
    axis: NDArray[Any] | None,
    distance: float,
    angle: float,
) -> NDArray[np.int32]:
    """Index of the leader of every pose, shape (m,); a pose that leads has its own.

    Args:
        group_start: first pose of every group; poses of different groups never join.
        points: positions [m], shape (m, 3).
        rotations: orientations, shape (m, 3, 3).
        symmetries: rotations about the object's own axes that map it to itself, shape (k, 3, 3).
        axis: unit axis of continuous symmetry, object frame, shape (3,), or None.
        distance: poses nearer than this follow a leader [m].
        angle: if their rotations differ by less than this [rad]; not compared from pi on.
    """
    edges = wp.array([*group_start, len(points)], dtype=int, device=DEVICE)
    leaders = wp.empty(len(points), dtype=int, device=DEVICE)
    leader = wp.empty(len(points), dtype=int, device=DEVICE)
    inputs = [
        edges,
        wp.array(points, dtype=wp.vec3, device=DEVICE),
        wp.array(rotations, dtype=wp.mat33, device=DEVICE),
        wp.array(symmetries, dtype=wp.mat33, device=DEVICE),
        wp.vec3(*(np.zeros(3) if axis is None else axis)),
        distance,
        angle,
        leaders,
        leader,
    ]
    per_group = 100 * (1 + len(points) // max(len(group_start), 1))
    launch(follow_leaders, len(group_start), inputs, DEVICE, work_per_item=per_group)
    return np.asarray(leader.numpy())
