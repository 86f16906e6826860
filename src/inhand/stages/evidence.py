"""What object poses are held against: the image, the rendered hand and the object segment."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.config import EvidenceConfig
from inhand.kernels.hand_fit import Visibility
from inhand.kernels.launch import launch
from inhand.kernels.object_fit import ObjectEvidence, score_poses
from inhand.packed import PackedHand, PackedObject, device_poses
from inhand.stages.articulated_fit import depth_view
from inhand.stages.hand_state import HandState
from inhand.stages.observation import Observation
from inhand.stages.segmentation import Segment


@dataclass(frozen=True)
class Evidence:
    """The evidence of one image for kernels."""

    arrays: Any = field(repr=False)
    """`kernels.object_fit.ObjectEvidence`."""
    segment_size: int
    """Number of segment points."""


def gather_evidence(
    observation: Observation,
    hand_state: HandState,
    segment: Segment,
    hand: PackedHand,
    config: EvidenceConfig,
) -> Evidence:
    """Bring the observation, the rendered hand and the segment to the device.

    Args:
        observation, hand_state, segment: results of the earlier stages.
        hand: the hand.
        config: parameters.
    """
    device = hand.device
    coarse = observation.camera.subsampled(config.hand_step)
    e = ObjectEvidence()
    e.view = depth_view(observation)
    e.rule = Visibility()
    e.rule.tolerance, e.rule.violation = config.tolerance, config.violation
    e.rule.missing, e.rule.hidden = config.missing, config.hidden
    visible = hand_state.T_camera_link.copy()
    # What the image does not support must not explain it: such links are put behind the camera.
    visible[~hand_state.certain, 2, 3] = -10.0
    e.hand_depth = hand.renderer.render_on_device(coarse, visible)[0]
    e.hand_step = config.hand_step
    # A fixed shuffle makes every strided subset an even sample of the segment.
    order = np.random.default_rng(0).permutation(len(segment.points))
    e.points = wp.array(segment.points[order], dtype=wp.vec3, device=device)
    e.normals = wp.array(segment.normals[order], dtype=wp.vec3, device=device)
    e.weights = wp.array(segment.weight[order], dtype=float, device=device)
    e.near, e.share_weight = config.near, config.share_weight
    return Evidence(e, len(segment.points))


def score(
    evidence: Evidence,
    obj: PackedObject,
    T_camera_object: Any,
    index: NDArray[np.integer[Any]],
    *,
    model_points: int,
    segment_points: int,
) -> NDArray[np.float32]:
    """Scores, shape (k,), of the poses at `index` of a device array of poses.

    Args:
        evidence: the evidence.
        obj: the object.
        T_camera_object: `wp.array` of `wp.mat44`, or transforms of shape (m, 4, 4).
        index: which poses, shape (k,).
        model_points, segment_points: how many of each are used; more is finer and slower.
    """
    device = obj.device
    if not isinstance(T_camera_object, wp.array):
        T_camera_object = device_poses(T_camera_object, device)
    out = wp.empty(len(index), dtype=float, device=device)
    stride = max(1, evidence.segment_size // segment_points)
    n = min(model_points, len(obj.points))
    launch(
        score_poses,
        len(index),
        [evidence.arrays, T_camera_object, wp.array(index, dtype=int, device=device)]
        + [obj.points, obj.normals, n, obj.fields, stride, out],
        device,
        work_per_item=n + evidence.segment_size // stride,
    )
    return np.asarray(out.numpy())
