"""What a benchmark prints when it is done."""

from rich.console import Console

from inhand.evaluation import tables
from inhand.evaluation.cells import number, percent
from inhand.evaluation.comparison import Summaries
from inhand.evaluation.comparison_tables import overview_table
from inhand.evaluation.method_tables import method_tables
from inhand.evaluation.summary import (
    Summary,
)


def print_summary(summary: Summary, console: Console) -> None:
    """Print the summary of one method as tables."""
    for table in method_tables(summary):
        console.print(tables.terminal(table))
    area, memory = summary["confidence"]["auroc"]["value"], summary["peak_memory"]
    console.print(
        f"Best of the first 3 candidates, ADI < 5 mm: {percent(summary['top3_recall'], 0)} %\n"
        f"AUROC of the confidence: {number(area, 1, 2)}\n"
        f"Peak memory: {number(memory, 2**-30, 2, ' GiB')}\n"
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


def _outcomes(summary: Summary) -> str:
    return ", ".join(f"{n} {name}" for name, n in summary["frames"].items() if n) or "none"
