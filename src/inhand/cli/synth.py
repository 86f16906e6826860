"""`inhand synth`: a data set of rendered images with ground truth."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from inhand.cli.common import load_kernels, waiting

if TYPE_CHECKING:
    from rich.console import Console

    from inhand.synth.plan import Plan

INTERRUPTED = 130
"""Exit code after Ctrl-C."""


@dataclass(frozen=True)
class Synth:
    """Render a data set of hands that hold objects, with ground truth, in BOP's layout.

    By default the paper's: the built-in hand in blue and in white, six built-in objects, 1000
    images of each pair, seen from 648 viewpoints at 0.3 to 0.9 m. A run that was stopped goes on
    with the same command.
    With --sequence, every scene is one sequence of images with time stamps.
    """

    out: Annotated[Path, tyro.conf.Positional]
    """Folder of the data set."""
    hand: Path | None = None
    """URDF of the hand. Default: the built-in one."""
    package_paths: dict[str, Path] = field(default_factory=dict)
    """Folders of ROS packages that the URDF names: NAME FOLDER, repeated."""
    objects: tuple[str, ...] = ()
    """Mesh files or names of built-in objects. Default: all six built-in ones."""
    unit: str = "m"
    """Unit of the mesh files: m, cm, mm or inch."""
    colours: tuple[Literal["blue", "white"], ...] = ("blue", "white")
    """Colours of the hand."""
    number: int = 1000
    """Images of every object and colour."""
    sequence: bool = False
    """Make every scene one sequence of that many images: hand and object move, occluders pass."""
    rate: float = 30.0
    """Images a second of a sequence."""
    rest: float = 0.35
    """Share of the legs of a sequence's motion that are a rest; with 1 nothing moves but what
    passes in front."""
    seed: int = 0
    """Seed of everything random."""
    camera: Path | None = None
    """JSON with fx, fy, cx, cy, width, height. Default: 640 x 480, fx = fy = 615."""
    distance: tuple[float, float] = (0.3, 0.9)
    """Radius of the smallest and the largest of 4 spheres of viewpoints [m]."""
    visible: tuple[float, ...] = (0.05, 1.0)
    """Rising edges of ranges of the object's visible share; images take the ranges in turn."""
    sensor: Literal["none", "structured_light", "active_stereo"] = "none"
    """Errors of the depth camera."""
    clutter: int = 0
    """Solids that stand behind the hand."""
    backdrop: tuple[float, float] | None = None
    """Range of the distance of a wall behind the hand's reach [m]. Default: no wall."""
    wrist_translation: float = 0.0005
    """Sd of the error of the given wrist pose along each axis [m]."""
    wrist_rotation: float = 0.0025
    """Sd of the error of the given wrist pose about each axis [rad]."""
    device: str | None = None
    """Where the kernels run, such as cpu or cuda:0. Default: the best there is."""
    workers: int | None = None
    """Processes. Default: one for every CPU core."""
    ray: bool = False
    """Spread the work over the Ray cluster that RAY_ADDRESS names, or over this machine."""


def run(args: Synth) -> int:
    """Make the data set, or what of it is missing; the exit code says whether Ctrl-C stopped it.

    Raises:
        InputError: an option makes no sense, a file cannot be read or written, or the folder holds
            something else.
    """
    from rich.console import Console

    from inhand.kernels.launch import resolve_device
    from inhand.synth.dataset import finish, missing_images, start

    console = Console()
    plan = _plan(args)
    device = resolve_device(args.device)
    load_kernels(device, console)
    with waiting(console, "Building the models of hand and objects (from the cache next time)"):
        start(args.out, plan)
    jobs = missing_images(args.out, plan)
    total = len(plan.scene_ids()) * plan.number
    try:
        _work(args, plan, jobs, device, total, console)
    except KeyboardInterrupt:
        left = len(missing_images(args.out, plan))
        text = f"Stopped with {total - left} of {total} images; the same command goes on from there"
        console.print(f"[yellow]{text}[/yellow]")
        return INTERRUPTED
    with waiting(console, "Writing the scenes' ground truth"):
        finish(args.out, plan)
    console.print(f"{total} images are in {args.out}", highlight=False)
    return 0


def _plan(args: Synth) -> "Plan":
    from inhand.camera import Camera
    from inhand.synth.motion import MotionProtocol
    from inhand.synth.plan import Plan
    from inhand.synth.scene import SceneProtocol
    from inhand.synth.sensor import SENSORS

    default = Plan()
    return Plan(
        hand=args.hand,
        package_paths=args.package_paths,
        objects=args.objects or default.objects,
        unit=args.unit,
        colours=args.colours,
        number=args.number,
        seed=args.seed,
        camera=default.camera if args.camera is None else Camera.from_json(args.camera),
        protocol=SceneProtocol(
            distance=args.distance,
            sensor=SENSORS[args.sensor],
            wrist_translation=args.wrist_translation,
            wrist_rotation=args.wrist_rotation,
            backdrop=args.backdrop,
            clutter=args.clutter,
        ),
        visible=args.visible,
        motion=MotionProtocol(rate=args.rate, rest=args.rest) if args.sequence else None,
    )


def _work(
    args: Synth,
    plan: "Plan",
    jobs: list[tuple[int, int]],
    device: str,
    total: int,
    console: "Console",
) -> None:
    """Make the missing images under a progress bar."""
    from rich import progress

    columns = (
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeRemainingColumn(),
        progress.TextColumn("{task.description}"),
    )
    made = _maker(args, plan, jobs, device)
    with progress.Progress(*columns, console=console) as bar:
        task = bar.add_task("starting", total=total, completed=total - len(jobs))
        started, done = time.monotonic(), 0
        for count in made:
            done += count
            rate = f"{done / (time.monotonic() - started):.1f} a second"
            bar.update(task, advance=count, description=rate)


def _maker(args: Synth, plan: "Plan", jobs: list[tuple[int, int]], device: str) -> Iterator[int]:
    from inhand.errors import InputError
    from inhand.kernels.launch import cpu_count
    from inhand.synth.workers import make_here, make_in_processes, make_on_ray

    workers = cpu_count() if args.workers is None else args.workers
    if workers < 1:
        raise InputError(f"workers must be at least 1, got {workers}")
    if args.ray:
        return make_on_ray(args.out, plan, jobs, device)
    if min(workers, len(jobs)) <= 1:
        return make_here(args.out, plan, jobs, device)
    return make_in_processes(args.out, plan, jobs, device, workers)
