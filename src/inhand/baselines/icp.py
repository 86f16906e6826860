"""Point-to-plane ICP of single poses, and their final comparison."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from inhand.config import RefinementConfig
from inhand.kernels.lcp import pose_lcp
from inhand.packed import PackedObject
from inhand.stages.observation import Cloud
from inhand.stages.point_to_plane import align_model
from inhand.stages.results import PoseSet, Segment

DISTANCES = (0.007, 0.005)
"""Correspondences farther than this are ignored, from the first round to the last [m]. Farther ones
widen the way in to the right pose where the cloud is the object alone, but pull a right pose away
where remains of the hand lie beside it."""
ROUND = RefinementConfig(method="icp", iterations=30, max_normal_angle=np.pi / 3)
LCP_DISTANCE, LCP_ANGLE = 0.004, np.pi / 4
"""A point this near [m] to the model, with a normal this near [rad] to its, is explained."""


def refine_by_icp(
    T_camera_object: NDArray[np.float64], cloud: Cloud, obj: PackedObject
) -> NDArray[np.float64]:
    """Poses (m, 4, 4) after rounds of ICP with ever nearer correspondences."""
    n = len(cloud.points)
    segment = Segment(
        cloud.points, cloud.normals, np.zeros(n, dtype=np.float32), np.ones(n, dtype=np.float32)
    )
    poses = T_camera_object.astype(np.float32)
    for distance in DISTANCES:
        start = PoseSet(poses, np.zeros(len(poses), dtype=np.float32))
        poses = align_model(start, segment, obj, replace(ROUND, max_distance=distance))
    return poses.astype(np.float64)


def rank(T_camera_object: NDArray[np.float64], cloud: Cloud, obj: PackedObject) -> PoseSet:
    """The poses with the share of the cloud that each explains, best first."""
    poses = T_camera_object.astype(np.float32)
    share = pose_lcp(
        poses, cloud.points, cloud.normals, obj.fields, LCP_DISTANCE, LCP_ANGLE, obj.device
    )
    return PoseSet(poses, share).take(np.argsort(-share, kind="stable"))
