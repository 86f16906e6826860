"""Parameters of streams, and what the user chooses where a source leaves a choice."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.errors import InputError


@dataclass(frozen=True, eq=False)
class StreamConfig:
    """How a source is read; None: as the source says.

    Raises:
        InputError: a time or a rate is not positive and finite.
    """

    camera: Camera | None = None
    """Intrinsics and depth unit, instead of the source's own."""
    T_camera_hand: NDArray[np.float64] | None = None
    """Constant wrist pose, shape (4, 4), instead of the source's own."""
    depth_topic: str | None = None
    """Topic of the depth images."""
    camera_topic: str | None = None
    """Topic of the depth images' camera info."""
    pose_topic: str | None = None
    """Topic with the wrist's pose, instead of tf."""
    hand_frame: str | None = None
    """Frame of the hand in tf; by default `root_link`, if tf has it."""
    root_link: str = ""
    """Name of the hand's root link."""
    T_frame_hand: NDArray[np.float64] | None = None
    """Pose of the hand's root link in the frame that tf or the pose topic tells of, shape (4, 4);
    None: they are the same."""
    longest_gap: float = 0.5
    """Poses are interpolated between two that are at most this far apart [s]."""
    frame_rate: float = 30.0
    """Images a second: of a folder without times, and what a camera is asked for [1/s]."""
    size: tuple[int, int] = (640, 480)
    """Width and height that a camera is asked for [pixel]."""
    patience: float = 5.0
    """A camera that sends nothing for this long is lost [s]."""

    def __post_init__(self) -> None:
        for name in ("longest_gap", "frame_rate", "patience"):
            if not 0 < getattr(self, name) < np.inf:
                raise InputError(f"{name} must be positive, got {getattr(self, name):g}")

    @property
    def chosen_for_recordings(self) -> tuple[str, ...]:
        """Names of the choices made that only recordings know."""
        names = ("depth_topic", "camera_topic", "pose_topic", "hand_frame", "T_frame_hand")
        return tuple(name for name in names if getattr(self, name) is not None)
