"""Summary of a method's benchmark results, as JSON values."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from inhand.evaluation.diagnosis import POSE_STAGES, SOLVED, STAGES, is_good
from inhand.evaluation.results import FrameResult
from inhand.evaluation.statistics import (
    auroc,
    bootstrap,
    calibration_error,
    means,
    reliability,
    wilson_interval,
)

THRESHOLDS = {"2 mm": 0.002, "5 mm": 0.005, "10 mm": 0.010}
"""ADI thresholds of the recall [m]."""
VISIBLE_BINS = {"< 10 %": 0.10, "10-30 %": 0.30, "30-60 %": 0.60, "> 60 %": math.inf}
"""Upper ends of the bins of the object's visible share."""
AREA_LIMIT = 0.020
"""Threshold up to which the area under the recall curve is taken [m]."""

Summary = dict[str, Any]
Results = Mapping[str, Sequence[FrameResult]]
"""Results by method."""


def is_solved(result: FrameResult, threshold: float = SOLVED) -> bool:
    """Whether there is an answer with an ADI below the threshold [m]."""
    return result.adi is not None and result.adi < threshold


def solved_share(results: Iterable[FrameResult]) -> dict[str, Any]:
    """Share of the frames that could be read that are solved, with its interval."""
    hits = [is_solved(r) for r in results if r.outcome != "unreadable"]
    return _share(hits, len(hits))


# What every frame adds to a mean, 0 to 1; without an answer nothing.
_MEASURES: dict[str, Callable[[FrameResult], float]] = {
    "recall": is_solved,
    "area": lambda r: 0 if r.adi is None else max(0, 1 - r.adi / AREA_LIMIT),
    "recall from truth": lambda r: r.adi_from_truth is not None and r.adi_from_truth < SOLVED,
    "recall ADD": lambda r: r.add is not None and r.add < SOLVED,
    "VSD": lambda r: r.vsd_share,
    "MSSD": lambda r: r.mssd_share,
    "MSPD": lambda r: r.mspd_share,
    "BOP": lambda r: (r.vsd_share + r.mssd_share + r.mspd_share) / 3,
}


def summarise(results: Iterable[FrameResult]) -> Summary:
    """Everything the report tells of one method; lengths [m], angles [rad], times [s].

    Frames without an answer and frames the method failed on count as missed; files that could not
    be read are counted apart. Shares carry a 95 % confidence interval (Wilson), means the
    bootstrap's.
    """
    every = sorted(results, key=lambda r: r.frame)
    scored = [r for r in every if r.outcome != "unreadable"]
    outcomes = Counter(r.outcome for r in every)
    return {
        "frames": {k: outcomes[k] for k in ("answer", "no answer", "error", "unreadable")},
        "recall": {
            "all": _recall(scored),
            "set": _by(scored, data_set),
            "object": _by(scored, lambda r: r.object_name),
            "visible share": _by(
                [r for r in scored if r.visible_share is not None], _visible_bin, VISIBLE_BINS
            ),
        },
        "measures": _measures(scored),
        "top3_recall": _share(
            [any(adi < SOLVED for adi in r.candidates_adi) for r in scored if r.candidates_adi],
            len(scored),
        ),
        "confidence": _confidence(scored),
        "pose_error": {
            "adi": _spread(r.adi for r in scored),
            "translation": _spread(r.translation_error for r in scored),
            "rotation": _spread(r.rotation_error for r in scored),
        },
        "finger_error": _finger_errors(scored),
        "wrist_error": _wrist_errors(scored),
        "segment": {
            "precision": _spread(r.segment[0] for r in scored if r.segment),
            "recall": _spread(r.segment[1] for r in scored if r.segment),
        },
        "stages": _stages(scored),
        "time": _times(scored),
        "peak_memory": max((r.peak_memory for r in every if r.peak_memory), default=None),
        "failures": [
            {"frame": r.frame, "outcome": r.outcome, "reason": r.reason}
            for r in every
            if r.outcome != "answer"
        ],
    }


def data_set(result: FrameResult) -> str:
    """Name of the data set that a frame belongs to: the first part of the frame's name."""
    return result.frame.split("/", 1)[0]


