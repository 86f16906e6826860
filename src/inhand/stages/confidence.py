"""How sure the answer is."""

import math

import numpy as np

from inhand.config import SelectionConfig
from inhand.geometry.se3 import Array, inverse, transform
from inhand.object_model import ObjectModel
from inhand.packed import PackedObject, device_poses
from inhand.stages.clustering import surface_distances_to
from inhand.stages.evidence import Evidence, agreement, contact_penalty
from inhand.stages.precision import probes
from inhand.stages.results import PoseSet, Segment


def confidence(
    ranked: PoseSet,
    segment: Segment,
    evidence: Evidence,
    obj: PackedObject,
    config: SelectionConfig,
) -> float:
    """Probability that the first of the ranked poses is right, 0 if there is none.

    It counts how well the pose fits, its lead over any rival, and how firmly the image holds it:
    how much worse poses to either side fit. A rival is a pose whose surface lies elsewhere; slight
    variants of the first pose are none.
    """
    if not len(ranked):
        return 0.0
    c, first = config, ranked.T_camera_object[0].astype(np.float64)
    apart = surface_distances_to(ranked.T_camera_object, ranked.T_camera_object[0], obj, 0.1)
    rivals = ranked.score[apart > c.rival_distance]
    lead = float(ranked.score[0] - rivals.max()) if len(rivals) else c.max_lead
    aside = probes(first, evidence, obj, c.precision)
    poses = device_poses(np.concatenate([first[None], aside]), obj.device)
    seen = agreement(evidence, obj, poses, c).astype(np.float64)
    contact = contact_penalty(evidence, obj, poses, c.contact_points)
    score = seen.sum(axis=1) - contact
    drop = np.clip(score[0] - score[1:], 0, c.precision.max_drop).mean()
    logit = (
        c.confidence_bias
        + c.confidence_visible * min(seen[0, 0], c.max_visible)
        - c.confidence_misfit * misfit(segment, first, obj.model, c)
        - c.confidence_contact * contact[0]
        + c.confidence_lead * math.sqrt(min(max(lead, 0.0), c.max_lead))
        + c.confidence_drop * drop
    )
    return 1 / (1 + math.exp(-max(min(logit, 50.0), -50.0)))


def misfit(
    segment: Segment, T_camera_object: Array, obj: ObjectModel, config: SelectionConfig
) -> float:
    """How much farther the segment is off the object's surface than the hand is off its own [m].

    That is, on average, and of the points that lie near the surface. What keeps the hand off is the
    sensor's noise, waviness and calibration, which keep the right object off as much.

    Args:
        segment: the object segment.
        T_camera_object: the object's pose, shape (4, 4).
        obj: the object.
        config: parameters.
    """
    stride = max(1, len(segment.points) // config.segment_points)
    points = transform(inverse(T_camera_object), segment.points[::stride])
    off = np.abs(obj.distance_field.distance(points))
    weight = segment.weight[::stride] * (off < config.misfit_reach)
    mean = weight @ off / max(weight.sum(), 1e-6)
    return float(max(mean - segment.hand_misfit, 0))
