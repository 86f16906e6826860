"""`inhand annotate`: label images by hand, on a web page."""

from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated

import tyro

from inhand.cli.common import load_kernels, waiting

if TYPE_CHECKING:
    from rich.console import Console

    from inhand.annotation.workbench import Workbench


@dataclass(frozen=True)
class Annotate:
    """Label depth images: the poses of hand and object, and the finger angles.

    Opens a web page on this machine; over SSH, forward its port. Every change is saved at once, and
    the same command goes on where it was. The page writes a BOP data set with the hand's file,
    which `inhand bench` reads.
    """

    images: Annotated[Path, tyro.conf.Positional]
    """A folder of images as for `inhand run`, with rgb/NAME.png where there is one; or a BOP data
    set with or without ground truth; or a folder of .npz frames."""
    out: Path
    """Folder of the labels and of the data set that is made of them."""
    hand: Path | None = None
    """URDF of the hand. Default: the one that a data set with ground truth names, or `hand.urdf` in
    the folder of images or above."""
    package_paths: dict[str, Path] = field(default_factory=dict)
    """Folders of ROS packages that the URDF names: NAME FOLDER, repeated."""
    objects: tuple[Path, ...] = ()
    """Meshes of the objects that may be in the hand. Default: the models of the data set, or all
    meshes in the folder `objects` beside the images or above."""
    unit: str = "m"
    """Unit of the meshes: m, cm, mm or inch."""
    write: bool = False
    """Write the data set from the labels that are saved, without a page."""
    port: int = 8080
    """Port of the page."""
    host: str = "127.0.0.1"
    """Address that the page listens on; 0.0.0.0 lets other machines in."""
    seed: int = 0
    """Seed of everything random."""
    device: str | None = None
    """Where the kernels run, such as cpu or cuda:0. Default: the best there is."""


def run(args: Annotate) -> None:
    """Serve the page until Ctrl-C, or write the data set.

    Raises:
        InputError: there are no images, no hand or no objects, the output folder holds something
            else or cannot be written, or the port is taken.
    """
    from rich.console import Console

    from inhand.annotation.ground_truth import LabelledHand
    from inhand.annotation.images import find_images
    from inhand.annotation.objects import find_objects
    from inhand.annotation.storage import check_folder, locked
    from inhand.annotation.workbench import Workbench
    from inhand.cli.common import make_config
    from inhand.datasets.frames import find_hand
    from inhand.errors import InputError
    from inhand.hand import Hand
    from inhand.kernels.launch import resolve_device

    console = Console()
    files = find_images(args.images)
    urdf = args.hand or find_hand(args.images, "hand.urdf")
    if urdf is None:
        raise InputError(f"{args.images} says nothing about the hand: name its URDF with --hand")
    objects = find_objects(args.images, args.objects, args.unit)
    check_folder(args.out)
    device = resolve_device(args.device)
    load_kernels(device, console)
    with waiting(console, "Building the model of the hand (from the cache next time)"):
        hand = LabelledHand(Hand.from_urdf(urdf, args.package_paths), urdf, args.package_paths)
    config = make_config("default", args.seed)
    with locked(args.out):
        bench = Workbench(files, hand, objects, args.out, config, device)
        if bench.remark:
            console.print(f"[yellow]{bench.remark}[/yellow]", highlight=False)
        if args.write:
            with waiting(console, "Writing the data set"):
                number = bench.write()
            console.print(f"Images written to {args.out}: {number}", highlight=False)
        else:
            _serve(args, bench, console)


def _serve(args: Annotate, bench: "Workbench", console: "Console") -> None:
    from inhand.annotation.page import LabellingPage
    from inhand.viewer.server import address, serving

    with serving("inhand annotate", host=args.host, port=args.port) as server:
        page = LabellingPage(server, bench)
        session = bench.session
        console.print(
            f"{session.count('labelled')} of {len(session.images)} images are labelled. "
            f"The page is at {address(server)} (Ctrl-C ends it)",
            highlight=False,
        )
        try:
            Event().wait()
        finally:
            page.stop()
            save_at_last(bench, console)


def save_at_last(bench: "Workbench", console: "Console") -> None:
    """Save what could not be saved; the user may make room first.

    Raises:
        InputError: it still cannot be saved.
    """
    from inhand.errors import InputError

    if bench.save_problem:
        bench.save()
    if bench.save_problem:
        console.print(
            f"NOT SAVED: {bench.save_problem}. Make room, then press Ctrl-C again to save and end",
            highlight=False,
            markup=False,
        )
        with suppress(KeyboardInterrupt):
            Event().wait()
        bench.save()
    if bench.save_problem:
        raise InputError(f"the last changes are lost: {bench.save_problem}")
