"""The paper's refinement of object poses: point-to-plane ICP, merging, and the best by LCP
(section IV-B)."""

import numpy as np
import warp as wp

from inhand.config import RefinementConfig
from inhand.kernels.depth import bounding_sphere
from inhand.kernels.launch import launch
from inhand.kernels.point_to_plane import RigidModel, align_to_points
from inhand.packed import PackedObject
from inhand.stages.lcp import segment_lcp
from inhand.stages.results import PoseSet, Segment
from inhand.stages.se3_clustering import leaders_of


def refine_by_icp(
    poses: PoseSet, segment: Segment, obj: PackedObject, config: RefinementConfig
) -> PoseSet:
    """Refined, distinct poses with the highest LCP, best first."""
    refined = align_model(poses, segment, obj, config)
    score = segment_lcp(refined, segment, obj, config)
    order = np.argsort(-score, kind="stable")
    ranked = PoseSet(refined[order], score[order])
    everywhere = np.zeros(1, dtype=np.int32)
    leader = leaders_of(ranked, everywhere, obj, config.merge_distance, config.merge_angle)
    distinct = np.flatnonzero(leader == np.arange(len(ranked)))
    return ranked.take(distinct[: config.keep])


def align_model(
    poses: PoseSet, segment: Segment, obj: PackedObject, config: RefinementConfig
) -> np.ndarray:
    """Poses after `config.iterations` of ICP against the segment, shape (m, 4, 4) float32."""
    device = obj.device
    model = RigidModel()
    model.fields = obj.fields
    model.T_model_part = wp.array([np.eye(4)], dtype=wp.mat44, device=device)
    model.used = wp.ones(1, dtype=int, device=device)
    model.centre = wp.vec3(*obj.model.centre)
    model.radius = bounding_sphere(obj.model.mesh)[3]
    # A copy: the kernel moves it.
    aligned = wp.array(poses.T_camera_object, dtype=wp.mat44, device=device)
    inputs = [
        model,
        wp.array(segment.points, dtype=wp.vec3, device=device),
        wp.array(segment.normals, dtype=wp.vec3, device=device),
        config.max_distance,
        float(np.cos(config.max_normal_angle)),
        config.iterations,
        aligned,
    ]
    work = 4 * config.iterations * len(segment.points)
    launch(align_to_points, len(poses), inputs, device, work_per_item=work)
    return np.asarray(aligned.numpy())
