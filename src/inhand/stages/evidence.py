"""What object poses are held against: the image, the rendered hand and the object segment."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.config import (
    ClusteringConfig,
    EvidenceConfig,
    HypothesesConfig,
    RefinementConfig,
    SelectionConfig,
)
from inhand.kernels.contact import link_clearances
from inhand.kernels.launch import computed, in_struct
from inhand.kernels.object_fit import ObjectEvidence, score_poses
from inhand.packed import PackedHand, PackedObject, device_poses
from inhand.stages.hand_visibility import visibility_rule
from inhand.stages.observation import Observation
from inhand.stages.results import HandState, Segment

Samples = HypothesesConfig | ClusteringConfig | RefinementConfig | SelectionConfig
"""A section of the configuration that says how finely poses are scored: `model_points` and about
`segment_points` are held against each other and the image, with depth agreement `tolerance`, and
`contact_points` of the model against the hand."""


@dataclass(frozen=True)
class Evidence:
    """The evidence of one image for kernels."""

    arrays: Any = field(repr=False)
    """`kernels.object_fit.ObjectEvidence`."""
    segment_weights: NDArray[np.float32]
    """Weights of the segment points in the order of `arrays`, shape (n,)."""
    hand: PackedHand = field(repr=False)
    """The hand."""
    hand_state: HandState
    """Where it is."""
    config: EvidenceConfig
    """Parameters."""

    def stride(self, points: int) -> int:
        """Every so-many-th segment point makes up about `points`."""
        return max(1, len(self.segment_weights) // points)


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
    e.view = observation.view
    # What the image does not support must not explain it.
    depth = hand.render(coarse, hand_state.T_camera_link, hand_state.certain)
    e.hand_depth = in_struct(depth, float, device)
    e.hand_step = config.hand_step
    # A fixed shuffle makes every strided subset an even sample of the segment.
    order = np.random.default_rng(0).permutation(len(segment.points))
    weights = segment.weight[order]
    e.points = in_struct(segment.points[order], wp.vec3, device)
    e.normals = in_struct(segment.normals[order], wp.vec3, device)
    e.weights = in_struct(weights, float, device)
    e.near, e.share_weight = config.near, config.share_weight
    return Evidence(e, weights, hand, hand_state, config)


def agreement(
    evidence: Evidence,
    obj: PackedObject,
    T_camera_object: Any,
    samples: Samples,
    worth: float = -np.inf,
    near: float | None = None,
) -> NDArray[np.float32]:
    """Scores, shape (m, 2): of what the camera sees of poses, and of what segment they explain.

    Args:
        evidence: the evidence.
        obj: the object.
        T_camera_object: poses on the device, `wp.array` of `wp.mat44`.
        samples: how finely to score.
        worth: poses that score less together get some scores whose sum is below this.
        near: a segment point this near to the model is explained [m]; by default as configured.
    """
    config = evidence.config
    rule = visibility_rule(config, samples.tolerance)
    stride = evidence.stride(samples.segment_points)
    weights = evidence.segment_weights[::stride]
    n = min(samples.model_points, len(obj.points))
    inputs = [evidence.arrays, rule, T_camera_object, obj.points, obj.normals, n, obj.fields]
    inputs += [near or config.near, stride, float(weights.sum()) + 1e-6, worth]
    shape, work = (len(T_camera_object),), 6 * (n + len(weights))
    kernel, device = score_poses, obj.device
    return computed(kernel, shape, wp.vec2, inputs, device, work_per_item=work, shared=True)


def score_with_contact(
    evidence: Evidence,
    obj: PackedObject,
    T_camera_object: NDArray[np.floating[Any]],
    samples: Samples,
    worth: float = -np.inf,
    near: float | None = None,
) -> NDArray[np.float32]:
    """Scores, shape (m,), of poses (m, 4, 4): their `agreement`, less the `contact_penalty`."""
    poses = device_poses(T_camera_object, obj.device)
    scores = agreement(evidence, obj, poses, samples, worth, near).sum(axis=1)
    # Contact only takes away: what is below already stays there.
    left = np.flatnonzero(scores >= worth)
    if len(left) < len(scores):
        poses = device_poses(T_camera_object[left], obj.device)
    scores[left] -= contact_penalty(evidence, obj, poses, samples.contact_points)
    return scores


def contact_penalty(
    evidence: Evidence, obj: PackedObject, T_camera_object: Any, points: int
) -> NDArray[np.float32]:
    """Penalty, shape (m,), of poses that run into the hand or that its fingers do not touch.

    Where a link is that the image does not support is unknown: the object may run into it, and may
    touch it elsewhere.
    """
    c, hand = evidence.config, evidence.hand
    certain = evidence.hand_state.certain
    free_gap = c.free_gap if certain.all() else c.uncertain_gap
    farthest = free_gap + c.max_contact_penalty * c.gap_scale
    clearance = clearances(T_camera_object, obj, points, hand, evidence.hand_state, farthest)
    depth = -clearance[:, certain].min(axis=1, initial=0.0)
    gaps = np.stack([clearance[:, f.links].min(axis=1) for f in hand.hand.fingers], axis=1)
    penalty = np.maximum(
        penetration_cost(depth, c),
        np.clip((gaps.min(axis=1) - free_gap) / c.gap_scale, 0, c.max_contact_penalty),
    )
    return np.asarray(penalty + gap_cost(gaps, c).mean(axis=1), dtype=np.float32)


def penetration_cost(
    depth: NDArray[np.float32], config: EvidenceConfig
) -> NDArray[np.floating[Any]]:
    """Penalty of penetrations [m]."""
    beyond = (depth - config.free_penetration) / config.penetration_scale
    return np.asarray(np.clip(beyond, 0, config.max_contact_penalty))


def gap_cost(gap: NDArray[np.float32], config: EvidenceConfig) -> NDArray[np.floating[Any]]:
    """Penalty of gaps [m] between the object and a finger, if all fingers had that gap."""
    beyond = (gap - config.free_finger_gap) / config.finger_gap_scale
    return np.asarray(config.finger_apart * np.clip(beyond, 0, 1))


def clearances(
    T_camera_object: Any,
    obj: PackedObject,
    points: int,
    hand: PackedHand,
    hand_state: HandState,
    farthest: float,
) -> NDArray[np.float32]:
    """Smallest signed distances [m], shape (m, L), of posed objects to each link of the hand.

    Args:
        T_camera_object: poses on the device, `wp.array` of `wp.mat44`.
        obj: the object.
        points: surface samples of the object that are used at most.
        hand, hand_state: the hand and where it is.
        farthest: larger distances are cut off here [m].
    """
    n, poses = min(points, len(obj.points)), device_poses(hand_state.T_camera_link, obj.device)
    inputs = [T_camera_object, obj.points, n, hand.fields, poses, farthest]
    shape = len(T_camera_object), len(hand.hand.links)
    return computed(link_clearances, shape, float, inputs, obj.device, work_per_item=4 * n)
