"""A frame with ground truth, wherever it was read from."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.errors import InputError

LABEL_NOTHING = 0
LABEL_HAND = 1
LABEL_OBJECT = 2
LABEL_BACKGROUND = 3


@dataclass(frozen=True)
class Truth:
    """Ground truth of a frame, for scoring only."""

    wrist: NDArray[np.float64] | None
    """True wrist pose T_camera_hand, shape (4, 4); None in a data set without a hand."""
    T_camera_object: NDArray[np.float64]
    """True object pose, shape (4, 4)."""
    joint_positions: dict[str, float]
    """True joint angles [rad] by joint name; empty in a data set without a hand."""
    label: NDArray[np.uint8]
    """What each pixel shows, shape (H, W): 0 nothing, 1 hand, 2 object, 3 background."""
    visible_share: float
    """Visible share of the object's silhouette, 0 to 1."""

    @property
    def T_camera_hand(self) -> NDArray[np.float64]:
        """True wrist pose, shape (4, 4).

        Raises:
            InputError: the data set has no hand.
        """
        return _wrist(self.wrist)


@dataclass(frozen=True)
class Frame:
    """One depth image with what the estimator may know of it, and its ground truth."""

    name: str
    """Unique name, such as `clean/cuboid_003` or `dataset/000001/000003_000000`."""
    object_name: str
    """Name of the object's model."""
    depth: NDArray[np.float32]
    """Depth z [m], shape (H, W), 0 where there is no reading."""
    camera: Camera
    """Intrinsics of the depth image."""
    wrist: NDArray[np.float64] | None
    """The wrist pose T_camera_hand that the estimator is given (approximate), shape (4, 4); None
    in a data set without a hand."""
    truth: Truth
    """What the estimator must find."""
    rgb: NDArray[np.uint8] | None = None
    """Colour image with the same pixels, shape (H, W, 3), if there is one."""
    time: float | None = None
    """When the image was taken [s], if it is one of a sequence."""

    @property
    def T_camera_hand_given(self) -> NDArray[np.float64]:
        """The wrist pose that the estimator is given (approximate), shape (4, 4).

        Raises:
            InputError: the data set has no hand.
        """
        return _wrist(self.wrist)


def _wrist(T: NDArray[np.float64] | None) -> NDArray[np.float64]:
    if T is None:
        raise InputError(
            "the frame's data set says nothing about a hand, so there is no wrist pose; a BOP data "
            "set needs scene_hand.json beside scene_gt.json"
        )
    return T
