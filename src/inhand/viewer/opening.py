"""From paths to what can be looked at."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from inhand.camera import Camera
from inhand.config import EstimatorConfig
from inhand.datasets.bop_frames import is_frame
from inhand.datasets.frame import Frame, Truth
from inhand.datasets.frames import find_frames, need_hand, need_objects, read_frame
from inhand.errors import InputError
from inhand.estimate import PoseEstimate
from inhand.evaluation.results import FrameResult, read_results
from inhand.hand import Hand
from inhand.io import read_colour, read_depth, read_result, read_transform
from inhand.object_model import ObjectModel
from inhand.synth.demo import builtin_hand, demo_scene
from inhand.synth.scene import Scene
from inhand.viewer.frames import DatasetFrames, FrameSource, SingleFrame, ViewedFrame
from inhand.viewer.session import OWN_METHODS

PackagePaths = Mapping[str, Path]


@dataclass(frozen=True, eq=False)
class Opened:
    """What is looked at."""

    source: FrameSource
    """The frames."""
    results: Mapping[str, FrameResult | PoseEstimate] = field(default_factory=dict)
    """What is known of them already, by name."""
    config: EstimatorConfig | None = None
    """How these results were made; None where that is not known."""


@dataclass(frozen=True)
class FrameFiles:
    """The files of one frame, as `inhand estimate` takes them."""

    depth: Path
    camera: Path
    hand_pose: Path
    hand: Path
    object: Path
    rgb: Path | None = None
    result: Path | None = None
    """What `inhand estimate --out` wrote."""
    unit: str = "m"
    """Unit of the object's mesh."""


def open_demo() -> Opened:
    """The built-in scene."""
    scene = demo_scene()
    frame = ViewedFrame.of_dataset(frame_of_scene(scene, "built-in scene"))
    return Opened(SingleFrame(scene.hand, scene.obj, frame))


def frame_of_scene(scene: Scene, name: str) -> Frame:
    """A rendered scene as a frame of a data set, with its ground truth."""
    truth = Truth(
        scene.T_camera_hand,
        scene.T_camera_object,
        scene.joint_positions,
        scene.label,
        scene.visible_share,
    )
    given = scene.T_camera_hand_given
    return Frame(name, scene.obj.name, scene.depth, scene.camera, given, truth)


def open_frame(files: FrameFiles, package_paths: PackagePaths) -> Opened:
    """One frame.

    Raises:
        InputError: a file is missing, broken, or does not fit the others.
    """
    camera = Camera.from_json(files.camera)
    frame = ViewedFrame(
        files.depth.stem,
        read_depth(files.depth, camera),
        camera,
        read_transform(files.hand_pose),
        None if files.rgb is None else read_colour(files.rgb, camera),
    )
    results = {} if files.result is None else {frame.name: read_result(files.result)}
    hand = Hand.from_urdf(files.hand, package_paths)
    obj = ObjectModel.from_mesh(files.object, unit=files.unit)
    return Opened(SingleFrame(hand, obj, frame), results)


def open_datasets(
    paths: Sequence[Path], hand: Path | None, objects: Path | None, package_paths: PackagePaths
) -> Opened:
    """Data sets of any kind that `datasets` reads.

    Args:
        paths: their folders, or single frames.
        hand: URDF of the hand; None: as by `datasets.frames.need_hand`.
        objects: folder of the objects' models; None: as by `datasets.frames.need_objects`.
        package_paths: folders of the ROS packages that the URDF names.

    Raises:
        InputError: a path is missing, or no data set; or there is no hand or no object.
    """
    for path in paths:
        if path.is_file() and path.suffix != ".npz" and not is_frame(path):
            raise InputError(
                f"{path} is no data set of a known kind: expected a folder of .npz frames or a BOP "
                "data set, a single .npz frame, or the results.jsonl of `inhand bench`; a depth "
                "image goes with --depth"
            )
    files = find_frames(paths)
    meshes = objects or need_objects(paths[0])
    if hand is None and _is_without_hand(files[0]):
        return Opened(
            DatasetFrames(files, builtin_hand(), meshes)
        )  # any hand will do: none is seen
    model = Hand.from_urdf(hand or need_hand(paths[0]), package_paths)
    return Opened(DatasetFrames(files, model, meshes))


def _is_without_hand(file: Path) -> bool:
    """Whether a frame's data set says nothing about a hand."""
    try:
        return read_frame(file).wrist is None
    except InputError:  # this one is broken: what it says is told when it is looked at
        return False


def open_results(path: Path, package_paths: PackagePaths) -> Opened:
    """The frames of a benchmark with their results, of its first method, as they were.

    Raises:
        InputError: it is no results file, holds no frames as they were, or names files that are
            not there.
    """
    record = read_results(path)
    plain = [r for r in record.results if not r.perturbation]
    if not plain:
        raise InputError(f"{path} holds no results of frames as they were, without a perturbation")
    of_first = {r.frame: r for r in plain if r.method == plain[0].method}
    files = [Path(r.file) for r in of_first.values()]
    if not files[0].exists():
        raise InputError(
            f"{path} speaks of the frame {files[0]}, which is not there: start the viewer in the "
            "folder where `inhand bench` was started"
        )
    try:
        settings = record.settings
        hand = Hand.from_urdf(settings["hand"], package_paths)
        source = DatasetFrames(files, hand, Path(settings["objects"]))
        seed = int(settings["seed"])
    except KeyError as error:
        raise InputError(f"{path} does not say with which {error} it was made") from error
    paper = OWN_METHODS.get(plain[0].method) == "paper"
    config = EstimatorConfig.paper(seed) if paper else replace(EstimatorConfig(), seed=seed)
    return Opened(source, of_first, config)
