"""How sure the answer is."""

import math

import numpy as np

from inhand.config import SelectionConfig
from inhand.geometry.se3 import Array
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

    It counts how well the pose fits and on how many readings that rests, its lead over any rival,
    and how firmly the image holds it: how much worse poses to either side fit. A rival is a pose
    whose surface lies elsewhere; slight variants of the first pose are none. How far the readings
    may be off its surface is read off the hand: noise, waviness and wrong calibration move both
    off, a wrong model only the object's.

    Args:
        ranked: poses, best first.
        segment: the object segment.
        evidence: what the poses were scored against.
        obj: the object.
        config: parameters.
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
    readings, off = readings_on(segment, first, obj, c)
    logit = (
        c.confidence_bias
        + c.confidence_visible * min(seen[0, 0], c.max_visible)
        + c.confidence_readings * math.log(max(min(readings, c.max_readings), 1.0))
        - c.confidence_misfit * max(off - segment.hand_misfit, 0.0)
        - c.confidence_contact * contact[0]
        + c.confidence_lead * math.sqrt(min(max(lead, 0.0), c.max_lead))
        + c.confidence_drop * drop
    )
    return 1 / (1 + math.exp(-max(min(logit, 50.0), -50.0)))


def readings_on(
    segment: Segment, T_camera_object: Array, obj: PackedObject, config: SelectionConfig
) -> tuple[float, float]:
    """Number of segment points on the object's surface, and their mean distance to it [m].

    Each point counts with its weight.

    Args:
        segment: the object segment.
        T_camera_object: the object's pose, shape (4, 4).
        obj: the object.
        config: parameters; its `misfit_reach` says what is on the surface.
    """
    stride = max(1, len(segment.points) // config.segment_points)
    points = segment.points[::stride]
    off = np.abs(obj.distances(points, T_camera_object, config.misfit_reach))
    weight = segment.weight[::stride] * (off < config.misfit_reach)
    number = float(weight.sum())
    return stride * number, float(weight @ off) / max(number, 1e-6)
