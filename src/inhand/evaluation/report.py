"""What benchmark results say, as tables: of one method, and of several beside each other."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from rich.console import Console

from inhand.evaluation import tables
from inhand.evaluation.diagnosis import POSE_STAGES, STAGES
from inhand.evaluation.results import JOINT_PIXELS
from inhand.evaluation.statistics import Estimate, mean
from inhand.evaluation.study import UNITS, UPPER_BOUND, by_quantity
from inhand.evaluation.summary import (
    AREA_LIMIT,
    THRESHOLDS,
    VISIBLE_BINS,
    Results,
    Summary,
    is_solved,
    solved_share,
)
from inhand.evaluation.tables import Best, Table

NOTHING = "-"
"""Stands where there is no number."""

_DEGREE = math.degrees(1)

Summaries = Mapping[str, Summary]
"""Summaries by method."""


def print_summary(summary: Summary, console: Console) -> None:
    """Print the summary of one method as tables."""
    for table in method_tables(summary):
        console.print(tables.terminal(table))
    area, memory = summary["confidence"]["auroc"]["value"], summary["peak_memory"]
    console.print(
        f"Best of the first 3 candidates, ADI < 5 mm: {percent(summary['top3_recall'], 0)} %\n"
        f"AUROC of the confidence: {_number(area, 1, 2)}\n"
        f"Peak memory: {_number(memory, 2**-30, 2, ' GiB')}\n"
        f"Frames: {_outcomes(summary)}"
    )
    for failure in summary["failures"]:
        if failure["outcome"] != "no answer":
            console.print(
                f"[red]{failure['outcome']}[/red] {failure['frame']}: ", end="", highlight=False
            )
            console.print(failure["reason"], markup=False, highlight=False)


def print_comparison(summaries: Summaries, console: Console) -> None:
    """Print one line for each method, and which had frames that went wrong."""
    console.print(tables.terminal(overview_table(summaries)))
    for method, summary in summaries.items():
        if summary["frames"]["error"] or summary["frames"]["unreadable"]:
            console.print(f"[red]{method}[/red]: {_outcomes(summary)}", highlight=False)


def method_tables(summary: Summary) -> list[Table]:
    """The tables of one method that have any rows."""
    found = (
        _recall_table(summary["recall"]),
        _error_table(summary),
        _stage_table(summary["stages"]),
        _time_table(summary["time"]),
    )
    return [table for table in found if table.rows]


def _recall_table(recall: Mapping[str, Any]) -> Table:
    rows, ends = [], set()

    def add(name: str, shares: Mapping[str, Any]) -> None:
        frames = str(shares["5 mm"]["frames"])
        rows.append((name, frames, *(percent(shares[t], 0) for t in THRESHOLDS)))

    add("all frames", recall["all"])
    for group in ("set", "object", "visible share"):
        ends.add(len(rows) - 1)
        for name, shares in recall[group].items():
            add(f"{name} visible" if group == "visible share" else name, shares)
    columns = ("", "frames", *(f"ADI < {t}" for t in THRESHOLDS))
    return Table("Recall [%] (95 % interval)", columns, tuple(rows), section_ends=frozenset(ends))


def _error_table(summary: Summary) -> Table:
    rows = []

    def add(name: str, spread: Mapping[str, Any], scale: float, unit: str) -> None:
        if spread["count"]:
            numbers = (_number(spread[k], scale, 1, unit) for k in ("median", "p95"))
            rows.append((name, str(spread["count"]), *numbers))

    for name, spread in summary["finger_error"].items():
        label = f"joint angles (> {JOINT_PIXELS} pixels)" if name == "all" else f"  {name}"
        add(label, spread, _DEGREE, " deg")
    for stage, errors in summary["wrist_error"].items():
        add(f"wrist position, {stage}", errors["translation"], 1000, " mm")
        add(f"wrist rotation, {stage}", errors["rotation"], _DEGREE, " deg")
    add("object ADI", summary["pose_error"]["adi"], 1000, " mm")
    add("object position", summary["pose_error"]["translation"], 1000, " mm")
    add("object rotation", summary["pose_error"]["rotation"], _DEGREE, " deg")
    add("segment precision", summary["segment"]["precision"], 100, " %")
    add("segment recall", summary["segment"]["recall"], 100, " %")
    return Table("Errors", ("", "count", "median", "95 %"), tuple(rows))


def _stage_table(stages: Mapping[str, Any]) -> Table:
    rows = tuple(
        (stage, percent(row["alive"], 0) if row["alive"] else "", str(row["lost"] or ""))
        for stage, row in stages.items()
    )
    return Table("Stages", ("stage", "good pose [%]", "frames lost here"), rows)


def _time_table(times: Mapping[str, Any]) -> Table:
    numbers = ("mean", "deviation", "median", "p95", "p99")
    rows = tuple(
        (stage, *(_number(spread[k], 1000, 1, " ms") for k in numbers))
        for stage, spread in times.items()
        if spread["count"]
    )
    return Table("Time", ("stage", "mean", "deviation", "median", "95 %", "99 %"), rows)


@dataclass(frozen=True)
class _Column:
    """A column of a comparison: what it shows of a method."""

    head: str
    cell: Callable[[Summary], str]
    rank: Callable[[Summary], float | None] = lambda _: None
    """The method with the highest number stands out."""


def _compare(title: str, summaries: Summaries, columns: Sequence[_Column], note: str = "") -> Table:
    """One row a method; the best cell of a column stands out, upper bounds left aside."""
    rows = [[name, *(c.cell(s) for c in columns)] for name, s in summaries.items()]
    for i, column in enumerate(columns, start=1):
        ranks = [
            None if name.endswith(UPPER_BOUND) else column.rank(s) for name, s in summaries.items()
        ]
        known = [r for r in ranks if r is not None]
        for row, rank in zip(rows, ranks, strict=True):
            if len(known) > 1 and rank == max(known) > min(known):
                row[i] = Best(row[i])
    heads = ("method", *(c.head for c in columns))
    return Table(title, heads, tuple(map(tuple, rows)), note)


def _at(*keys: str) -> Callable[[Summary], Any]:
    """What a summary holds under these keys, one in the other; None where there is nothing."""

    def find(summary: Summary) -> Any:
        value: Any = summary
        for key in keys:
            value = None if value is None else value.get(key)
        return value

    return find


def _share_column(head: str, *keys: str) -> _Column:
    """A share and its interval."""
    find = _at(*keys)
    return _Column(head, lambda s: percent(find(s)), _at(*keys, "share"))


def _mean_column(head: str, *keys: str) -> _Column:
    """A mean of shares, or a statistic that is one, and its interval."""
    find = _at(*keys)
    return _Column(head, lambda s: _interval(Estimate(**find(s))), _at(*keys, "value"))


def _error_column(head: str, *keys: str, scale: float = 1, decimals: int = 1) -> _Column:
    """A number of which the smallest is the best."""
    find = _at(*keys)
    return _Column(
        head,
        lambda s: _number(find(s), scale, decimals),
        lambda s: None if find(s) is None else -find(s),
    )


def _count_column(head: str, *keys: str) -> _Column:
    find = _at(*keys)
    return _Column(head, lambda s: str(find(s) or 0))


_IN_PERCENT = "In %, with the 95 % interval in brackets."


def overview_table(summaries: Summaries) -> Table:
    """Recall at every threshold, the area under its curve, and time."""
    columns = [
        _count_column("frames", "recall", "all", "5 mm", "frames"),
        *(_share_column(f"ADI < {t}", "recall", "all", t) for t in THRESHOLDS),
        _mean_column("area", "measures", "area", "frames"),
        _error_column(
            "median time [ms]", "time", "whole estimate", "median", scale=1000, decimals=0
        ),
    ]
    note = f"{_IN_PERCENT} Area: under the recall curve up to {AREA_LIMIT * 1000:.0f} mm."
    return _compare("Methods", summaries, columns, note)


def object_table(summaries: Summaries) -> Table:
    """Recall at 5 mm by object, with the mean over objects and over frames."""
    names = sorted({name for s in summaries.values() for name in s["recall"]["object"]})
    columns = [
        _share_column("mean of frames", "recall", "all", "5 mm"),
        _mean_column("mean of objects", "measures", "recall", "objects"),
        *(_share_column(name, "recall", "object", name, "5 mm") for name in names),
    ]
    return _compare("Recall by object (ADI < 5 mm)", summaries, columns, _IN_PERCENT)


def visible_table(summaries: Summaries) -> Table:
    """Recall at 5 mm by the visible share of the object."""
    found = {name for s in summaries.values() for name in s["recall"]["visible share"]}
    columns = [
        _share_column(f"{name} visible", "recall", "visible share", name, "5 mm")
        for name in VISIBLE_BINS
        if name in found
    ]
    return _compare("Recall by visible share (ADI < 5 mm)", summaries, columns, _IN_PERCENT)


def measure_table(summaries: Summaries) -> Table:
    """The other measures in use beside the paper's."""
    heads = {
        "recall from truth": "ADI from truth < 5 mm",
        "recall ADD": "ADD < 5 mm",
        "VSD": "AR VSD",
        "MSSD": "AR MSSD",
        "MSPD": "AR MSPD",
        "BOP": "AR (BOP)",
    }
    columns = [
        _share_column("ADI < 5 mm", "recall", "all", "5 mm"),
        *(_mean_column(head, "measures", name, "frames") for name, head in heads.items()),
        _error_column("median ADI [mm]", "pose_error", "adi", "median", scale=1000),
    ]
    note = f"{_IN_PERCENT} AR: BOP's average recall. The median is that of the answers."
    return _compare("Other measures", summaries, columns, note)


