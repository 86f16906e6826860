"""`inhand report`: tables and figures of benchmark results."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from inhand.cli.common import waiting


@dataclass(frozen=True)
class Report:
    """Make a report of benchmark results: tables, figures, and pictures of frames.

    Writes `report.html` (one page that needs nothing beside it), `tables.md` and the figures as
    SVG to the output folder. Every table and figure says which run made it: command, settings,
    commit and machine.
    """

    results: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Output folders of `inhand bench`, or results files."""
    out: Path = Path("out/report")
    """Output folder."""
    title: str = "Benchmark of in-hand object pose estimation"
    """Title of the page."""
    reference: str | None = None
    """Method that the others are compared with. Default: inhand, or the first one."""
    pictures: int = 8
    """Successes, and failures, of the reference in the gallery of a data set; 0 for none."""


def run(args: Report) -> int:
    """Write the report.

    Raises:
        InputError: there are no results, or matplotlib is not installed.
    """
    from inhand.errors import InputError

    try:
        from inhand.evaluation.make_report import make_report
    except ModuleNotFoundError as error:
        if error.name != "matplotlib":
            raise
        raise InputError(
            'the figures need matplotlib, which is not installed: pip install "inhand[bench]"'
        ) from error
    from inhand.evaluation.page import write_report
    from inhand.evaluation.study import load_study

    console = Console()
    with waiting(console, "Reading the results"):
        study = load_study(args.results)
    with waiting(console, "Making the report"):
        report = make_report(study, args.title, args.reference, args.pictures)
        written = write_report(report, args.out)
    for remark in report.remarks:
        console.print(f"[yellow]{remark}[/yellow]")
    console.print(f"Wrote {written[0]}, {written[1].name} and {len(written) - 2} figures")
    return 0
