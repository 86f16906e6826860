"""Refinement of every pose that is left (paper, section IV-B)."""

import numpy as np
import warp as wp

from inhand.config import RefinementConfig
from inhand.kernels.launch import launch
from inhand.kernels.object_fit import refine_poses
from inhand.packed import PackedObject, device_poses
from inhand.stages.evidence import Evidence
from inhand.stages.point_to_plane import refine_by_icp
from inhand.stages.results import PoseSet, Segment


def refine(
    poses: PoseSet,
    segment: Segment,
    evidence: Evidence,
    obj: PackedObject,
    config: RefinementConfig,
) -> PoseSet:
    """Poses after local optimisation.

    The paper runs point-to-plane ICP. By default Gauss-Newton pulls the segment onto the model's
    distance field and visible model samples to their pixels, with a redescending weight.
    """
    if config.method == "icp":
        return refine_by_icp(poses, segment, obj, config)
    device = obj.device
    refined = wp.empty(len(poses), dtype=wp.mat44, device=device)
    stride = evidence.stride(config.segment_points)
    n = min(config.model_points, len(obj.points))
    launch(
        refine_poses,
        len(poses),
        [evidence.arrays, device_poses(poses.T_camera_object, device)]
        + [obj.points, obj.normals, n, obj.fields]
        + [wp.vec3(*obj.model.centre.tolist()), 0.5 * obj.model.diameter]
        + [config.iterations, config.first_width, config.last_width, stride]
        + [config.image_weight, refined],
        device,
        work_per_item=config.iterations * (config.segment_points + n),
    )
    return PoseSet(np.asarray(refined.numpy()), poses.score)
