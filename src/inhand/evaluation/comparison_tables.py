"""Benchmark results of several methods beside each other, one table a question."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

from inhand.evaluation.cells import DEGREE, IN_PERCENT, NOTHING, interval, number, percent
from inhand.evaluation.comparison import (
    Column,
    Summaries,
    at,
    compare,
    count_column,
    error_column,
    mean_column,
    share_column,
)
from inhand.evaluation.diagnosis import POSE_STAGES, STAGES
from inhand.evaluation.results import JOINT_PIXELS
from inhand.evaluation.statistics import mean
from inhand.evaluation.study import UNITS, by_quantity
from inhand.evaluation.summary import (
    AREA_LIMIT,
    THRESHOLDS,
    VISIBLE_BINS,
    Results,
    is_solved,
    solved_share,
)
from inhand.evaluation.tables import Table


def overview_table(summaries: Summaries) -> Table:
    """Recall at every threshold, the area under its curve, and time."""
    columns = [
        count_column("frames", "recall", "all", "5 mm", "frames"),
        *(share_column(f"ADI < {t}", "recall", "all", t) for t in THRESHOLDS),
        mean_column("area", "measures", "area", "frames"),
        error_column(
            "median time [ms]", "time", "whole estimate", "median", scale=1000, decimals=0
        ),
    ]
    note = f"{IN_PERCENT} Area: under the recall curve up to {AREA_LIMIT * 1000:.0f} mm."
    return compare("Methods", summaries, columns, note)


def object_table(summaries: Summaries) -> Table:
    """Recall at 5 mm by object, with the mean over objects and over frames."""
    names = sorted({name for s in summaries.values() for name in s["recall"]["object"]})
    columns = [
        share_column("mean of frames", "recall", "all", "5 mm"),
        mean_column("mean of objects", "measures", "recall", "objects"),
        *(share_column(name, "recall", "object", name, "5 mm") for name in names),
    ]
    return compare("Recall by object (ADI < 5 mm)", summaries, columns, IN_PERCENT)


def visible_table(summaries: Summaries) -> Table:
    """Recall at 5 mm by the visible share of the object."""
    found = {name for s in summaries.values() for name in s["recall"]["visible share"]}
    columns = [
        share_column(f"{name} visible", "recall", "visible share", name, "5 mm")
        for name in VISIBLE_BINS
        if name in found
    ]
    return compare("Recall by visible share (ADI < 5 mm)", summaries, columns, IN_PERCENT)


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
        share_column("ADI < 5 mm", "recall", "all", "5 mm"),
        *(mean_column(head, "measures", name, "frames") for name, head in heads.items()),
        error_column("median ADI [mm]", "pose_error", "adi", "median", scale=1000),
    ]
    note = f"{IN_PERCENT} AR: BOP's average recall. The median is that of the answers."
    return compare("Other measures", summaries, columns, note)


def time_table(summaries: Summaries) -> Table:
    """How long a frame takes."""
    numbers = {"mean": "mean", "deviation": "deviation", "median": "median"}
    numbers |= {"p95": "95 %", "p99": "99 %"}
    memory = at("peak_memory")
    columns = [
        *(
            error_column(head, "time", "whole estimate", key, scale=1000)
            for key, head in numbers.items()
        ),
        Column("peak memory [GiB]", lambda s: number(memory(s), 2**-30, 2)),
    ]
    note = (
        "In ms. The memory is that of the whole process, with the scoring and all methods that "
        "ran in it before."
    )
    return compare("Time of a frame", summaries, columns, note)


def stage_time_table(summaries: Summaries) -> Table:
    """How long every stage takes, one column a method."""
    stages = dict.fromkeys(stage for s in summaries.values() for stage in s["time"])
    stages["whole estimate"] = stages.pop("whole estimate", None)

    def cell(spread: Mapping[str, Any]) -> str:
        if not spread.get("count"):
            return NOTHING
        return " / ".join(number(spread[k], 1000, 1) for k in ("median", "p95", "p99"))

    rows = tuple(
        (stage, *(cell(s["time"].get(stage, {})) for s in summaries.values())) for stage in stages
    )
    note = "Median / 95 % / 99 % quantile in ms."
    return Table("Time by stage", ("stage", *summaries), rows, note)


def hand_table(summaries: Summaries) -> Table:
    """Errors of the hand's state."""

    def column(head: str, scale: float, *keys: str) -> Column:
        find = at(*keys)
        given = "given" in keys  # the data set's doing, not the method's
        return Column(
            head,
            lambda s: " / ".join(number(find(s)[k], scale, 1) for k in ("median", "p95")),
            lambda s: None if given or find(s)["median"] is None else -find(s)["median"],
        )

    columns = [
        column("joint angles [deg]", DEGREE, "finger_error", "all"),
        column("wrist [mm]", 1000, "wrist_error", "answer", "translation"),
        column("as given [mm]", 1000, "wrist_error", "given", "translation"),
        column("wrist [deg]", DEGREE, "wrist_error", "answer", "rotation"),
        column("as given [deg]", DEGREE, "wrist_error", "given", "rotation"),
    ]
    note = (
        f"Median / 95 % quantile. Of the joints, those whose link shows more than {JOINT_PIXELS} "
        "pixels count."
    )
    return compare("Errors of the hand", summaries, columns, note)


def alive_table(summaries: Summaries) -> Table:
    """The share of frames for which every stage handed on a good pose."""
    stages = [s for s in POSE_STAGES if any(s in m["stages"] for m in summaries.values())]
    columns = [share_column(stage, "stages", stage, "alive") for stage in stages]
    return compare("Frames with a good pose after a stage", summaries, columns, IN_PERCENT)


def lost_table(summaries: Summaries) -> Table:
    """How many frames every stage lost."""
    stages = (*STAGES, "error")
    losing = [
        stage
        for stage in stages
        if any(m["stages"].get(stage, {}).get("lost") for m in summaries.values())
    ]
    columns = [count_column(stage, "stages", stage, "lost") for stage in losing]
    return compare("Frames lost at a stage", summaries, columns)


def confidence_table(summaries: Summaries) -> Table:
    """How much the confidence is worth."""
    columns = [
        mean_column("AUROC", "confidence", "auroc"),
        error_column("calibration error", "confidence", "calibration_error", scale=100),
        share_column("ADI < 5 mm, first answer", "recall", "all", "5 mm"),
        share_column("best of the first 3", "top3_recall"),
    ]
    note = (
        f"{IN_PERCENT} AUROC: chance that a right answer (ADI < 5 mm) has a higher confidence "
        "than a wrong one. Calibration error: mean gap between the confidence and the share of "
        "right answers."
    )
    return compare("Confidence", summaries, columns, note)


def outcome_table(summaries: Summaries) -> Table:
    """What became of the frames."""
    names = ("answer", "no answer", "error", "unreadable")
    columns = [count_column(name, "frames", name) for name in names]
    note = (
        "Frames without an answer and frames that a method failed on count as misses; files that "
        "could not be read are left out of every share."
    )
    return compare("Frames", summaries, columns, note)


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
        rows.append((method, *numbers, interval(gain)))
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
    return Table("Ablation (ADI < 5 mm)", ("step", "recall", "gain [points]"), rows, IN_PERCENT)


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
    return Table("Recall by perturbation (ADI < 5 mm)", columns, tuple(rows), IN_PERCENT)
