"""`inhand bench`: how good the estimator is on frames with ground truth."""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
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
    from inhand.object_model import ObjectModel

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
    shard: str = "1/1"
    """Take only one of several parts of the frames, such as 2/4: for runs on several machines."""
    preset: Preset = "default"
    """Configuration: the project's own, or the paper's method."""
    ray: bool = False
    """Spread the frames over the CPUs of a Ray cluster, which RAY_ADDRESS names; without it, over
    those of this machine. Times are then those of frames that run side by side."""
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
    from inhand.cluster import map_on_ray
    from inhand.datasets.frames import find_frames, frame_name
    from inhand.evaluation.benchmark import missing, pick_frames
    from inhand.evaluation.contact_sheet import worst_frames
    from inhand.evaluation.machine import origin
    from inhand.evaluation.report import print_summary
    from inhand.evaluation.results import Ledger
    from inhand.evaluation.shards import Shard
    from inhand.evaluation.summary import summarise
    from inhand.kernels.launch import resolve_device

    console = Console()
    shard = Shard.parse(args.shard)
    files = pick_frames(find_frames(args.frames), every=args.every, limit=args.limit)
    files = shard.pick(files)
    device = resolve_device(args.device)
    settings = _settings(args, device)
    out = args.out or Path("out") / f"bench-{'-'.join(f.resolve().name for f in args.frames)}"
    path = out / shard.named("results.jsonl")
    ledger = Ledger(path, settings, origin(device), restart=args.restart)

    load_kernels(device, console)
    if args.ray:
        make_scorer = partial(_scorer, settings)
        scored = ledger.record(map_on_ray(make_scorer, missing(files, ledger)))
    else:
        with console.status("Building the model of the hand (from the cache next time)"):
            scored = _benchmark(settings).run(files, ledger)
    finished = _run_with_progress(scored, files, ledger, console)
    results = [ledger.results[name] for name in map(frame_name, files) if name in ledger.results]
    summary = {"settings": settings, **summarise(results)}
    (out / shard.named("summary.json")).write_text(json.dumps(summary, indent=2) + "\n")
    print_summary(summary, console)
    if worst := worst_frames(results, WORST):
        _contact_sheet(settings).save(out / shard.named("worst.png"), worst)
    console.print(f"Wrote {path}, and summary and pictures of the worst frames beside it")
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


def _benchmark(settings: dict[str, Any]) -> "Benchmark":
    from inhand.estimator import PoseEstimator
    from inhand.evaluation.benchmark import Benchmark
    from inhand.hand import Hand
    from inhand.object_model import ObjectModel

    hand, device = Hand.from_urdf(settings["hand"]), settings["device"]
    config = make_config(settings["preset"], settings["seed"])

    def make_estimator(model: ObjectModel) -> PoseEstimator:
        return PoseEstimator(hand, model, config=config, device=device)

    return Benchmark(hand, _object_loader(settings), make_estimator, device)


def _scorer(settings: dict[str, Any]) -> Callable[[Path], "FrameResult"]:
    """The scoring of one frame after the other, in a process of a cluster."""
    return _benchmark(settings).score


def _contact_sheet(settings: dict[str, Any]) -> "ContactSheet":
    from inhand.evaluation.contact_sheet import ContactSheet
    from inhand.hand import Hand

    hand = Hand.from_urdf(settings["hand"])
    return ContactSheet(hand, _object_loader(settings), settings["device"])


def _object_loader(settings: dict[str, Any]) -> Callable[[str], "ObjectModel"]:
    from inhand.datasets import frames

    return cache(lambda name: frames.load_object(settings["objects"], name))


def _run_with_progress(
    scored: Iterator["FrameResult"],
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
            for result in scored:
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