def _share(hits: Sequence[bool], frames: int) -> dict[str, Any]:
    """A share of frames; frames that have no entry in `hits` are misses."""
    low, high = wilson_interval(sum(hits), frames)
    share = sum(hits) / frames if frames else None
    return {"share": share, "low": low, "high": high, "frames": frames}


def _recall(results: Sequence[FrameResult]) -> dict[str, dict[str, Any]]:
    return {
        name: _share([is_solved(r, limit) for r in results], len(results))
        for name, limit in THRESHOLDS.items()
    }


def _by(
    results: Sequence[FrameResult],
    group: Callable[[FrameResult], str],
    order: Iterable[str] | None = None,
) -> dict[str, dict[str, dict[str, Any]]]:
    """Recall of every group."""
    names = order or sorted({group(r) for r in results})
    groups = {name: [r for r in results if group(r) == name] for name in names}
    return {name: _recall(members) for name, members in groups.items() if members}


def _visible_bin(result: FrameResult) -> str:
    share = result.visible_share or 0.0
    return next(name for name, upper in VISIBLE_BINS.items() if share < upper)


def _measures(results: Sequence[FrameResult]) -> dict[str, dict[str, Any]]:
    """Mean over the frames, and over the objects, of what every frame adds."""
    values = {name: [float(of(r)) for r in results] for name, of in _MEASURES.items()}
    over_frames, over_objects = means(values), means(values, [r.object_name for r in results])
    return {
        name: {"frames": over_frames[name]._asdict(), "objects": over_objects[name]._asdict()}
        for name in _MEASURES
    }


def _spread(values: Iterable[float | None]) -> dict[str, Any]:
    """How the values that are there are distributed."""
    known = [v for v in values if v is not None]
    names = ("mean", "deviation", "median", "p95", "p99")
    if not known:
        return {**dict.fromkeys(names), "count": 0}
    numbers = (np.mean(known), np.std(known), *np.percentile(known, (50, 95, 99)))
    return {**dict(zip(names, map(float, numbers), strict=True)), "count": len(known)}


def _confidence(results: Sequence[FrameResult]) -> dict[str, Any]:
    """How well the confidence tells right answers from wrong ones, over frames with an answer."""
    answers = [r for r in results if r.adi is not None]
    confidences, right = [r.confidence for r in answers], [is_solved(r) for r in answers]
    curve = reliability(confidences, right)
    return {
        "auroc": bootstrap(auroc, confidences, right)._asdict(),
        "calibration_error": calibration_error(curve),
        "reliability": [b._asdict() for b in curve],
    }


def _finger_errors(results: Sequence[FrameResult]) -> dict[str, dict[str, Any]]:
    names = sorted({name for r in results for name in r.joint_errors})
    visible = [r.visible_joint_errors for r in results]
    return {
        "all": _spread(error for errors in visible for error in errors.values()),
        **{name: _spread(errors.get(name) for errors in visible) for name in names},
    }


def _wrist_errors(results: Sequence[FrameResult]) -> dict[str, dict[str, Any]]:
    stages = ("given", "wrist", "hand_state", "answer")
    found = {s: [r.wrist_errors[s] for r in results if s in r.wrist_errors] for s in stages}
    return {
        stage: {
            "translation": _spread(error[0] for error in errors),
            "rotation": _spread(error[1] for error in errors),
        }
        for stage, errors in found.items()
    }


def _stages(results: Sequence[FrameResult]) -> dict[str, dict[str, Any]]:
    """By stage: the share of frames with a good pose behind it, and how many frames it lost."""
    lost = Counter(r.lost_at for r in results)
    table = {}
    for stage in (*STAGES, "error"):
        alive = None
        if stage in POSE_STAGES:
            alive = _share([is_good(stage, r.best_adi.get(stage)) for r in results], len(results))
        if alive or lost[stage]:
            table[stage] = {"alive": alive, "lost": lost[stage]}
    return table


def _times(results: Sequence[FrameResult]) -> dict[str, dict[str, Any]]:
    stages = dict.fromkeys(stage for r in results for stage in r.timings)
    return {
        **{stage: _spread(r.timings.get(stage) for r in results) for stage in stages},
        "whole estimate": _spread(r.seconds for r in results),
    }
