"""`inhand run`: a folder, a recording or a camera in, an estimate of every image out."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from inhand.cli.common import Preset, waiting

if TYPE_CHECKING:
    from rich.console import Console

    from inhand.hand import Hand
    from inhand.object_model import ObjectModel
    from inhand.streams.config import StreamConfig
    from inhand.streams.runner import Counts, Estimate, Output, Result, Summary
    from inhand.streams.source import Source


@dataclass(frozen=True)
class Run:
    """Estimate the images of a folder, a ROS recording or a camera, one after the other.

    Writes one JSON object a line and image, and a summary as the last line. Exit code: 0 done,
    1 done but nothing was found, 2 bad input or the source broke off, 130 Ctrl-C; whatever was
    estimated is written.
    """

    source: Annotated[str, tyro.conf.Positional]
    """A folder of depth images, a scene of a BOP data set, a ROS 1 bag, a ROS 2 bag's folder, a
    .db3 or .mcap file, `realsense`, or `realsense:SERIAL`."""
    hand: Path
    """URDF of the hand."""
    object: Path
    """Mesh of the object."""
    out: Path | None = None
    """File of JSON lines to write. Default: out/run-NAME.jsonl, after the source."""
    bag: Path | None = None
    """Also write a ROS recording of the results: a folder for ROS 2, a .bag file for ROS 1."""
    bag_kind: Literal["ros1", "sqlite3", "mcap"] | None = None
    """Kind of that recording. Default: that of the source; mcap if it is none."""
    track: bool = False
    """Follow hand and object from image to image, which is faster and steadier; without it, every
    image is answered anew."""
    view: bool = False
    """Also show the images and results on a web page, as they come; it stays until Ctrl-C."""
    port: int | None = None
    """Port of that page. Default: 8080."""
    host: str | None = None
    """Address that the page's server listens on; 0.0.0.0 lets other machines in. Default:
    127.0.0.1."""
    rate: float | None = None
    """Play a recording back in real time (1.0), or slower or faster, and drop what comes while an
    image is being processed. Default: every image, as fast as it goes."""
    limit: int | None = None
    """Stop after this many images."""
    camera: Path | None = None
    """JSON with the intrinsics and depth_unit_m, instead of what the source says."""
    hand_pose: Path | None = None
    """JSON with a constant wrist pose T_camera_hand, instead of what the source says."""
    depth_topic: str | None = None
    """Recording: topic of the depth images. Default: the only one."""
    camera_topic: str | None = None
    """Recording: topic of the camera info. Default: the one beside the depth images."""
    pose_topic: str | None = None
    """Recording: take the wrist's pose from this topic (PoseStamped) instead of from tf."""
    hand_frame: str | None = None
    """Recording: the hand's frame in tf. Default: the URDF's root link."""
    hand_mount: Path | None = None
    """Recording: JSON with T_frame_hand, the pose of the URDF's root link in the frame that tf or
    the pose topic tells of, where they differ."""
    longest_gap: float = 0.5
    """Recording: interpolate the wrist's pose over at most this long [s]."""
    frame_rate: float = 30.0
    """Images a second: of a folder without times, and what a camera is asked for."""
    size: tuple[int, int] = (640, 480)
    """Width and height that a camera is asked for."""
    unit: str = "m"
    """Unit of the object's mesh: m, cm, mm or inch."""
    package_paths: dict[str, Path] = field(default_factory=dict)
    """Folders of ROS packages that the URDF names: NAME FOLDER, repeated."""
    preset: Preset = "default"
    """Configuration: the project's own, or the paper's method."""
    seed: int = 0
    """Seed of everything random."""
    device: str | None = None
    """Where the kernels run, such as cpu or cuda:0. Default: the best there is."""


def run(args: Run) -> int:
    """Run; the exit code says whether anything was found.

    Raises:
        InputError: the source cannot be read or breaks off, or an output cannot be written.
    """
    from rich.console import Console

    from inhand.kernels.launch import resolve_device
    from inhand.streams.open_source import open_source

    _check_options(args)
    console = Console(stderr=True)
    device = resolve_device(args.device)
    with waiting(console, f"Opening {args.source}"):
        source = open_source(args.source, _stream_config(args))
    try:
        for line in source.description:
            console.print(line, highlight=False, markup=False)
        summary = _run(args, source, device, console)
    finally:
        source.close()
    return 0 if summary.counts.found else 1


def _check_options(args: Run) -> None:
    """Raise InputError for an option that would do nothing."""
    from inhand.errors import InputError

    if args.port is not None and not args.view:
        raise InputError("--port is the port of the page: give --view too, or leave it out")
    if args.host is not None and not args.view:
        raise InputError("--host is the address of the page: give --view too, or leave it out")
    if args.bag_kind is not None and args.bag is None:
        raise InputError("--bag-kind is the kind of a recording: give --bag PATH too")


def _run(args: Run, source: "Source", device: str, console: "Console") -> "Summary":
    from inhand.cli.common import load_kernels
    from inhand.hand import Hand
    from inhand.object_model import ObjectModel
    from inhand.streams import runner

    runner.check_pace(source, args.rate, args.limit)
    paths = _output_paths(args, source)
    load_kernels(device, console)
    with waiting(console, "Building the models of hand and object (from the cache next time)"):
        hand = Hand.from_urdf(args.hand, package_paths=args.package_paths)
        obj = ObjectModel.from_mesh(args.object, unit=args.unit)
    estimate = _make_estimate(args, hand, obj, device)
    with _page(args, hand, obj, estimate, device, console) as page:
        outputs = [*_open_outputs(args, source, paths, obj), *page, _FirstProblems(console)]
        try:
            with _progress(source, console) as report:
                return runner.run(
                    source, estimate, outputs, rate=args.rate, limit=args.limit, report=report
                )
        finally:
            console.print(f"Results: {', '.join(map(str, paths))}", highlight=False, markup=False)


