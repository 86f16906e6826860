"""`inhand demo`: the whole pipeline on a built-in scene."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from inhand.estimate import PoseEstimate
    from inhand.synth.scene import Scene


@dataclass(frozen=True)
class Demo:
    """Render the built-in hand holding an object, estimate both, and draw the result."""

    out: Path = Path("demo.png")
    """The picture to write."""
    device: str | None = None
    """Where the kernels run, such as cpu or cuda:0. Default: the best there is."""


def run(args: Demo) -> int:
    """Run the demo; the exit code says whether the pose was found.

    Raises:
        InputError: the picture cannot be written.
    """
    from rich.console import Console

    from inhand.cli.common import load_kernels, print_estimate, waiting
    from inhand.estimator import PoseEstimator
    from inhand.io import write_picture
    from inhand.kernels.launch import resolve_device
    from inhand.picture import draw_estimate
    from inhand.synth.demo import demo_scene

    console = Console()
    device = resolve_device(args.device)
    load_kernels(device, console)
    with waiting(console, "Making the scene"):
        scene = demo_scene(device)
    estimator = PoseEstimator(scene.hand, scene.obj, device=device)
    estimate = estimator.estimate(scene.depth, scene.camera, scene.T_camera_hand_given)
    print_estimate(estimate, scene.obj, console)
    if estimate.found:
        _print_errors(estimate, scene, console)
    picture = draw_estimate(
        estimate, scene.hand, scene.obj, scene.depth, scene.camera, device=device
    )
    write_picture(args.out, picture)
    console.print(f"The picture is {args.out}", highlight=False)
    return 0 if estimate.found else 1


def _print_errors(estimate: "PoseEstimate", scene: "Scene", console: "Console") -> None:
    """Print how far the estimate is from the truth of the scene."""
    from math import degrees

    from inhand.evaluation.hand_errors import angle_errors, wrist_error
    from inhand.evaluation.metrics import ObjectMetric

    assert estimate.T_camera_object is not None
    assert estimate.T_camera_hand is not None
    adi = ObjectMetric(scene.obj).adi(estimate.T_camera_object, scene.T_camera_object)
    wrist = wrist_error(estimate.T_camera_hand, scene.T_camera_hand)
    joints = angle_errors(estimate.joint_positions, scene.joint_positions)
    console.print(
        f"Against the truth: object {1000 * adi:.2f} mm (ADI, the mean distance of its surface "
        f"points), wrist {1000 * wrist.translation:.2f} mm and {degrees(wrist.rotation):.2f} deg, "
        f"joints {degrees(max(joints.values())):.1f} deg at most",
        highlight=False,
    )
