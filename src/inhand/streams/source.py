"""What a stream of depth images is, wherever it comes from."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.datasets.frame import Frame as LabelledFrame
from inhand.object_model import ObjectModel
from inhand.streams.bag import BagKind


@dataclass(frozen=True, eq=False)
class Frame:
    """One image of a stream: what the estimator needs, or why it cannot be given it."""

    name: str
    """Name of the image in its source: a file's without ending, or a number."""
    time_ns: int
    """When the image was taken [ns]; integer, because that is exact, as in ROS."""
    frame_id: str
    """Name of the camera's coordinate frame."""
    camera: Camera
    """Intrinsics of the image."""
    depth: NDArray[np.float32] | None = field(repr=False)
    """Depth z [m], shape (H, W), 0 where there is no reading; None if it cannot be decoded."""
    T_camera_hand: NDArray[np.float64] | None
    """Approximate wrist pose, shape (4, 4); None if the source has none for this image."""
    problem: str = ""
    """Why `depth` or `T_camera_hand` is None, a sentence for a person."""
    read_truth: Callable[[ObjectModel], LabelledFrame] | None = field(default=None, repr=False)
    """Reads the image again with the ground truth of an object, for who shows it; raises InputError
    where that is not known or broken. None: the source has no ground truth."""


@dataclass(frozen=True)
class Arrival:
    """An image that is there, but not decoded yet: to drop it costs nothing."""

    time_ns: int
    """When it arrived [ns]; a little later than when it was taken."""
    decode: Callable[[], Frame]
    """Decodes the image and looks up its wrist pose; a fault of this image ends up in
    `Frame.problem`."""
    dropped: int = 0
    """Images dropped between the arrival before and this one."""


class Source(Protocol):
    """Where a stream comes from."""

    @property
    def name(self) -> str:
        """What the user knows it as."""
        ...

    @property
    def description(self) -> tuple[str, ...]:
        """What was found in it and chosen from it, lines for a person."""
        ...

    @property
    def count(self) -> int | None:
        """Number of images; None: there is no end to them."""
        ...

    @property
    def kind(self) -> BagKind | None:
        """What a recording is; None for other sources."""
        ...

    def arrivals(self) -> Iterator[Arrival]:
        """The images in the order in which they were taken.

        Raises:
            InputError: the source breaks off; what came before is good.
        """
        ...

    def close(self) -> None:
        """Release files and devices."""
        ...


class NoPose(Exception):
    """There is no pose for a moment; the message is a sentence for a person."""


class Wrist(Protocol):
    """Knows the wrist's approximate pose at any time."""

    def T_camera_hand(self, time_ns: int, camera_frame: str) -> NDArray[np.float64]:
        """Pose of the hand's root link in the camera, shape (4, 4).

        Args:
            time_ns: when the image was taken [ns].
            camera_frame: name of the camera's coordinate frame.

        Raises:
            NoPose: it is not known for that time.
        """
        ...
