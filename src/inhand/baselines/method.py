"""The interface of every method that a benchmark can run."""

import importlib
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.errors import InputError
from inhand.estimate import PoseEstimate
from inhand.estimator import StageResults
from inhand.hand import Hand
from inhand.object_model import ObjectModel


@dataclass(frozen=True, eq=False)
class View:
    """One image of a hand with an object, and what is known about it.

    The last two fields are ground truth: only upper bounds and methods that have to be started near
    the answer may look at them.
    """

    depth: NDArray[np.float32]
    """Depth z [m], shape (H, W), 0 where there is no reading."""
    camera: Camera
    """Intrinsics of the depth image and of `rgb`."""
    T_camera_hand: NDArray[np.float64]
    """Approximate wrist pose, shape (4, 4)."""
    rgb: NDArray[np.uint8] | None = None
    """Colour registered with the depth image, shape (H, W, 3)."""
    object_box: tuple[int, int, int, int] | None = None
    """Where a detector sees the object: first and last column, first and last row [pixel]."""
    true_mask: NDArray[np.bool_] | None = None
    """Which pixels show the object, shape (H, W)."""
    true_T_camera_object: NDArray[np.float64] | None = None
    """Pose of the object, shape (4, 4)."""


class PreparedMethod(ABC):
    """A method that is ready for one object in one hand."""

    def estimate(self, view: View) -> PoseEstimate:
        """Pose of the object in one image; an image without an answer is no error."""
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

    @abstractmethod
    def prepare(self, hand: Hand, obj: ObjectModel, device: str) -> PreparedMethod:
        """Everything that can be done before an image is there: training, tables, kernels.

        Args:
            hand: the hand.
            obj: the object.
            device: Warp device name; methods of other libraries run where they do.

        Raises:
            InputError: the method needs a library that is not installed.
        """


def need(module: str, method: str, extra: str = "bench") -> Any:
    """The module of an optional library.

    Raises:
        InputError: it is not installed, or does not load here.
    """
    try:
        return importlib.import_module(module)
    except (ImportError, OSError) as error:
        library = module.split(".")[0]
        missing = isinstance(error, ModuleNotFoundError) and error.name == library
        why = "which is not installed" if missing else f"which does not load here ({error})"
        raise InputError(
            f'the method "{method}" needs {library}, {why}: pip install "inhand[{extra}]"'
        ) from error
