"""`inhand bench`: how good the estimator, and other methods, are on frames with ground truth."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import tyro
from rich import progress
from rich.console import Console

from inhand.cli.common import Preset, load_kernels, waiting
from inhand.whole_file import write_whole

if TYPE_CHECKING:
    from inhand.evaluation.contact_sheet import ContactSheet
    from inhand.evaluation.results import FrameResult, Key, Ledger
    from inhand.evaluation.sweeps import Perturbation
    from inhand.object_model import ObjectModel

INTERRUPTED = 130
"""Exit code after Ctrl-C."""
WORST = 24
"""Frames on the contact sheet."""
OWN_METHODS: dict[Preset, str] = {"default": "inhand", "paper": "paper"}
"""Method by preset."""


class Job(NamedTuple):
    """Something to score."""

    method: str
    """Label of the method."""
    file: Path
    """The frame."""
    perturbation: "Perturbation | None" = None
    """What to make of it first."""


@dataclass(frozen=True)
class Bench:
    """Run the estimator over frames with ground truth and report how good it is.

    Prints recall, errors, times and the stage that loses each frame, or of several methods one line
    each; writes `results.jsonl` (one line a frame and method), `summary.json` and `worst.png` (the
    worst frames of the first method) to the output folder, and the answers on BOP data sets as
    BOP's CSV files to its folder `bop`. Ctrl-C keeps what is done; the same command goes on from
    there, and more methods may be added to it.
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
    methods: str | None = None
    """Methods, separated by commas: inhand, paper, super4pcs, super4pcs+hs, super4pcs+hs+icp,
    fpfh-ransac, fgr, opencv-ppf, kiss-matcher (each also with +hs: without the hand, and +mask:
    given the object's true pixels), icp-from-truth, ablation. Default: inhand."""
    sweep: str | None = None
    """Also run on the frames made harder, step by step: `all`, or names separated by commas:
    wrist-position, wrist-rotation, wrist, noise, missing, wall, table, second-hand, crop,
    object-scale, focal-length, size. Prints a table for each and writes them to `sweeps.md`."""
    preset: Preset = "default"
    """Without --methods: the project's own configuration, or the paper's method."""
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
        InputError: there are no frames, no hand or no objects, a sweep or method is unknown, or
            the output folder holds results made with other settings.
    """
    from inhand.baselines.registry import find_methods
    from inhand.cluster import map_on_ray
    from inhand.datasets.frames import find_frames
    from inhand.errors import InputError
    from inhand.evaluation.benchmark import key_of, missing, pick_frames
    from inhand.evaluation.bop_export import write_bop_results
    from inhand.evaluation.contact_sheet import worst_frames
    from inhand.evaluation.machine import origin
    from inhand.evaluation.printing import print_comparison, print_summary
    from inhand.evaluation.results import Ledger
    from inhand.evaluation.shards import Shard
    from inhand.evaluation.summary import summarise
    from inhand.evaluation.sweeps import find_perturbations
    from inhand.kernels.launch import resolve_device

    console = Console()
    shard = Shard.parse(args.shard)
    methods = find_methods(args.methods or OWN_METHODS[args.preset], args.seed)
    files = pick_frames(find_frames(args.frames), every=args.every, limit=args.limit)
    files = shard.pick(files)
    harder = find_perturbations(args.sweep) if args.sweep else []
    if harder and (handicapped := [m.label for m in methods if m.perturbation]):
        raise InputError(f"{handicapped[0]} is a perturbation already: leave it out of a sweep")
    device = resolve_device(args.device)
    settings = _settings(args, device)
    out = args.out or Path("out") / f"bench-{'-'.join(f.resolve().name for f in args.frames)}"
    path = out / shard.named("results.jsonl")
    ledger = Ledger(path, settings, origin(device), restart=args.restart)

    load_kernels(device, console)
    runs = [(m, perturbation) for m in methods for perturbation in (None, *harder)]
    jobs = [Job(m.label, file, p) for m, p in runs for file in missing(files, m, ledger, p)]
    make_scorer = partial(_scorer, settings)
    if args.ray:
        scored = map_on_ray(make_scorer, jobs)
    else:
        with waiting(console, "Building the model of the hand (from the cache next time)"):
            scored = map(make_scorer(), jobs)
    keys = [key_of(file, m, p) for m, p in runs for file in files]
    finished = _run_with_progress(ledger.record(scored), keys, ledger, console)
    results = {m.label: ledger.found(key_of(file, m) for file in files) for m in methods}
    summaries = {label: summarise(of_method) for label, of_method in results.items()}
    _write_summary(out / shard.named("summary.json"), settings, summaries)
    for label, of_method in results.items():
        write_bop_results(out / shard.named("bop"), label, of_method)
    if len(methods) == 1:
        print_summary(summaries[methods[0].label], console)
    else:
        print_comparison(summaries, console)
    if harder:
        _tell_sweeps(ledger.found(keys), out / shard.named("sweeps.md"), console)
    if worst := worst_frames(results[methods[0].label], WORST):
        _contact_sheet(settings).save(out / shard.named("worst.png"), worst)
    console.print(f"Wrote {path}, and summary and pictures of the worst frames beside it")
    if not finished:
        left = f"Stopped at {len(ledger.found(keys))} of {len(keys)} frames"
        console.print(f"[yellow]{left}; the same command goes on from there[/yellow]")
    return 0 if finished else INTERRUPTED


def _write_summary(
    path: Path, settings: dict[str, Any], summaries: Mapping[str, dict[str, Any]]
) -> None:
    """One method's summary beside the settings, or those of several by their names."""
    content: Mapping[str, Any] = {"methods": summaries}
    if len(summaries) == 1:
        (content,) = summaries.values()
    write_whole(path, json.dumps({"settings": settings, **content}, indent=2) + "\n")


