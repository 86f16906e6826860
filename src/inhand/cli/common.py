"""What several commands share."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Timer
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from rich.console import Console

    from inhand.config import EstimatorConfig
    from inhand.estimate import PoseEstimate
    from inhand.object_model import ObjectModel

Preset = Literal["default", "paper"]

PATIENCE = 2.0
"""A log is told what is being waited for when that has taken this long [s]."""


def make_config(preset: Preset, seed: int) -> "EstimatorConfig":
    """The estimator's configuration: the project's own (`default`) or the paper's method."""
    from dataclasses import replace

    from inhand.config import EstimatorConfig

    config = EstimatorConfig.paper() if preset == "paper" else EstimatorConfig()
    return replace(config, seed=seed)


@contextmanager
def waiting(console: "Console", text: str) -> Iterator[Callable[[str], None]]:
    """Say what is being waited for: in a line that goes away again, or once in a log.

    Gives what changes the line.
    """
    if console.is_terminal:
        with console.status(text) as line:
            yield line.update
        return
    timer = Timer(PATIENCE, console.print, [text], {"highlight": False, "markup": False})
    timer.start()
    try:
        yield lambda _: None
    finally:
        timer.cancel()


def load_kernels(device: str, console: "Console") -> None:
    """Load all kernels under one progress line; the first time on a machine compiles them."""
    from inhand.kernels.launch import load_all_kernels

    text = "Loading kernels (the first time compiles them: some ten seconds)"
    with waiting(console, text) as say:
        load_all_kernels(device, lambda name: say(f"{text}: {name}"))


def print_estimate(estimate: "PoseEstimate", obj: "ObjectModel", console: "Console") -> None:
    """Print the object's size, its pose, the joint angles and the times, or why there is none."""
    from math import degrees

    from rich.markup import escape
    from rich.table import Table

    if not estimate.found:
        console.print(f"[bold red]Not found:[/] {estimate.reason}", highlight=False)
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column(style="dim")
    table.add_row("object", f"{escape(obj.name)}, {1000 * obj.diameter:.0f} mm across")
    if estimate.found:
        table.add_row("confidence", f"{estimate.confidence:.2f}")
    for name in ("T_camera_object", "T_camera_hand"):
        T = getattr(estimate, name)
        if T is not None:
            rows = ("  ".join(f"{x:8.4f}" for x in row) for row in T)
            table.add_row(name, "\n".join(rows))
    if estimate.joint_positions:
        joints = estimate.joint_positions.items()
        table.add_row("joints", "\n".join(f"{degrees(q):7.1f} deg  {name}" for name, q in joints))
    times = " + ".join(f"{stage} {1000 * t:.0f}" for stage, t in estimate.timings.items())
    table.add_row("time [ms]", f"{1000 * sum(estimate.timings.values()):.0f} = {times}")
    console.print(table, highlight=False)