def time_table(summaries: Summaries) -> Table:
    """How long a frame takes."""
    numbers = {"mean": "mean", "deviation": "deviation", "median": "median"}
    numbers |= {"p95": "95 %", "p99": "99 %"}
    memory = _at("peak_memory")
    columns = [
        *(
            _error_column(head, "time", "whole estimate", key, scale=1000)
            for key, head in numbers.items()
        ),
        _Column("peak memory [GiB]", lambda s: _number(memory(s), 2**-30, 2)),
    ]
    note = (
        "In ms. The memory is that of the whole process, with the scoring and all methods that "
        "ran in it before."
    )
    return _compare("Time of a frame", summaries, columns, note)


def stage_time_table(summaries: Summaries) -> Table:
    """How long every stage takes, one column a method."""
    stages = dict.fromkeys(stage for s in summaries.values() for stage in s["time"])
    stages["whole estimate"] = stages.pop("whole estimate", None)

    def cell(spread: Mapping[str, Any]) -> str:
        if not spread.get("count"):
            return NOTHING
        return " / ".join(_number(spread[k], 1000, 1) for k in ("median", "p95", "p99"))

    rows = tuple(
        (stage, *(cell(s["time"].get(stage, {})) for s in summaries.values())) for stage in stages
    )
    note = "Median / 95 % / 99 % quantile in ms."
    return Table("Time by stage", ("stage", *summaries), rows, note)


