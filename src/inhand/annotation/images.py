"""Images to be labelled: found and named, read when they are looked at.

Three layouts are known by their files:

- BOP's, with or without ground truth: scenes with `scene_camera.json` and `depth/`. What an
  estimator may be told of the wrist is `T_camera_hand_given` in `scene_hand.json`, if it is there.
- A folder of images as `inhand run` takes it (see `streams.folder`): `camera.json`,
  `depth/NAME.png` (or .tif, .exr, .npy), `hand_poses.json` or `hand_pose.json`; with
  `rgb/NAME.png`, where there is one. Wrist poses may be missing. A single image may be called
  `depth.png`, beside `rgb.png`.
- Folders of `.npz` frames (see `datasets.npz`); of their truth, only the object's name is read.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.datasets import bop, bop_images, bop_models, bop_scene
from inhand.datasets.exact import read_json, rigid
from inhand.datasets.frames import find_frames, frame_name, object_name, read_frame
from inhand.errors import InputError
from inhand.io import read_colour, read_depth, read_transform
from inhand.streams.folder import POSE, POSES, SUFFIXES, UNKNOWN, Entry, read_poses
from inhand.streams.folder import find_images as find_depth_images

COLOUR_SUFFIXES = (".png", ".jpg", ".jpeg")


@dataclass(frozen=True, eq=False)
class RawImage:
    """An image as it was recorded."""

    depth: NDArray[np.float32] = field(repr=False)
    """Depth z [m], shape (H, W), 0 where there is no reading."""
    camera: Camera
    """Intrinsics of the depth image."""
    rgb: NDArray[np.uint8] | None = field(default=None, repr=False)
    """Colour image with the same pixels, shape (H, W, 3), if there is one."""
    T_camera_hand: NDArray[np.float64] | None = None
    """The approximate wrist pose, shape (4, 4), if it is known."""


@dataclass(frozen=True)
class ImageFile:
    """An image to be labelled."""

    name: str
    """Unique name, such as `000001/000003` or the name of its depth file."""
    scene_id: int
    """Number of its scene in the data set of labels."""
    image_id: int
    """Its number in that scene."""
    read: Callable[[], RawImage] = field(repr=False)
    """Reads it. Raises InputError when a file is missing, broken or does not fit the others."""
    object_name: str | None = None
    """Name of the object in the hand, if the data set says that."""


def find_images(source: Path) -> list[ImageFile]:
    """The images in a folder, in order.

    Raises:
        InputError: there is no such folder, or nothing in it that can be labelled.
    """
    if not source.is_dir():
        raise InputError(f"there is no folder {source}")
    images: list[ImageFile] = []
    for scene in _find_scenes(source):
        images += _scene_images(scene)
    if not images and (source / "camera.json").is_file():
        images = _folder_images(source)
    if not images and (any(source.glob("*.npz")) or any(source.glob("*/*.npz"))):
        images = _npz_images(source)
    if not images:
        raise InputError(
            f"{source} holds no depth images to label: expected camera.json with depth/NAME.png "
            "(or .tif, .exr, .npy), a BOP data set (scene_camera.json and depth/ in the scenes' "
            "folders), or .npz frames"
        )
    return images


def _find_scenes(source: Path) -> list[Path]:
    found: list[Path] = []
    for pattern in ("", "*/", "*/*/"):
        found = found or sorted(path.parent for path in source.glob(pattern + bop.CAMERA))
    for scene in found:
        if not scene.resolve().name.isdecimal():
            raise InputError(f"the scene {scene} must be called by its number, such as 000001")
    return found


def _scene_images(scene: Path) -> list[ImageFile]:
    scene = scene.resolve()
    cameras = bop_scene.by_image(read_json(scene / bop.CAMERA), scene / bop.CAMERA)
    truth: Mapping[int, Any] = {}
    if (scene / bop.TRUTH).is_file():
        truth = bop_scene.by_image(read_json(scene / bop.TRUTH), scene / bop.TRUTH)
    hands: Mapping[int, Any] = {}
    if (scene / bop.HAND).is_file():
        hands = bop_scene.by_image(read_json(scene / bop.HAND).get("images", {}), scene / bop.HAND)
    files = bop_scene.SceneFiles(scene, cameras, truth, {}, hands, None)
    models = bop_models.find_models(bop_scene.dataset_folder(scene))
    return [
        ImageFile(
            f"{scene.name}/{number:06d}",
            int(scene.name),
            number,
            partial(_read_scene_image, files, number),
            _only_object(truth.get(number, []), models),
        )
        for number in sorted(cameras)
    ]


def _only_object(instances: Any, models: Path | None) -> str | None:
    """Name of the object that a data set with ground truth names, if it is one alone."""
    try:
        numbers = {int(instance["obj_id"]) for instance in instances}
    except (KeyError, TypeError, ValueError):
        return None  # the truth is not what is asked for here
    return bop_models.model_name(models, *numbers) if len(numbers) == 1 else None


def _read_scene_image(files: bop_scene.SceneFiles, number: int) -> RawImage:
    camera = bop_images.read_camera(files, number)
    given = files.hand.get(number, {}).get("T_camera_hand_given")
    wrist = None
    if given is not None:
        try:
            T = np.array(given, dtype=np.float64)
            wrist = rigid(T[:3, :3], T[:3, 3], "T_camera_hand_given")
        except (ValueError, TypeError, IndexError) as error:
            raise InputError(f"image {number} in {files.folder / bop.HAND}: {error}") from error
    return RawImage(
        read_depth(bop_images.depth_path(files.folder, number), camera),
        camera,
        bop_images.read_rgb(files.folder, number, camera),
        wrist,
    )


def _folder_images(folder: Path) -> list[ImageFile]:
    camera = Camera.from_json(folder / "camera.json")
    single = [path for s in SUFFIXES if (path := folder / f"depth{s}").is_file()]
    images = single[:1] or find_depth_images(folder)
    poses = read_poses(folder / POSES) if (folder / POSES).is_file() else {}
    for_all = read_transform(folder / POSE) if (folder / POSE).is_file() else None
    return [
        ImageFile(
            image.stem,
            1,
            number,
            partial(_read_folder_image, image, camera, poses.get(image.stem, UNKNOWN), for_all),
        )
        for number, image in enumerate(images)
    ]


def _read_folder_image(
    depth: Path, camera: Camera, entry: Entry, for_all: NDArray[np.float64] | None
) -> RawImage:
    folder = depth.parent.parent if depth.parent.name == "depth" else depth.parent
    stems = [folder / "rgb" / depth.stem, *([folder / "rgb"] if depth.stem == "depth" else [])]
    colours = [stem.with_name(stem.name + suffix) for stem in stems for suffix in COLOUR_SUFFIXES]
    colour = next((path for path in colours if path.is_file()), None)
    return RawImage(
        read_depth(depth, camera),
        camera,
        None if colour is None else read_colour(colour, camera),
        for_all if entry.T_camera_hand is None else entry.T_camera_hand,
    )


def _npz_images(folder: Path) -> list[ImageFile]:
    return [
        ImageFile(frame_name(path), 1, number, partial(_read_npz_image, path), object_name(path))
        for number, path in enumerate(find_frames([folder]))
    ]


def _read_npz_image(path: Path) -> RawImage:
    frame = read_frame(path)
    return RawImage(frame.depth, frame.camera, frame.rgb, frame.wrist)
