"""`inhand view`: frames, estimates and what led to them, on a web page."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from inhand.cli.common import Preset, load_kernels, make_config, waiting

if TYPE_CHECKING:
    from inhand.viewer.opening import Opened

ONE_FRAME = ("depth", "camera", "hand_pose", "hand", "object")
"""Options that one frame needs."""


@dataclass(frozen=True)
class View:
    """Show frames, estimates and what led to them on a web page.

    Takes data sets, or the results.jsonl of `inhand bench`, or one frame by the options of `inhand
    estimate`; without any of them, shows the built-in scene. Nothing but a browser is needed to see
    it: over SSH, forward the port (`ssh -L 8080:localhost:8080 HOST`). Ctrl-C ends it.
    """

    frames: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """BOP data sets such as `inhand synth` makes, folders of .npz frames, or single .npz frames; or
    one results.jsonl."""
    depth: Path | None = None
    """Of one frame: depth image, as for `inhand estimate`."""
    camera: Path | None = None
    """Of one frame: JSON with fx, fy, cx, cy, width, height and depth_unit_m."""
    hand_pose: Path | None = None
    """Of one frame: JSON with the approximate wrist pose T_camera_hand (4 x 4, metres)."""
    object: Path | None = None
    """Of one frame: mesh of the object."""
    rgb: Path | None = None
    """Of one frame: colour image with the same pixels as the depth image."""
    result: Path | None = None
    """Of one frame: show what `inhand estimate --out` wrote instead of estimating."""
    unit: str = "m"
    """Unit of the object's mesh: m, cm, mm or inch."""
    hand: Path | None = None
    """URDF of the hand. Default with data sets: as for `inhand bench`."""
    package_paths: dict[str, Path] = field(default_factory=dict)
    """Folders of ROS packages that the URDF names: NAME FOLDER, repeated."""
    objects: Path | None = None
    """Folder of the object meshes. Default: as for `inhand bench`."""
    port: int = 8080
    """Port of the page."""
    host: str = "127.0.0.1"
    """Address that the page's server listens on; 0.0.0.0 lets other machines in."""
    preset: Preset = "default"
    """Configuration: the project's own, or the paper's method."""
    seed: int = 0
    """Seed of everything random."""
    device: str | None = None
    """Where the kernels run, such as cpu or cuda:0. Default: the best there is."""


def run(args: View) -> int:
    """Serve the page until Ctrl-C.

    Raises:
        InputError: there is nothing to show, a file is wrong, or the port is taken.
    """
    from threading import Event

    from rich.console import Console

    from inhand.kernels.launch import resolve_device
    from inhand.viewer.analysis import Analyst
    from inhand.viewer.browsing import Browsing
    from inhand.viewer.page import Page
    from inhand.viewer.server import address, serving
    from inhand.viewer.session import Session

    console = Console()
    device = resolve_device(args.device)
    with serving("inhand", host=args.host, port=args.port) as server:
        load_kernels(device, console)
        with waiting(console, "Building the models of hand and objects (from the cache next time)"):
            opened = _open(args)
        config = opened.config or make_config(args.preset, args.seed)
        analyst = Analyst(opened.source.hand, config, device)
        page = Page(server, opened.source.hand)
        Browsing(page, Session(opened.source, analyst, opened.results)).start()
        console.print(f"Open {address(server)} in a browser; Ctrl-C ends it", highlight=False)
        try:
            Event().wait()
        except KeyboardInterrupt:
            console.print("Stopped")
        finally:
            page.stop()
    return 0


def _open(args: View) -> "Opened":
    """What the arguments name."""
    from inhand.errors import InputError
    from inhand.viewer.opening import (
        FrameFiles,
        open_datasets,
        open_demo,
        open_frame,
        open_results,
    )

    single = {name: getattr(args, name) for name in (*ONE_FRAME, "rgb", "result")}
    given = [name for name, path in single.items() if path is not None]
    if args.frames:
        if of_frame := [name for name in given if name != "hand"]:
            both = f"{args.frames[0]} and {_flags(of_frame)}"
            raise InputError(f"give data sets or one frame, not both: {both}")
        if args.frames[0].suffix == ".jsonl":
            return open_results(args.frames[0], args.package_paths)
        return open_datasets(args.frames, args.hand, args.objects, args.package_paths)
    if not given:
        return open_demo()
    missing = [name for name in ONE_FRAME if single[name] is None]
    if missing:
        raise InputError(f"one frame needs {_flags(ONE_FRAME)}; missing: {_flags(missing)}")
    return open_frame(FrameFiles(**single, unit=args.unit), args.package_paths)


def _flags(names: Sequence[str]) -> str:
    return ", ".join("--" + name.replace("_", "-") for name in names)
