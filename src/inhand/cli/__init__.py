"""The command line: `inhand COMMAND`, one file a command.

The files are imported for `inhand --help`, so they load their libraries only when they run.
"""

import sys
from collections.abc import Callable, Sequence
from typing import Annotated, Any

import tyro

from inhand import __version__
from inhand.cli import annotate, bench, demo, estimate, report, run, synth, view, warmup
from inhand.errors import InputError

FOUND, NOT_FOUND, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
"""Exit codes."""

_RUN: dict[type, Callable[[Any], int | None]] = {
    demo.Demo: demo.run,
    estimate.Estimate: estimate.run,
    bench.Bench: bench.run,
    report.Report: report.run,
    run.Run: run.run,
    synth.Synth: synth.run,
    annotate.Annotate: annotate.run,
    view.View: view.run,
    warmup.Warmup: warmup.run,
}
_Command = (
    Annotated[demo.Demo, tyro.conf.subcommand("demo")]
    | Annotated[estimate.Estimate, tyro.conf.subcommand("estimate")]
    | Annotated[bench.Bench, tyro.conf.subcommand("bench")]
    | Annotated[report.Report, tyro.conf.subcommand("report")]
    | Annotated[run.Run, tyro.conf.subcommand("run")]
    | Annotated[synth.Synth, tyro.conf.subcommand("synth")]
    | Annotated[annotate.Annotate, tyro.conf.subcommand("annotate")]
    | Annotated[view.View, tyro.conf.subcommand("view")]
    | Annotated[warmup.Warmup, tyro.conf.subcommand("warmup")]
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (default: the process's own) and return its exit code.

    0: done, and the pose found where one was asked for; 1: no pose found; 2: bad input.
    """
    if (sys.argv[1:] if argv is None else list(argv)) == ["--version"]:
        print(__version__)  # noqa: T201
        return FOUND
    command = tyro.cli(
        _Command,
        prog="inhand",
        description="6D pose of the object in a robot's hand, from one depth image.",
        args=argv,
    )
    try:
        return _RUN[type(command)](command) or 0
    except InputError as error:
        print("inhand:", str(error).replace("\n", " "), file=sys.stderr)  # noqa: T201
        return BAD_INPUT
    except KeyboardInterrupt:
        return INTERRUPTED
