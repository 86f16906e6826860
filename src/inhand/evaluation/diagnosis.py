"""Which stage of the pipeline loses a frame."""

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from inhand.datasets.frames import LABEL_OBJECT, Frame
from inhand.estimator import StageResults
from inhand.evaluation.metrics import ObjectMetric, PoseError
from inhand.stages.observation import Observation
from inhand.stages.results import Segment

SOLVED = 0.005
"""A pose with a smaller ADI is right [m] (paper, section V-A)."""
PROMISING = 0.010
"""A pose with a smaller ADI that is still to be refined counts as found [m]."""

POSE_STAGES = {
    "hypotheses": "hypotheses",
    "clustering": "clustered",
    "refinement": "refined",
    "pruning": "pruned",
    "selection": "selection",
}
"""Stages that hand on object poses, and the field of the stage results with their output."""
_EARLY_STAGES = {
    "observation": "observation",
    "wrist": "wrist",
    "hand_state": "hand_state",
    "segmentation": "segment",
}
STAGES = (*_EARLY_STAGES, *POSE_STAGES)
"""All stages, in order."""

# Beyond these a failed segmentation is put down to the hand.
_WRIST_OFF = PoseError(0.005, math.radians(3))
_FINGER_OFF = math.radians(10)
_SEGMENT_OFF = 0.5


class SegmentQuality(NamedTuple):
    """How well the object segment matches the object's pixels."""

    precision: float
    """Share of the segment that is object, by weight."""
    recall: float
    """Share of the object points it was chosen from that the segment kept, by weight."""


def best_adi_by_stage(
    results: StageResults, metric: ObjectMetric, frame: Frame
) -> dict[str, float | None]:
    """The smallest ADI [m] among the poses each stage handed on, by stage.

    None for a stage that handed on nothing; no entry for one that was not reached.

    Args:
        results: the estimator's stage results.
        metric: errors of the frame's object.
        frame: the frame, with its truth.
    """
    best: dict[str, float | None] = {}
    for stage, field in POSE_STAGES.items():
        poses = getattr(results, field)
        if poses is not None:
            best[stage] = metric.best_adi(poses.T_camera_object, frame.truth.T_camera_object)
    return best


def segment_quality(results: StageResults, frame: Frame) -> SegmentQuality | None:
    """Precision and recall of the object segment against the frame's label.

    None when there is no segment, or no object point in the scene cloud to be found.
    """
    if results.observation is None or results.segment is None:
        return None
    v, u = _pixels(results.segment.points, frame)
    weight = np.zeros(frame.truth.label.shape)
    weight[v, u] = results.segment.weight
    is_object = frame.truth.label == LABEL_OBJECT
    step = _step_of(results.segment, results.observation)
    v, u = _pixels(results.observation.cloud(step).points, frame)
    found = weight[v, u][is_object[v, u]]
    if len(found) == 0:
        return None
    return SegmentQuality(
        precision=float(weight[is_object].sum() / max(weight.sum(), 1e-9)),
        recall=float(found.mean()),
    )


def _step_of(segment: Segment, observation: Observation) -> int:
    """The step of the scene cloud, in pixels, that a segment was chosen from: a small one is taken
    again from a finer cloud, whose pixels are others."""
    pixels = np.rint(observation.camera.project(segment.points)).astype(int)
    steps = range(observation.step, 0, -1)
    return next(step for step in steps if ((pixels - step // 2) % step == 0).all())


def _pixels(points: NDArray[np.floating], frame: Frame) -> tuple[NDArray[np.int_], ...]:
    """Rows and columns of the pixels that points [m], camera frame, shape (n, 3), fall on."""
    height, width = frame.truth.label.shape
    u, v = np.rint(frame.camera.project(np.asarray(points, dtype=np.float64))).astype(int).T
    return v.clip(0, height - 1), u.clip(0, width - 1)


def stage_to_blame(
    adi: float | None,
    best: Mapping[str, float | None],
    reached: set[str],
    segment: SegmentQuality | None,
    wrist: PoseError | None,
    fingers: Mapping[str, float],
) -> str | None:
    """The stage that loses the frame, or None when the answer is right.

    Walked back from the answer: the last stage that still had a good pose names its successor. If
    no hypothesis was any good, the segment is to blame when it is mostly not the object or lacks
    most of it, and the hand when that is far off too.

    Args:
        adi: ADI of the answer [m], None without one.
        best: the smallest ADI after each stage [m].
        reached: the stages that ended.
        segment: quality of the object segment.
        wrist: wrist error after the hand stages.
        fingers: errors of the visible joints after the hand stages [rad].
    """
    if adi is not None and adi < SOLVED:
        return None
    for stage, loser in reversed(list(pairwise(POSE_STAGES))):
        if is_good(stage, best.get(stage)):
            return loser
    stopped = next((stage for stage in _EARLY_STAGES if stage not in reached), None)
    if stopped not in (None, "segmentation"):
        return stopped
    if stopped is None and segment is None:
        return "observation"
    if segment is None or min(segment) < _SEGMENT_OFF:
        if wrist is not None and np.greater(wrist, _WRIST_OFF).any():
            return "wrist"
        off = any(error > _FINGER_OFF for error in fingers.values())
        return "hand_state" if off else "segmentation"
    return "hypotheses"


def is_good(stage: str, adi: float | None) -> bool:
    """Whether the best pose that a stage handed on is good enough for the next one."""
    limit = PROMISING if stage in ("hypotheses", "clustering") else SOLVED
    return adi is not None and adi < limit


def stages_reached(results: StageResults) -> set[str]:
    """The stages that ended, by the estimator's stage results."""
    fields = {**_EARLY_STAGES, **POSE_STAGES}
    return {stage for stage, field in fields.items() if getattr(results, field) is not None}
