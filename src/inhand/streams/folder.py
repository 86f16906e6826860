"""A folder of depth images as a source.

FOLDER/
  camera.json        as `inhand estimate` takes it
  depth/*.png        or the images in FOLDER itself; .png .tif .tiff .exr .npy, in the order
                     of the numbers in their names
  hand_pose.json     {"T_camera_hand": 4x4}: one wrist pose for all images; or
  hand_poses.json    {"NAME": {"T_camera_hand": 4x4, "time": seconds}, ...} by the images' names
                     without ending; an image that is left out has no wrist pose
"""

import re
from collections import Counter
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.errors import InputError
from inhand.geometry.se3 import check_rigid
from inhand.io import read_depth, read_json, read_transform
from inhand.streams.bag import BagKind
from inhand.streams.config import StreamConfig
from inhand.streams.image_times import image_times
from inhand.streams.source import Arrival, Frame

SUFFIXES = (".png", ".tif", ".tiff", ".exr", ".npy")
CAMERA, POSE, POSES = "camera.json", "hand_pose.json", "hand_poses.json"
FRAME_ID = "camera"
"""Name of the camera's coordinate frame, which a folder does not name."""


class Entry(NamedTuple):
    """What is known of an image."""

    T_camera_hand: NDArray[np.float64] | None
    """Wrist pose, shape (4, 4); None if unknown."""
    time: Any
    """[s]; None if unknown."""


UNKNOWN = Entry(None, None)


class Folder:
    """A folder of depth images; see `source.Source`.

    Args:
        path: the folder.
        config: what to take instead of the folder's own.

    Raises:
        InputError: there are no images, no camera or no wrist pose, or a file is broken.
    """

    kind: BagKind | None = None

    def __init__(self, path: Path, config: StreamConfig) -> None:
        self.name = str(path)
        self._images = find_images(path)
        self._camera = config.camera or _read_camera(path / CAMERA)
        self._entries, wrist_from = self._find_poses(path, config)
        told = [self._entries.get(image.stem, UNKNOWN).time for image in self._images]
        self._times = image_times(told, config.frame_rate, str(path / POSES))
        self.count = len(self._images)
        self.description = (
            f"depth: {self.count} images in {self._images[0].parent}",
            f"camera: {'as given' if config.camera else path / CAMERA}",
            f"wrist: {wrist_from}",
        )

    def arrivals(self) -> Iterator[Arrival]:
        """See `source.Source.arrivals`."""
        for image, time_ns in zip(self._images, self._times, strict=True):
            yield Arrival(time_ns, partial(self._frame, image, time_ns))

    def close(self) -> None:
        """See `source.Source.close`."""

    def _frame(self, image: Path, time_ns: int) -> Frame:
        T, depth, problem = self._entries.get(image.stem, UNKNOWN).T_camera_hand, None, ""
        if T is None:
            problem = f'no wrist pose: {POSES} has none for "{image.stem}"'
        try:
            depth = read_depth(image, self._camera)
        except InputError as error:
            problem = str(error)
        return Frame(image.stem, time_ns, FRAME_ID, self._camera, depth, T, problem)

    def _find_poses(self, path: Path, config: StreamConfig) -> tuple[dict[str, Entry], str]:
        if config.T_camera_hand is not None:
            constant = Entry(config.T_camera_hand, None)
            return {image.stem: constant for image in self._images}, "as given, for all images"
        if (path / POSES).exists():
            entries = read_poses(path / POSES)
            if not any(image.stem in entries for image in self._images):
                raise InputError(
                    f"{path / POSES} has no pose of any image; its names are those of the images "
                    f'without ending, such as "{self._images[0].stem}"'
                )
            return entries, str(path / POSES)
        if (path / POSE).exists():
            constant = Entry(read_transform(path / POSE), None)
            return {i.stem: constant for i in self._images}, f"{path / POSE}, for all images"
        raise InputError(
            f"{path} tells no wrist pose: expected {POSES} or {POSE} in it, or --hand-pose FILE"
        )


def _read_camera(path: Path) -> Camera:
    if not path.exists():
        raise InputError(f"there are no intrinsics {path}: write them there, or give --camera FILE")
    return Camera.from_json(path)


def is_folder_of_images(path: Path) -> bool:
    """Whether there are depth images in a folder."""
    return path.is_dir() and bool(_images_in(path / "depth") or _images_in(path))


def find_images(path: Path) -> list[Path]:
    """The depth images of a folder, in the order of the numbers in their names.

    Raises:
        InputError: there are none, or two differ in their ending only.
    """
    images = _images_in(path / "depth") or _images_in(path)
    if not images:
        raise InputError(
            f"{path} holds no depth images: expected {', '.join(SUFFIXES)} in it or in {path}/depth"
        )
    name, count = Counter(image.stem for image in images).most_common(1)[0]
    if count > 1:
        raise InputError(f'{count} images in {images[0].parent} are called "{name}"')
    return images


def read_poses(path: Path) -> dict[str, Entry]:
    """The wrist's pose, and perhaps the time, of images by name.

    Raises:
        InputError: the file is broken.
    """
    return {name: _entry(value, f'"{name}" in {path}') for name, value in read_json(path).items()}


def _entry(value: Any, where: str) -> Entry:
    if not isinstance(value, dict):
        raise InputError(f'{where} must be an object with "T_camera_hand", a 4x4 matrix')
    T = value.get("T_camera_hand")
    if T is not None:
        T = check_rigid(T, f"T_camera_hand of {where}")
    return Entry(T, value.get("time"))


def _images_in(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    images = [file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES]
    return sorted(images, key=lambda image: _by_number(image.stem))


def _by_number(name: str) -> list[tuple[int, str]]:
    """Sorts image_2 before image_10."""
    parts = re.findall(r"\d+|\D+", name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]
