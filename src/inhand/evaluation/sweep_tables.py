"""What sweeps say, as tables: a row for every level."""

from collections import Counter
from collections.abc import Sequence
from statistics import median

from inhand.evaluation.cells import NOTHING, percent
from inhand.evaluation.results import FrameResult
from inhand.evaluation.statistics import auroc
from inhand.evaluation.summary import data_set, is_solved, solved_share
from inhand.evaluation.sweeps import SWEEPS, as_they_are, by_level
from inhand.evaluation.tables import Table

SURE = 0.5
"""Answers of a higher confidence claim to be right."""
AS_IT_IS = "as it is"
"""The row of frames that nothing was done to."""
_COLUMNS = (
    "recall [%]",
    "found [%]",
    "median confidence",
    "AUROC",
    "sure but wrong [%]",
    "median time [ms]",
    "lost at",
)
_NOTE = (
    "Recall: ADI < 5 mm. Without an answer, the confidence is 0. Sure but wrong: wrong answers of "
    f"a confidence above {SURE}. Lost at: how many frames every stage lost."
)


def sweep_tables(results: Sequence[FrameResult]) -> list[Table]:
    """A table for every data set, method and sweep in the results."""
    names = sorted({(data_set(r), r.method) for r in results})
    groups = {n: [r for r in results if (data_set(r), r.method) == n] for n in names}
    return [
        sweep_table(f"{name}, {method}", sweep, group)
        for (name, method), group in groups.items()
        for sweep in by_level(group)
    ]


def sweep_table(of: str, sweep: str, results: Sequence[FrameResult]) -> Table:
    """One sweep of one method on one data set, beside the frames as they are.

    Args:
        of: what the results are of.
        sweep: the sweep.
        results: results of frames as they are and at all levels; other sweeps are left out.
    """
    kind, levels = SWEEPS[sweep], by_level(results)[sweep]
    groups = {AS_IT_IS: as_they_are(levels, results)}
    groups |= {kind.words(level): of_level for level, of_level in levels.items()}
    rows = [(name, *_cells(group)) for name, group in groups.items() if group]
    columns = (kind.title, "frames", *_COLUMNS)
    return Table(f"{of}: {sweep}", columns, tuple(rows), _NOTE)


def _cells(results: Sequence[FrameResult]) -> tuple[str, ...]:
    """What `_COLUMNS` say of results at one level, their number first."""
    read = [r for r in results if r.outcome != "unreadable"]
    answers = [r for r in read if r.adi is not None]
    sure_but_wrong = [r for r in answers if r.confidence > SURE and not is_solved(r)]
    area = auroc([r.confidence for r in answers], list(map(is_solved, answers)))
    times = [1000 * r.seconds for r in read if r.seconds is not None]
    lost = Counter(r.lost_at for r in read if r.lost_at)
    return (
        str(len(read)),
        percent(solved_share(read)),
        f"{100 * len(answers) / len(read):.0f}" if read else NOTHING,
        f"{median(r.confidence for r in read):.2f}" if read else NOTHING,
        NOTHING if area is None else f"{area:.2f}",
        f"{100 * len(sure_but_wrong) / len(read):.0f}" if read else NOTHING,
        f"{median(times):.0f}" if times else NOTHING,
        ", ".join(f"{stage} {count}" for stage, count in lost.most_common()),
    )
