"""`inhand estimate`: one depth image in, the object's pose out."""

from dataclasses import dataclass, field
from pathlib import Path

from inhand.cli.common import Preset


@dataclass(frozen=True)
class Estimate:
    """Estimate the pose of the object in the hand from one depth image.

    Exit code: 0 found, 1 not found, 2 bad input.
    """

    depth: Path
    """Depth image: 16-bit PNG or TIFF, float TIFF or EXR [m], or .npy."""
    camera: Path
    """JSON with fx, fy, cx, cy, width, height and depth_unit_m (metres per count)."""
    hand: Path
    """URDF of the hand."""
    object: Path
    """Mesh of the object."""
    hand_pose: Path
    """JSON with the approximate wrist pose T_camera_hand (4 x 4, metres)."""
    out: Path | None = None
    """Write the result here, as JSON."""
    picture: Path | None = None
    """Draw the result into the image and write it here."""
    rgb: Path | None = None
    """Colour image with the same pixels as the depth image, for the picture."""
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


def run(args: Estimate) -> int:
    """Estimate; the exit code says whether the pose was found.

    Raises:
        InputError: an input file is wrong or an output file cannot be written.
    """
    from rich.console import Console

    from inhand.camera import Camera
    from inhand.cli.common import load_kernels, make_config, print_estimate, waiting
    from inhand.estimator import PoseEstimator
    from inhand.hand import Hand
    from inhand.io import read_colour, read_depth, read_transform, write_picture, write_result
    from inhand.kernels.launch import resolve_device
    from inhand.object_model import ObjectModel
    from inhand.picture import draw_estimate

    console = Console()
    progress = Console(stderr=True)
    config = make_config(args.preset, args.seed)
    camera = Camera.from_json(args.camera)
    depth = read_depth(args.depth, camera)
    colour = None if args.rgb is None else read_colour(args.rgb, camera)
    T_camera_hand = read_transform(args.hand_pose)
    device = resolve_device(args.device)
    load_kernels(device, progress)
    with waiting(progress, "Building the models of hand and object (from the cache next time)"):
        hand = Hand.from_urdf(args.hand, package_paths=args.package_paths)
        obj = ObjectModel.from_mesh(args.object, unit=args.unit)
    estimate = PoseEstimator(hand, obj, config=config, device=device).estimate(
        depth, camera, T_camera_hand
    )
    print_estimate(estimate, obj, console)
    if args.out is not None:
        write_result(args.out, estimate)
    if args.picture is not None:
        picture = draw_estimate(estimate, hand, obj, depth, camera, colour=colour, device=device)
        write_picture(args.picture, picture)
    if written := [str(path) for path in (args.out, args.picture) if path is not None]:
        progress.print(f"Wrote {' and '.join(written)}", highlight=False, markup=False)
    return 0 if estimate.found else 1
