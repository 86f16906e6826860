"""Benchmark results of one method, as tables."""

from collections.abc import Mapping
from typing import Any

from inhand.evaluation.cells import DEGREE, number, percent
from inhand.evaluation.results import JOINT_PIXELS
from inhand.evaluation.summary import (
    THRESHOLDS,
    Summary,
)
from inhand.evaluation.tables import Table


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
            numbers = (number(spread[k], scale, 1, unit) for k in ("median", "p95"))
            rows.append((name, str(spread["count"]), *numbers))

    for name, spread in summary["finger_error"].items():
        label = f"joint angles (> {JOINT_PIXELS} pixels)" if name == "all" else f"  {name}"
        add(label, spread, DEGREE, " deg")
    for stage, errors in summary["wrist_error"].items():
        add(f"wrist position, {stage}", errors["translation"], 1000, " mm")
        add(f"wrist rotation, {stage}", errors["rotation"], DEGREE, " deg")
    add("object ADI", summary["pose_error"]["adi"], 1000, " mm")
    add("object position", summary["pose_error"]["translation"], 1000, " mm")
    add("object rotation", summary["pose_error"]["rotation"], DEGREE, " deg")
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
        (stage, *(number(spread[k], 1000, 1, " ms") for k in numbers))
        for stage, spread in times.items()
        if spread["count"]
    )
    return Table("Time", ("stage", "mean", "deviation", "median", "95 %", "99 %"), rows)
