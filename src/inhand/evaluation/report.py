"""Summary of benchmark results: as JSON values, and as tables on the terminal."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from inhand.evaluation.diagnosis import POSE_STAGES, SOLVED, STAGES, is_good
from inhand.evaluation.results import JOINT_PIXELS, FrameResult
from inhand.evaluation.statistics import auroc, wilson_interval

THRESHOLDS = {"2 mm": 0.002, "5 mm": 0.005, "10 mm": 0.010}
"""ADI thresholds of the recall [m]."""
VISIBLE_BINS = {"< 10 %": 0.10, "10-30 %": 0.30, "30-60 %": 0.60, "> 60 %": math.inf}
"""Upper ends of the bins of the object's visible share."""

Summary = dict[str, Any]


def summarise(results: Iterable[FrameResult]) -> Summary:
    """Everything the report tells, as JSON values; lengths [m], angles [rad], times [s].

    Frames without an answer and frames the estimator failed on count as missed; files that could
    not be read are counted apart. Shares carry a 95 % confidence interval (Wilson).
    """
    every = sorted(results, key=lambda r: r.frame)
    scored = [r for r in every if r.outcome != "unreadable"]
    outcomes = Counter(r.outcome for r in every)
    return {
        "frames": {k: outcomes[k] for k in ("answer", "no answer", "error", "unreadable")},
        "recall": {
            "all": _recall(scored),
            "set": _by(scored, lambda r: r.frame.rsplit("/", 1)[0]),
            "object": _by(scored, lambda r: r.object_name),
            "visible share": _by(scored, _visible_bin, list(VISIBLE_BINS)),
        },
        "top3_recall": _share(
            [any(adi < SOLVED for adi in r.candidates_adi) for r in scored if r.candidates_adi],
            len(scored),
        ),
        "confidence_auroc": _confidence_auroc(scored),
        "pose_error": {
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


def _share(hits: Sequence[bool], frames: int) -> dict[str, Any]:
    """A share of frames; frames that have no entry in `hits` are misses."""
    low, high = wilson_interval(sum(hits), frames)
    share = sum(hits) / frames if frames else None
    return {"share": share, "low": low, "high": high, "frames": frames}


def _recall(results: Sequence[FrameResult]) -> dict[str, dict[str, Any]]:
    adi = [r.adi for r in results if r.adi is not None]
    return {k: _share([a < limit for a in adi], len(results)) for k, limit in THRESHOLDS.items()}


def _by(
    results: Sequence[FrameResult],
    group: Callable[[FrameResult], str],
    order: Sequence[str] | None = None,
) -> dict[str, dict[str, dict[str, Any]]]:
    """Recall of every group."""
    names = order or sorted({group(r) for r in results})
    groups = {name: [r for r in results if group(r) == name] for name in names}
    return {name: _recall(members) for name, members in groups.items() if members}


def _visible_bin(result: FrameResult) -> str:
    share = result.visible_share or 0.0
    return next(name for name, upper in VISIBLE_BINS.items() if share < upper)


def _spread(values: Iterable[float | None]) -> dict[str, Any]:
    """Median and 95th percentile of the values that are there."""
    known = [v for v in values if v is not None]
    if not known:
        return {"median": None, "p95": None, "count": 0}
    return {
        "median": float(np.median(known)),
        "p95": float(np.percentile(known, 95)),
        "count": len(known),
    }


def _confidence_auroc(results: Sequence[FrameResult]) -> float | None:
    """Over the frames with an answer."""
    answers = [(r.confidence, r.adi < SOLVED) for r in results if r.adi is not None]
    return auroc([a[0] for a in answers], [a[1] for a in answers])


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


def print_summary(summary: Summary, console: Console) -> None:
    """Print the summary as tables."""
    for table in (
        _recall_table(summary["recall"]),
        _hand_table(summary),
        _stage_table(summary["stages"]),
        _time_table(summary["time"]),
    ):
        if table.row_count:
            console.print(table)
    top3, area = summary["top3_recall"], summary["confidence_auroc"]
    memory = summary["peak_memory"]
    console.print(f"Best of the first 3 candidates, ADI < 5 mm: {_percent(top3)}")
    console.print(f"AUROC of the confidence: {'-' if area is None else f'{area:.2f}'}")
    console.print(f"Peak memory: {'-' if memory is None else f'{memory / 2**30:.2f} GiB'}")
    counts = ", ".join(f"{n} {name}" for name, n in summary["frames"].items() if n)
    console.print(f"Frames: {counts or 'none'}")
    for failure in summary["failures"]:
        if failure["outcome"] != "no answer":
            console.print(
                f"[red]{failure['outcome']}[/red] {failure['frame']}: ", end="", highlight=False
            )
            console.print(failure["reason"], markup=False, highlight=False)


def _percent(share: Mapping[str, Any]) -> str:
    if share["share"] is None:
        return "-"
    low, high = 100 * share["low"], 100 * share["high"]
    return f"{share['share']:.0%} ({low:.0f}-{high:.0f})"


def _recall_table(recall: Mapping[str, Any]) -> Table:
    table = Table("", "frames", *(f"ADI < {t}" for t in THRESHOLDS), title="Recall (95 % interval)")

    def add(name: str, shares: Mapping[str, Any], end_section: bool = False) -> None:
        frames = str(shares["5 mm"]["frames"])
        table.add_row(
            name, frames, *(_percent(shares[t]) for t in THRESHOLDS), end_section=end_section
        )

    add("all frames", recall["all"], end_section=True)
    for group in ("set", "object", "visible share"):
        members = recall[group]
        for name, shares in members.items():
            label = f"{name} visible" if group == "visible share" else name
            add(label, shares, end_section=name == list(members)[-1])
    return table


def _hand_table(summary: Summary) -> Table:
    table = Table("", "count", "median", "95 %", title="Errors")

    def add(name: str, spread: Mapping[str, Any], scale: float, unit: str) -> None:
        if spread["count"]:
            median, p95 = spread["median"] * scale, spread["p95"] * scale
            row = (str(spread["count"]), f"{median:.1f} {unit}", f"{p95:.1f} {unit}")
            table.add_row(name, *row)

    degrees = math.degrees(1)
    for name, spread in summary["finger_error"].items():
        label = f"joint angles (> {JOINT_PIXELS} pixels)" if name == "all" else f"  {name}"
        add(label, spread, degrees, "deg")
    for stage, errors in summary["wrist_error"].items():
        add(f"wrist position, {stage}", errors["translation"], 1000, "mm")
        add(f"wrist rotation, {stage}", errors["rotation"], degrees, "deg")
    add("object position", summary["pose_error"]["translation"], 1000, "mm")
    add("object rotation", summary["pose_error"]["rotation"], degrees, "deg")
    add("segment precision", summary["segment"]["precision"], 100, "%")
    add("segment recall", summary["segment"]["recall"], 100, "%")
    return table


def _stage_table(stages: Mapping[str, Any]) -> Table:
    table = Table("stage", "frames with a good pose", "frames lost here", title="Stages")
    for stage, row in stages.items():
        table.add_row(stage, _percent(row["alive"]) if row["alive"] else "", str(row["lost"] or ""))
    return table


def _time_table(times: Mapping[str, Any]) -> Table:
    table = Table("stage", "median", "95 %", title="Time")
    for stage, spread in times.items():
        if spread["count"]:
            row = (f"{spread['median'] * 1000:.1f} ms", f"{spread['p95'] * 1000:.1f} ms")
            table.add_row(stage, *row)
    return table
