"""Refinement of every pose that is left (paper, section IV-B)."""

from functools import partial
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.config import RefinementConfig
from inhand.kernels.launch import block_size, empty, launch, on_host
from inhand.kernels.normal_equations import Vector6
from inhand.kernels.object_fit import refine_poses
from inhand.packed import PackedObject, device_poses
from inhand.stages.clustering import distinct_poses
from inhand.stages.evidence import Evidence, score_with_contact
from inhand.stages.point_to_plane import refine_by_icp
from inhand.stages.results import PoseSet, Segment


def refine(
    poses: PoseSet,
    segment: Segment,
    evidence: Evidence,
    obj: PackedObject,
    config: RefinementConfig,
) -> PoseSet:
    """Poses after local optimisation, scored on the way there.

    The paper runs point-to-plane ICP. By default Gauss-Newton pulls the segment onto the model's
    distance field and visible model samples to their pixels, with a redescending weight: all poses
    roughly, then the best of those that are still distinct.
    """
    if config.method == "icp":
        return refine_by_icp(poses, segment, obj, config)
    fit = partial(fit_to_field, evidence, obj, config.image_weight)
    widths = config.first_width, config.middle_width, config.last_width
    rough, _, _ = fit(
        poses.T_camera_object, config.rough_points, config.rough_iterations, widths[:2]
    )
    scores = score_with_contact(evidence, obj, rough, config)
    best = distinct_poses(PoseSet(rough, scores), obj, config.surface_distance, config.keep)
    fine, _, _ = fit(best.T_camera_object, config.model_points, config.iterations, widths[1:])
    return PoseSet(fine, best.score)


def fit_to_field(
    evidence: Evidence,
    obj: PackedObject,
    image_weight: float,
    T_camera_object: NDArray[np.floating[Any]],
    points: int,
    iterations: int,
    widths: tuple[float, float],
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Gauss-Newton on the model's distance field.

    Args:
        evidence: the evidence.
        obj: the object.
        image_weight: weight of one visible model point against one segment point.
        T_camera_object: poses, shape (m, 4, 4).
        points: about how many segment points and how many model points are used.
        iterations: number of iterations.
        widths: of the redescending weight, in the first and the last iteration [m].

    Returns:
        The poses afterwards, (m, 4, 4), and the last iterations' systems A x = b, (m, 6, 6) and
        (m, 6), for twists x about the object's centre along the camera's axes.
    """
    device, m, n = obj.device, len(T_camera_object), min(points, len(obj.points))
    sums = empty((block_size(device), m, 7), Vector6, device)
    refined = empty((m,), wp.mat44, device)
    inputs = [evidence.arrays, device_poses(T_camera_object, device)]
    inputs += [obj.points, obj.normals, n, obj.fields]
    inputs += [wp.vec3(*obj.model.centre.tolist()), 0.5 * obj.model.diameter]
    inputs += [iterations, *widths, evidence.stride(points), image_weight, sums, refined]
    work = 5 * iterations * (points + n)
    launch(refine_poses, m, inputs, device, work_per_item=work, shared=True)
    systems = on_host(sums[0])
    return on_host(refined), systems[:, :6], systems[:, 6]