@dataclass(frozen=True)
class _FirstProblems:
    """Says which image was the first that could not be estimated, however the run ends."""

    console: "Console"

    def write(self, result: "Result") -> None:
        pass

    def finish(self, summary: "Summary") -> None:
        lines = []
        if summary.first_problem:
            lines.append(f"The first that could not be estimated: {summary.first_problem}")
        if summary.first_not_found and not summary.counts.found:
            lines.append(f"The first without an answer: {summary.first_not_found}")
        for line in lines:
            self.console.print(line, highlight=False, markup=False)


def _make_estimate(args: Run, hand: "Hand", obj: "ObjectModel", device: str) -> "Estimate":
    from inhand.cli.common import make_config
    from inhand.estimator import PoseEstimator
    from inhand.streams.following import Following
    from inhand.tracking.config import TrackerConfig
    from inhand.tracking.tracker import PoseTracker

    config = make_config(args.preset, args.seed)
    if args.track:
        return Following(PoseTracker(hand, obj, TrackerConfig(estimator=config), device))
    estimator = PoseEstimator(hand, obj, config, device)
    if args.view:
        from inhand.viewer.stream_output import StagesKept

        return StagesKept(estimator)
    return lambda f: estimator.estimate(f.depth, f.camera, f.T_camera_hand)


def _stream_config(args: Run) -> "StreamConfig":
    from inhand.camera import Camera
    from inhand.io import read_transform
    from inhand.streams.config import StreamConfig
    from inhand.urdf import read_urdf

    mount = args.hand_mount
    return StreamConfig(
        camera=None if args.camera is None else Camera.from_json(args.camera),
        T_camera_hand=None if args.hand_pose is None else read_transform(args.hand_pose),
        depth_topic=args.depth_topic,
        camera_topic=args.camera_topic,
        pose_topic=args.pose_topic,
        hand_frame=args.hand_frame,
        root_link=read_urdf(args.hand, args.package_paths).root,
        T_frame_hand=None if mount is None else read_transform(mount, "T_frame_hand"),
        longest_gap=args.longest_gap,
        frame_rate=args.frame_rate,
        size=args.size,
    )


def _output_paths(args: Run, source: "Source") -> list[Path]:
    """Where the JSON lines go, and the recording; checked before any work is done for them."""
    from inhand.streams.bag import need_rosbags
    from inhand.streams.new_file import check_new

    name = Path(args.source).resolve().stem if source.count is not None else source.name
    paths = [args.out or Path("out") / f"run-{name.replace(':', '-')}.jsonl"]
    if args.bag is not None:
        need_rosbags()
        paths.append(args.bag)
    for path in paths:
        check_new(path)
    return paths


def _open_outputs(
    args: Run, source: "Source", paths: list[Path], obj: "ObjectModel"
) -> list["Output"]:
    from inhand.streams.json_lines import JsonLines

    lines, *bag = paths
    if not bag:
        return [JsonLines(lines)]
    from inhand.streams.results_bag import ResultsBag

    # The JSON lines come first: when the bag cannot be written any more, they have it all.
    results_bag = ResultsBag(bag[0], args.bag_kind or source.kind or "mcap", obj)
    return [JsonLines(lines), results_bag]


@contextmanager
def _page(
    args: Run,
    hand: "Hand",
    obj: "ObjectModel",
    estimate: "Estimate",
    device: str,
    console: "Console",
) -> Iterator[list["Output"]]:
    """The page, if it is asked for: it stays when the run has ended, until Ctrl-C."""
    if not args.view:
        yield []
        return
    from inhand.cli.common import make_config
    from inhand.errors import InputError
    from inhand.viewer.server import HOST, PORT
    from inhand.viewer.stream_output import PageOutput, StagesKept

    kept = estimate if isinstance(estimate, StagesKept) else None
    host = HOST if args.host is None else args.host
    port = PORT if args.port is None else args.port
    config = make_config(args.preset, args.seed)
    page = PageOutput(hand, obj, host, port, config, device, kept)
    console.print(f"Page: {page.address}", highlight=False, markup=False)
    try:
        yield [page]
        _wait_for_ctrl_c(page.address, console)
    except InputError as error:
        if page.ended:  # the run went wrong, and did not only fail to start
            console.print(f"The run broke off: {error}", highlight=False, markup=False)
            page.tell(str(error))
            _wait_for_ctrl_c(page.address, console)
        raise
    finally:
        page.close()


def _wait_for_ctrl_c(address: str, console: "Console") -> None:
    message = f"The run has ended. Its page stays at {address} until Ctrl-C"
    console.print(message, highlight=False, markup=False)
    with suppress(KeyboardInterrupt):
        Event().wait()


@contextmanager
def _progress(source: "Source", console: "Console") -> Iterator[Callable[["Counts"], None]]:
    """A progress line, to be told the counts; they stand there at the end too."""
    from rich import progress

    columns = (
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeElapsedColumn(),
        progress.TextColumn("{task.description}"),
    )
    with progress.Progress(*columns, console=console) as bar:
        task = bar.add_task("starting", total=source.count)

        def report(counts: "Counts") -> None:
            done = counts.processed + counts.dropped
            bar.update(task, completed=done, description=counts.in_words())

        yield report