def hand_table(summaries: Summaries) -> Table:
    """Errors of the hand's state."""

    def column(head: str, scale: float, *keys: str) -> _Column:
        find = _at(*keys)
        given = "given" in keys  # the data set's doing, not the method's
        return _Column(
            head,
            lambda s: " / ".join(_number(find(s)[k], scale, 1) for k in ("median", "p95")),
            lambda s: None if given or find(s)["median"] is None else -find(s)["median"],
        )

    columns = [
        column("joint angles [deg]", _DEGREE, "finger_error", "all"),
        column("wrist [mm]", 1000, "wrist_error", "answer", "translation"),
        column("as given [mm]", 1000, "wrist_error", "given", "translation"),
        column("wrist [deg]", _DEGREE, "wrist_error", "answer", "rotation"),
        column("as given [deg]", _DEGREE, "wrist_error", "given", "rotation"),
    ]
    note = (
        f"Median / 95 % quantile. Of the joints, those whose link shows more than {JOINT_PIXELS} "
        "pixels count."
    )
    return _compare("Errors of the hand", summaries, columns, note)


def alive_table(summaries: Summaries) -> Table:
    """The share of frames for which every stage handed on a good pose."""
    stages = [s for s in POSE_STAGES if any(s in m["stages"] for m in summaries.values())]
    columns = [_share_column(stage, "stages", stage, "alive") for stage in stages]
    return _compare("Frames with a good pose after a stage", summaries, columns, _IN_PERCENT)


def lost_table(summaries: Summaries) -> Table:
    """How many frames every stage lost."""
    stages = (*STAGES, "error")
    losing = [
        stage
        for stage in stages
        if any(m["stages"].get(stage, {}).get("lost") for m in summaries.values())
    ]
    columns = [_count_column(stage, "stages", stage, "lost") for stage in losing]
    return _compare("Frames lost at a stage", summaries, columns)


