"""`inhand bench`: how good the estimator is on frames with ground truth."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich import progress
from rich.console import Console

from inhand.cli.common import Preset, load_kernels, make_config

if TYPE_CHECKING:
    from inhand.evaluation.benchmark import Benchmark
    from inhand.evaluation.contact_sheet import ContactSheet
    from inhand.evaluation.results import FrameResult, Ledger

INTERRUPTED = 130
"""Exit code after Ctrl-C."""
DEFAULT_HAND = "hands/t42/hand_T42b.urdf"
"""Looked for beside the frames and above."""
WORST = 24
"""Frames on the contact sheet."""


@dataclass(frozen=True)
class Bench:
    """Run the estimator over frames with ground truth and report how good it is.

    Prints recall, errors, times and the stage that loses each frame; writes `results.jsonl` (one
    line a frame), `summary.json` and `worst.png` (the worst frames) to the output folder. Ctrl-C
    keeps what is done; the same command goes on from there.
    """

    frames: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """BOP data sets such as `inhand synth` makes, folders of .npz frames, or folders of these."""
    out: Path | None = None
    """Output folder. Default: out/bench-NAME, after the frames' folder."""
    objects: Path | None = None
    """Folder of the object meshes. Default: the data set's, or `objects` beside it or above."""
    hand: Path | None = None
    """URDF of the hand. Default: the one that the data set names, or `hands/t42/hand_T42b.urdf`
    beside it or above."""
    every: int = 1
    """Take only every n-th frame."""
    limit: int | None = None
    """Take at most this many frames, spread evenly."""
    preset: Preset = "default"
    """Configuration: the project's own, or the paper's method."""
    device: str | None = None
    """Where the kernels run, such as cpu or cuda:0. Default: the best there is."""
    seed: int = 0
    """Seed of everything random."""
    restart: bool = False
    """Drop the results of an earlier run in the output folder."""


def run(args: Bench) -> int:
    """Run the benchmark; the exit code says whether Ctrl-C stopped it.

    Raises:
        InputError: there are no frames, no hand or no objects, or the output folder holds results
            made with other settings.
    """
    from inhand.datasets.frames import find_frames, frame_name
    from inhand.evaluation.benchmark import pick_frames
    from inhand.evaluation.contact_sheet import worst_frames
    from inhand.evaluation.report import print_summary
    from inhand.evaluation.results import Ledger
    from inhand.evaluation.summary import summarise
    from inhand.kernels.launch import resolve_device

    console = Console()
    files = pick_frames(find_frames(args.frames), every=args.every, limit=args.limit)
    device = resolve_device(args.device)
    settings = _settings(args, device)
    out = args.out or Path("out") / f"bench-{'-'.join(f.resolve().name for f in args.frames)}"
    ledger = Ledger(out / "results.jsonl", settings, restart=args.restart)

    load_kernels(device, console)
    with console.status("Building the model of the hand (from the cache next time)"):
        benchmark, sheet = _tools(args, settings, device)
    finished = _run_with_progress(benchmark, files, ledger, console)
    results = [ledger.results[name] for name in map(frame_name, files) if name in ledger.results]
    summary = {"settings": settings, **summarise(results)}
    (out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
    print_summary(summary, console)
    if worst := worst_frames(results, WORST):
        sheet.save(out / "worst.png", worst)
    console.print(f"Wrote {out}/results.jsonl, summary.json and worst.png")
    if not finished:
        left = f"Stopped at {len(results)} of {len(files)} frames"
        console.print(f"[yellow]{left}; the same command goes on from there[/yellow]")
    return 0 if finished else INTERRUPTED


def _settings(args: Bench, device: str) -> dict[str, Any]:
    """What the results depend on."""
    import inhand
    from inhand.datasets.frames import find_hand, find_objects
    from inhand.errors import InputError
    from inhand.evaluation.results import source_key

    hand = args.hand or find_hand(args.frames[0], DEFAULT_HAND)
    objects = args.objects or find_objects(args.frames[0], "objects")
    if hand is None or objects is None:
        flag, what = ("--hand", DEFAULT_HAND) if hand is None else ("--objects", "objects")
        raise InputError(f"there is no {what} beside {args.frames[0]} or above: give {flag}")
    if not objects.is_dir():
        raise InputError(f"there is no folder of object meshes {objects}")
    return {
        "version": inhand.__version__,
        "source": source_key(),
        "preset": args.preset,
        "seed": args.seed,
        "device": device,
        "hand": str(hand.resolve()),
        "objects": str(objects.resolve()),
    }


def _tools(
    args: Bench, settings: dict[str, Any], device: str
) -> tuple["Benchmark", "ContactSheet"]:
    """The benchmark and the drawer of the contact sheet."""
    from inhand.datasets import frames
    from inhand.estimator import PoseEstimator
    from inhand.evaluation.benchmark import Benchmark
    from inhand.evaluation.contact_sheet import ContactSheet
    from inhand.hand import Hand
    from inhand.object_model import ObjectModel

    hand = Hand.from_urdf(settings["hand"])
    config = make_config(args.preset, args.seed)

    @cache
    def load_object(name: str) -> ObjectModel:
        return frames.load_object(settings["objects"], name)

    def make_estimator(model: ObjectModel) -> PoseEstimator:
        return PoseEstimator(hand, model, config=config, device=device)

    benchmark = Benchmark(hand, load_object, make_estimator, device)
    return benchmark, ContactSheet(hand, load_object, device)


def _run_with_progress(
    benchmark: "Benchmark",
    files: Sequence[Path],
    ledger: "Ledger",
    console: Console,
) -> bool:
    """Run what is left to do under a progress bar; False when Ctrl-C stopped it."""
    from inhand.datasets.frames import frame_name

    columns = (
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeRemainingColumn(),
        progress.TextColumn("{task.description}"),
    )
    names = map(frame_name, files)
    done = [ledger.results[name] for name in names if name in ledger.results]
    with progress.Progress(*columns, console=console) as bar:
        task = bar.add_task(_running_recall(done), total=len(files), completed=len(done))
        try:
            for result in benchmark.run(files, ledger):
                done.append(result)
                if result.outcome in ("error", "unreadable"):
                    bar.print(f"{result.frame}: {result.reason}", markup=False, highlight=False)
                bar.update(task, advance=1, description=_running_recall(done))
        except KeyboardInterrupt:
            return False
    return True


def _running_recall(results: Sequence["FrameResult"]) -> str:
    from inhand.evaluation.diagnosis import SOLVED

    scored = [r for r in results if r.outcome != "unreadable"]
    if not scored:
        return "warming up"
    solved = sum(r.adi is not None and r.adi < SOLVED for r in scored)
    return f"ADI < 5 mm: {solved / len(scored):.0%}"
