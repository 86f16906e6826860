"""The interface of every method that a benchmark can run."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from math import degrees
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.datasets.frame import LABEL_OBJECT, Frame
from inhand.estimate import PoseEstimate
from inhand.estimator import StageResults
from inhand.hand import Hand
from inhand.object_model import ObjectModel


@dataclass(frozen=True, eq=False)
class View:
    """One image of a hand with an object, and what is known about it.

    The last two fields are ground truth: only upper bounds, and methods that have to be started
    near the answer, may look at them.
    """

    depth: NDArray[np.float32]
    """Depth z [m], shape (H, W), 0 where there is no reading."""
    camera: Camera
    """Intrinsics of the depth image and of `rgb`."""
    T_camera_hand: NDArray[np.float64]
    """Approximate wrist pose, shape (4, 4)."""
    rgb: NDArray[np.uint8] | None = None
    """Colour image with the same pixels, shape (H, W, 3)."""
    object_box: tuple[int, int, int, int] | None = None
    """Where a detector would see the object: first column and row, then those behind the last
    ones. A benchmark gives the box of the object's visible pixels, as the paper does."""
    true_mask: NDArray[np.bool_] | None = None
    """Which pixels show the object, shape (H, W)."""
    true_T_camera_object: NDArray[np.float64] | None = None
    """Pose of the object, shape (4, 4)."""


def view_of(frame: Frame) -> View:
    """What methods get to see of a frame with ground truth.

    Raises:
        InputError: the frame's data set has no hand.
    """
    mask = frame.truth.label == LABEL_OBJECT
    box = None
    if mask.any():
        rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
        box = (int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1)
    return View(
        frame.depth,
        frame.camera,
        frame.T_camera_hand_given,
        rgb=frame.rgb,
        object_box=box,
        true_mask=mask,
        true_T_camera_object=frame.truth.T_camera_object,
    )


class PreparedMethod(ABC):
    """A method that is ready for one object in one hand."""

    def estimate(self, view: View) -> PoseEstimate:
        """Pose of the object in one image; an image without an answer is no error.

        Raises:
            InputError: the view is malformed, or lacks something that the method needs.
        """
        return self.run(view)[0]

    @abstractmethod
    def run(self, view: View) -> tuple[PoseEstimate, StageResults | None]:
        """As `estimate`, with what the pipeline's stages returned if the method has them."""


class Method(ABC):
    """A way to find the pose of the object in the hand."""

    name: str
    """Name that it goes by in tables."""
    perturbation: Mapping[str, float] = MappingProxyType({})
    """What the method is handicapped by [m, rad], by name; nothing for most."""

    @property
    def label(self) -> str:
        """Name with the perturbation, such as `icp-from-truth@5mm`."""
        units = {"translation": (1000.0, "mm"), "rotation": (degrees(1), "deg")}
        amounts = ((amount, *units[name]) for name, amount in self.perturbation.items())
        return self.name + "".join(f"@{amount * scale:g}{unit}" for amount, scale, unit in amounts)

    @abstractmethod
    def prepare(self, hand: Hand, obj: ObjectModel, device: str) -> PreparedMethod:
        """Everything that can be done before there is an image: training, tables, kernels.

        Args:
            hand: the hand.
            obj: the object.
            device: Warp device name; what other libraries do runs where they do it.
        """
