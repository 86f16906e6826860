"""Reduction of the hypotheses to distinct poses (paper, section IV-B)."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.config import ClusteringConfig
from inhand.kernels.launch import launch
from inhand.kernels.pose_distance import surface_distances
from inhand.packed import PackedObject, device_poses
from inhand.stages.evidence import Evidence, score_with_contact
from inhand.stages.results import PoseSet
from inhand.stages.se3_clustering import cluster_se3


def cluster(
    hypotheses: PoseSet, evidence: Evidence, obj: PackedObject, config: ClusteringConfig
) -> PoseSet:
    """The best pose of every group of poses that are alike, best first.

    The paper groups by translation, then by rotation. By default the best hypotheses are scored
    again on more points, and taken greedily as long as their surface differs from those taken.
    """
    if config.method == "se3":
        return cluster_se3(hypotheses, obj, config)
    n = min(config.shortlist, len(hypotheses))
    best = np.argpartition(-hypotheses.score, n - 1)[:n]
    shortlist = hypotheses.take(np.sort(best))
    scores = score_with_contact(
        evidence,
        obj,
        shortlist.T_camera_object,
        model_points=config.model_points,
        segment_points=config.segment_points,
        tolerance=config.tolerance,
        contact_points=config.contact_points,
    )
    return distinct_poses(
        PoseSet(shortlist.T_camera_object, scores), obj, config.surface_distance, config.keep
    )


def distinct_poses(poses: PoseSet, obj: PackedObject, distance: float, keep: int) -> PoseSet:
    """The best poses, best first, whose surfaces lie farther apart than `distance` [m] on average.

    Poses that differ by a symmetry of the object have the same surface and are one.
    """
    ranked = poses.take(np.argsort(-poses.score, kind="stable"))
    on_device = device_poses(ranked.T_camera_object, obj.device)
    left = np.ones(len(ranked), dtype=bool)
    farthest = max(3 * distance, 0.001)
    chosen: list[int] = []
    while len(chosen) < keep and left.any():
        best = int(left.argmax())
        chosen.append(best)
        apart = surface_distances_to(on_device, ranked.T_camera_object[best], obj, farthest)
        left &= apart > distance
        left[best] = False
    return ranked.take(np.array(chosen, dtype=np.intp))


def surface_distances_to(
    T_camera_object: Any, T: NDArray[np.float32], obj: PackedObject, farthest: float
) -> NDArray[np.float32]:
    """Mean distances [m], shape (m,), of the surface at some poses to the surface at one pose.

    Args:
        T_camera_object: poses, shape (m, 4, 4), or on the device.
        T: the one pose, shape (4, 4).
        obj: the object.
        farthest: larger distances are cut off here [m].
    """
    if not isinstance(T_camera_object, wp.array):
        T_camera_object = device_poses(T_camera_object, obj.device)
    out = wp.empty(len(T_camera_object), dtype=float, device=obj.device)
    launch(
        surface_distances,
        len(T_camera_object),
        [T_camera_object, wp.mat44(*T.reshape(-1).tolist()), obj.points, 24, obj.fields]
        + [wp.vec3(*obj.model.centre.tolist()), farthest, out],
        obj.device,
        work_per_item=5,
    )
    return np.asarray(out.numpy())