def confidence_table(summaries: Summaries) -> Table:
    """How much the confidence is worth."""
    columns = [
        _mean_column("AUROC", "confidence", "auroc"),
        _error_column("calibration error", "confidence", "calibration_error", scale=100),
        _share_column("ADI < 5 mm, first answer", "recall", "all", "5 mm"),
        _share_column("best of the first 3", "top3_recall"),
    ]
    note = (
        f"{_IN_PERCENT} AUROC: chance that a right answer (ADI < 5 mm) has a higher confidence "
        "than a wrong one. Calibration error: mean gap between the confidence and the share of "
        "right answers."
    )
    return _compare("Confidence", summaries, columns, note)


def outcome_table(summaries: Summaries) -> Table:
    """What became of the frames."""
    names = ("answer", "no answer", "error", "unreadable")
    columns = [_count_column(name, "frames", name) for name in names]
    note = (
        "Frames without an answer and frames that a method failed on count as misses; files that "
        "could not be read are left out of every share."
    )
    return _compare("Frames", summaries, columns, note)


def difference_table(results: Results, reference: str) -> Table:
    """How much worse or better than one method the others are, on the frames both ran on."""
    solved = {method: {r.frame: is_solved(r) for r in of} for method, of in results.items()}
    base, rows = solved[reference], []
    for method, hits in solved.items():
        common = [frame for frame in hits if frame in base]
        if method == reference or not common:
            continue
        gain = mean([float(hits[f]) - base[f] for f in common])
        only_base = sum(base[f] and not hits[f] for f in common)
        only_method = sum(hits[f] and not base[f] for f in common)
        numbers = map(str, (len(common), only_base, only_method))
        rows.append((method, *numbers, _interval(gain)))
    columns = ("method", "frames", f"only {reference} right", "only this one right")
    note = (
        "Difference in points of recall, with its 95 % interval (bootstrap over the frames that "
        "both ran on): an interval without 0 is a difference that is not chance."
    )
    title = f"Difference to {reference} (ADI < 5 mm)"
    return Table(title, (*columns, "difference"), tuple(rows), note)


def ablation_table(steps: Summaries) -> Table:
    """Recall at 5 mm step by step."""
    shares = [s["recall"]["all"]["5 mm"] for s in steps.values()]
    gains = [100 * (after["share"] - before["share"]) for before, after in pairwise(shares)]
    rows = tuple(
        (f"+ {name}" if i else name, percent(shares[i]), f"{gains[i - 1]:+.1f}" if i else "")
        for i, name in enumerate(steps)
    )
    return Table("Ablation (ADI < 5 mm)", ("step", "recall", "gain [points]"), rows, _IN_PERCENT)


def perturbation_table(perturbed: Results) -> Table:
    """Recall at 5 mm by what the methods were handicapped by."""
    rows = []
    for quantity, methods in by_quantity(perturbed).items():
        unit, scale = UNITS.get(quantity, ("", 1.0))
        for method, amounts in methods.items():
            for amount, results in amounts.items():
                share = solved_share(results)
                handicap = f"{quantity} {amount * scale:.3g} {unit}".rstrip()
                rows.append((method, handicap, str(share["frames"]), percent(share)))
    columns = ("method", "perturbation", "frames", "recall")
    return Table("Recall by perturbation (ADI < 5 mm)", columns, tuple(rows), _IN_PERCENT)


def percent(share: Mapping[str, Any] | None, decimals: int = 1) -> str:
    """A share with its interval as a cell, in percent."""
    if share is None:
        return NOTHING
    estimate = Estimate(share["share"], share["low"], share["high"])
    return _interval(estimate, decimals=decimals)


def _interval(estimate: Estimate, decimals: int = 1) -> str:
    """A share in percent with its interval."""
    if estimate.value is None or estimate.low is None:
        return NOTHING
    value = _number(estimate.value, 100, decimals)
    low, high = (_number(x, 100, 0) for x in estimate[1:])
    return f"{value} ({low} to {high})" if estimate.low < 0 else f"{value} ({low}-{high})"


def _number(value: float | None, scale: float, decimals: int, unit: str = "") -> str:
    return NOTHING if value is None else f"{value * scale:.{decimals}f}{unit}"


def _outcomes(summary: Summary) -> str:
    return ", ".join(f"{n} {name}" for name, n in summary["frames"].items() if n) or "none"
