"""Made-up results of a benchmark, whose numbers are known."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from inhand.evaluation.machine import origin
from inhand.evaluation.results import FrameResult, Ledger
from inhand.evaluation.study import Study, load_study
from inhand.evaluation.summary import summarise
from inhand.evaluation.tables import Table

SETTINGS = {"version": "1", "hand": "/nowhere/hand.urdf", "objects": "/nowhere/objects"}
STAGES = ("hypotheses", "clustering", "refinement", "pruning", "selection")


def result(i: int, method: str = "inhand", adi: float | None = 0.001, **more: Any) -> FrameResult:
    """A result on frame `i`: objects in turn, a third of them hardly visible."""
    errors = {} if adi is None else {"adi_from_truth": adi, "add": 2 * adi, "mssd": 3 * adi}
    share = 0.0 if adi is None else 0.5
    return FrameResult(
        frame=f"{more.pop('data_set', 'clean')}/{i:03d}",
        file=f"/nowhere/{i}.npz",
        outcome="answer" if adi is not None else "no answer",
        object_name=("can", "box")[i % 2],
        visible_share=(0.05, 0.5, 0.9)[i % 3],
        method=method,
        adi=adi,
        **{"mssd_share": share, "mspd_share": share, "vsd_share": share / 2, **errors, **more},
    )


def pipeline(i: int, adi: float | None = 0.001, **more: Any) -> FrameResult:
    """A result with everything that a variant of the pipeline tells."""
    return result(
        i,
        adi=adi,
        confidence=0.9 if adi is not None and adi < 0.005 else 0.2,
        candidates_adi=[adi or 1.0],
        best_adi=dict.fromkeys(STAGES, 0.001),
        joint_errors={"finger": 0.02},
        joint_pixels={"finger": 900},
        wrist_errors={"given": [0.004, 0.02], "answer": [0.001, 0.01]},
        timings={"observation": 0.01, "hypotheses": 0.02},
        seconds=0.04,
        peak_memory=2**30,
        lost_at=None if adi is not None and adi < 0.005 else "selection",
        **more,
    )


def everything() -> list[FrameResult]:
    """Results of several methods, with an ablation and perturbed starts."""
    found = [pipeline(i, adi) for i, adi in enumerate([0.001, 0.003, 0.007, None, 0.001, 0.030])]
    found += [pipeline(i, 0.001, data_set="noisy") for i in range(3)]
    found += [result(i, "fpfh+hs", 0.004 + 0.004 * (i % 2), seconds=0.1) for i in range(6)]
    found += [result(i, "fpfh+mask", 0.0005, seconds=0.1) for i in range(6)]
    found += [result(i, "ablation-baseline", 0.02 if i else 0.001) for i in range(4)]
    found += [result(i, "ablation-pairs", 0.001) for i in range(4)]
    for amount in (0.0, 0.01, 0.02):
        found += [
            result(i, "icp", 0.002 + amount / 4, perturbation={"translation": amount})
            for i in range(4)
        ]
    found += [
        pipeline(i, 0.003 * k, perturbation={"noise": 1.0 * k}) for i in range(4) for k in (1, 2)
    ]
    found.append(replace(result(6, "fpfh+hs", None), outcome="error", reason="a | <b> & c"))
    found.append(replace(result(7, "fpfh+hs", None), outcome="unreadable", reason="cut short"))
    return found


def write(folder: Path, results: Iterable[FrameResult], **settings: Any) -> Path:
    ledger = Ledger(folder / "results.jsonl", {**SETTINGS, **settings}, origin("cpu"))
    for r in results:
        ledger.append(r)
    return folder


def study_of_everything(folder: Path) -> Study:
    """`everything`, written to a folder and read again."""
    return load_study([write(folder / "bench", everything())])


def cell(table: Table, row: str, column: str) -> str:
    found = [r for r in table.rows if r[0] == row]
    assert len(found) == 1, (row, table.rows)
    return found[0][table.columns.index(column)]


def summaries(study: Study, name: str = "clean") -> dict[str, Any]:
    return {method: summarise(results) for method, results in study.results(name).items()}
