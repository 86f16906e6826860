"""A scene of a BOP data set as a source, such as the sequences of `inhand synth --sequence`."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from inhand.camera import Camera
from inhand.datasets.bop import CAMERA, HAND
from inhand.datasets.bop_frames import frame_of_object, read_frame
from inhand.datasets.bop_images import read_camera, read_sensed, read_time
from inhand.datasets.bop_scene import SceneFiles, find_scenes, is_scene, read_scene
from inhand.datasets.frame import Frame as LabelledFrame
from inhand.errors import InputError
from inhand.object_model import ObjectModel
from inhand.streams.bag import BagKind
from inhand.streams.config import StreamConfig
from inhand.streams.given_camera import check_fits
from inhand.streams.image_times import image_times
from inhand.streams.source import Arrival, Frame

FRAME_ID = "camera"
"""Name of the camera's coordinate frame, which a data set does not name."""


class BopScene:
    """The images of one scene, in order; see `source.Source`.

    Args:
        path: the scene's folder.
        config: what to take instead of the scene's own.

    Raises:
        InputError: `path` is a data set of several scenes, a JSON file is broken, there is no
            image that can be read, or no hand; or the images are not of the camera in `config`.
    """

    kind: BagKind | None = None

    def __init__(self, path: Path, config: StreamConfig) -> None:
        if not is_scene(path):
            scenes = ", ".join(map(str, find_scenes(path)[:10]))
            raise InputError(f"{path} is a BOP data set: name one of its scenes: {scenes}")
        self.name, self._config = str(path), config
        self._files = files = read_scene(path)
        if files.hand_info is None and config.T_camera_hand is None:
            raise InputError(f"{path} tells no wrist pose: it has no {HAND}; give --hand-pose FILE")
        self._images = sorted(files.truth)
        own = _any_camera(files, self._images)
        self._camera = (
            own if config.camera is None else check_fits(config.camera, own, path / CAMERA)
        )
        told = [read_time(files, image) for image in self._images]
        self._times = image_times(told, config.frame_rate, str(path / CAMERA))
        self.count = len(self._images)
        wrist = path / HAND if config.T_camera_hand is None else "as given, for all images"
        self.description = (
            f"depth: {self.count} images of the scene {path}",
            f"camera: {path / CAMERA if config.camera is None else 'as given'}",
            f"wrist: {wrist}",
        )

    def arrivals(self) -> Iterator[Arrival]:
        """See `source.Source.arrivals`."""
        for image, time_ns in zip(self._images, self._times, strict=True):
            yield Arrival(time_ns, partial(self._frame, image, time_ns))

    def close(self) -> None:
        """See `source.Source.close`."""

    def _frame(self, number: int, time_ns: int) -> Frame:
        T = self._config.T_camera_hand
        try:
            image = read_sensed(self._files, number)
            if self._config.camera is not None:
                check_fits(self._config.camera, image.camera, self._files.folder / CAMERA)
        except InputError as error:
            return Frame(str(number), time_ns, FRAME_ID, self._camera, None, T, str(error))
        T = image.T_camera_hand if T is None else T
        camera = self._config.camera or image.camera
        frame = Frame(str(number), time_ns, FRAME_ID, camera, image.depth, T)
        return replace(frame, read_truth=partial(self._labelled, number, frame))

    def _labelled(self, number: int, given: Frame, obj: ObjectModel) -> LabelledFrame:
        """The image with the truth of an object; camera and wrist as they were given."""
        path = frame_of_object(self._files, number, obj.mesh)
        return replace(read_frame(path, given.name), camera=given.camera, wrist=given.T_camera_hand)


def _any_camera(files: SceneFiles, images: Sequence[int]) -> Camera:
    """The camera of the first image that can be read: a broken one will be reported in its turn."""
    problem: InputError | None = None
    for image in images:
        try:
            return read_camera(files, image)
        except InputError as error:
            problem = problem or error
    raise problem or InputError(f"{files.folder} has no images")


def has_scenes(path: Path) -> bool:
    """Whether a folder is a scene or a data set with scenes."""
    return path.is_dir() and bool(find_scenes(path))
