"""What can be looked at: frames with the hand and the object in them, from wherever they come."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.datasets import frames as datasets
from inhand.datasets.frame import Frame
from inhand.errors import InputError
from inhand.hand import Hand
from inhand.object_model import ObjectModel
from inhand.overlay import Pixels, Placement


@dataclass(frozen=True, eq=False)
class ViewedFrame:
    """One depth image, with what is known about it."""

    name: str
    """What the page calls it."""
    depth: NDArray[np.float32]
    """Depth z [m], shape (H, W), 0 where there is no reading."""
    camera: Camera
    """Intrinsics of the depth image."""
    T_camera_hand: NDArray[np.float64] | None
    """Approximate wrist pose, shape (4, 4), as the estimator is given it; None if unknown."""
    colour: Pixels | None = None
    """Colour image with the same pixels, shape (H, W, 3), if there is one."""
    labelled: Frame | None = None
    """The frame with its ground truth, if there is any."""
    remark: str = ""
    """What else is to be said about it, a sentence for a person."""

    @classmethod
    def of_dataset(cls, frame: Frame) -> "ViewedFrame":
        """A frame of a data set."""
        return cls(frame.name, frame.depth, frame.camera, frame.wrist, frame.rgb, frame)

    def truth(self, hand: Hand) -> Placement | None:
        """Where hand and object truly are; None if unknown."""
        if self.labelled is None:
            return None
        truth = self.labelled.truth
        if truth.wrist is None or not truth.joint_positions:
            return Placement(T_camera_object=truth.T_camera_object)
        q = hand.joint_vector(truth.joint_positions)
        return Placement(truth.wrist, q, truth.T_camera_object)


class FrameSource(Protocol):
    """Frames of one hand, in order."""

    @property
    def hand(self) -> Hand:
        """The hand in all frames."""

    @property
    def names(self) -> Sequence[str]:
        """What the frames are called."""

    @property
    def object_names(self) -> Sequence[str]:
        """Which object is in each; empty where that cannot be read."""

    def read(self, index: int) -> tuple[ViewedFrame, ObjectModel]:
        """One frame and the object in it.

        Raises:
            InputError: a file is missing or broken.
        """


@dataclass(frozen=True, eq=False)
class SingleFrame:
    """One frame alone, as a source."""

    hand: Hand
    obj: ObjectModel
    frame: ViewedFrame

    @property
    def names(self) -> Sequence[str]:
        """The frame's name."""
        return (self.frame.name,)

    @property
    def object_names(self) -> Sequence[str]:
        """The object's name."""
        return (self.obj.name,)

    def read(self, index: int) -> tuple[ViewedFrame, ObjectModel]:
        """The frame and the object in it."""
        return self.frame, self.obj


class DatasetFrames:
    """Frames of data sets, in any layout that `datasets.frames` reads.

    Args:
        files: the frames, as from `find_frames`.
        hand: the hand in them.
        objects: folder of the objects' meshes or of BOP models.
    """

    def __init__(self, files: Sequence[Path], hand: Hand, objects: Path) -> None:
        self.hand = hand
        self.files = files
        self.load_object = cache(lambda name: datasets.load_object(objects, name))

    @cached_property
    def names(self) -> Sequence[str]:
        """What the frames are called."""
        return [datasets.frame_name(file) for file in self.files]

    @cached_property
    def object_names(self) -> Sequence[str]:
        """Which object is in each; empty where that cannot be read."""
        return [_object_name(file) for file in self.files]

    def read(self, index: int) -> tuple[ViewedFrame, ObjectModel]:
        """One frame and the object in it.

        Raises:
            InputError: a file is missing or broken.
        """
        frame = datasets.read_frame(self.files[index])
        return ViewedFrame.of_dataset(frame), self.load_object(frame.object_name)


def _object_name(file: Path) -> str:
    try:
        return datasets.object_name(file)
    except InputError:  # reading it will say what is wrong
        return ""
