"""The paper's clustering of object poses in SE(3) (section IV-B)."""

import numpy as np
from numpy.typing import NDArray

from inhand.config import ClusteringConfig
from inhand.kernels.clustering import pose_leaders
from inhand.packed import PackedObject
from inhand.stages.results import PoseSet


def cluster_se3(poses: PoseSet, obj: PackedObject, config: ClusteringConfig) -> PoseSet:
    """The pose with the highest score of every cluster, best first.

    Poses are grouped by the position of the object's centre, then every group by rotation, which is
    compared modulo the object's symmetry. Groups form around their best pose: grown from neighbour
    to neighbour, one group took 60 to 100 % of the thousands of poses of a frame.
    """
    poses = poses.take(np.argsort(-poses.score, kind="stable"))
    everywhere = np.zeros(1, dtype=np.int32)
    by_place = leaders_of(poses, everywhere, obj, config.distance, np.pi)
    members = np.argsort(by_place, kind="stable")
    poses, by_place = poses.take(members), by_place[members]
    group_start = np.flatnonzero(np.diff(by_place, prepend=-1))
    leader = leaders_of(poses, group_start, obj, np.inf, config.angle)
    best = np.flatnonzero(leader == np.arange(len(poses)))
    return poses.take(best[np.argsort(-poses.score[best], kind="stable")[: config.keep]])


def leaders_of(
    poses: PoseSet,
    group_start: NDArray[np.int32] | NDArray[np.intp],
    obj: PackedObject,
    distance: float,
    angle: float,
) -> NDArray[np.int32]:
    """`pose_leaders` of an object: positions are those of its centre, rotations modulo symmetry."""
    symmetry = obj.model.symmetry
    centre = obj.model.centre
    return pose_leaders(
        group_start,
        poses.T_camera_object[:, :3, :3] @ centre + poses.T_camera_object[:, :3, 3],
        poses.T_camera_object[:, :3, :3],
        symmetry.rotations[:, :3, :3],
        symmetry.axis,
        distance,
        angle,
    )