def _tell_sweeps(results: Sequence["FrameResult"], path: Path, console: Console) -> None:
    """Print the sweeps' tables, and write them in Markdown."""
    from inhand.evaluation import tables
    from inhand.evaluation.sweep_tables import sweep_tables

    found = sweep_tables(results)
    for table in found:
        console.print(tables.terminal(table))
    write_whole(path, "\n".join(tables.markdown(table, table.title) for table in found))
    console.print(f"Wrote {path}")


def _settings(args: Bench, device: str) -> dict[str, Any]:
    """What the results depend on."""
    import inhand
    from inhand.datasets.frames import need_hand, need_objects
    from inhand.errors import InputError
    from inhand.evaluation.results import source_key

    hand = args.hand or need_hand(args.frames[0])
    objects = args.objects or need_objects(args.frames[0])
    if not objects.is_dir():
        raise InputError(f"there is no folder of object meshes {objects}")
    return {
        "version": inhand.__version__,
        "source": source_key(),
        "seed": args.seed,
        "device": device,
        "hand": str(hand.resolve()),
        "objects": str(objects.resolve()),
    }


def _scorer(settings: dict[str, Any]) -> Callable[[Job], "FrameResult"]:
    """The scoring of one job after the other, in this process or in one of a cluster.

    Jobs come method by method; of each method only its own models are kept.
    """
    from inhand.baselines.registry import find_methods
    from inhand.evaluation.benchmark import Benchmark
    from inhand.hand import Hand

    hand, load_object = Hand.from_urdf(settings["hand"]), _object_loader(settings)

    @lru_cache(maxsize=1)
    def benchmark(label: str) -> Benchmark:
        (method,) = find_methods(label, settings["seed"])
        return Benchmark(hand, load_object, method, settings["device"], settings["seed"])

    return lambda job: benchmark(job.method).score(job.file, job.perturbation)


def _contact_sheet(settings: dict[str, Any]) -> "ContactSheet":
    from inhand.evaluation.contact_sheet import ContactSheet
    from inhand.hand import Hand

    hand = Hand.from_urdf(settings["hand"])
    return ContactSheet(hand, _object_loader(settings), settings["device"])


def _object_loader(settings: dict[str, Any]) -> Callable[[str], "ObjectModel"]:
    from inhand.datasets import frames

    return cache(lambda name: frames.load_object(settings["objects"], name))


def _run_with_progress(
    scored: Iterator["FrameResult"], keys: Sequence["Key"], ledger: "Ledger", console: Console
) -> bool:
    """Run what is left to do under a progress bar; False when Ctrl-C stopped it."""
    columns = (
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeRemainingColumn(),
        progress.TextColumn("{task.description}"),
    )
    done = ledger.found(keys)
    with progress.Progress(*columns, console=console) as bar:
        task = bar.add_task("warming up", total=len(keys), completed=len(done))
        try:
            for result in scored:
                done.append(result)
                if result.outcome in ("error", "unreadable"):
                    bar.print(f"{result.frame}: {result.reason}", markup=False, highlight=False)
                same = [r for r in done if r.key[1:] == result.key[1:]]
                bar.update(task, advance=1, description=_running_recall(same))
        except KeyboardInterrupt:
            return False
    return True


def _running_recall(results: Sequence["FrameResult"]) -> str:
    """The method's name, what it is handicapped by, and its recall so far."""
    from inhand.evaluation.diagnosis import SOLVED

    scored = [r for r in results if r.outcome != "unreadable"]
    solved = sum(r.adi is not None and r.adi < SOLVED for r in scored)
    share = f"{solved / len(scored):.0%}" if scored else "-"
    handicap = "".join(f", {name} {level:g}" for name, level in results[0].perturbation.items())
    return f"{results[0].method}{handicap}, ADI < 5 mm: {share}"
