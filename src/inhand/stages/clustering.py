"""Reduction of the hypotheses to distinct poses (paper, section IV-B)."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.config import ClusteringConfig
from inhand.kernels.launch import computed, filled, launch, on_device, on_host
from inhand.kernels.pose_distance import compare_poses, surface_distances
from inhand.packed import PackedObject, device_poses
from inhand.stages.evidence import Evidence, score_with_contact
from inhand.stages.results import PoseSet
from inhand.stages.se3_clustering import cluster_se3

BLOCK = 64
"""So many poses at a time are compared with those that are kept."""


def cluster(
    hypotheses: PoseSet, evidence: Evidence, obj: PackedObject, config: ClusteringConfig
) -> PoseSet:
    """The best pose of every group of poses that are alike, best first.

    The paper groups by translation, then by rotation. By default the hypotheses are scored again
    on more points, and taken greedily as long as their surface differs from those taken.
    """
    if config.method == "se3":
        return cluster_se3(hypotheses, obj, config)
    scores = score_with_contact(evidence, obj, hypotheses.T_camera_object, config)
    return distinct_poses(
        PoseSet(hypotheses.T_camera_object, scores), obj, config.surface_distance, config.keep
    )


def distinct_poses(poses: PoseSet, obj: PackedObject, distance: float, keep: int) -> PoseSet:
    """The best poses, best first, whose surfaces lie farther apart than `distance` [m] on average.

    Poses that differ by a symmetry of the object have the same surface and are one.
    """
    ranked = poses.take(np.argsort(-poses.score, kind="stable"))
    T = device_poses(ranked.T_camera_object, obj.device)
    chosen = np.zeros(0, dtype=np.int32)
    for begin in range(0, len(ranked), BLOCK):
        if len(chosen) >= keep:
            break
        block = np.arange(begin, min(begin + BLOCK, len(ranked)), dtype=np.int32)
        others = np.concatenate([chosen, block])
        alike = filled((len(block), len(others)), 0, int, obj.device)
        others_there = on_device(others, int, obj.device)
        inputs = [obj.surface, T, others_there, len(chosen), begin, distance, alike]
        work = 30 * len(others)
        launch(compare_poses, len(block), inputs, obj.device, work_per_item=work, shared=True)
        same = on_host(alike).astype(bool)
        fresh = ~np.any(same[:, : len(chosen)], axis=1)
        for i, others_like_it in enumerate(same[:, len(chosen) :].T):
            if fresh[i]:
                fresh &= ~others_like_it
        chosen = np.concatenate([chosen, block[fresh]])
    return ranked.take(chosen[:keep].astype(np.intp))


def surface_distances_to(
    T_camera_object: NDArray[np.float32], T: NDArray[np.float32], obj: PackedObject, farthest: float
) -> NDArray[np.float32]:
    """Mean distances [m], shape (m,), of the surface at some poses to the surface at one pose.

    Args:
        T_camera_object: poses, shape (m, 4, 4).
        T: the one pose, shape (4, 4).
        obj: the object.
        farthest: larger distances are cut off here [m].
    """
    poses: Any = device_poses(T_camera_object, obj.device), wp.mat44(*T.reshape(-1).tolist())
    shape, inputs = (len(T_camera_object),), [obj.surface, *poses, farthest]
    return computed(surface_distances, shape, float, inputs, obj.device, work_per_item=5)
