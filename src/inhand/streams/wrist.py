"""Where the wrist's pose comes from: a constant, tf, or a topic of poses."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inhand.streams.pose_track import PoseTrack
from inhand.streams.transform_tree import TransformTree

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ConstantWrist:
    """A camera and a wrist that do not move against each other."""

    T: Array
    """T_camera_hand, shape (4, 4)."""

    def T_camera_hand(self, time_ns: int, camera_frame: str) -> Array:
        """See `source.Wrist`."""
        return self.T


@dataclass(frozen=True, eq=False)
class TreeWrist:
    """A wrist whose frame is in tf."""

    tree: TransformTree
    frame: str
    """Name of the frame in tf."""
    T_frame_hand: Array
    """Pose of the hand's root link in that frame, shape (4, 4)."""

    def T_camera_hand(self, time_ns: int, camera_frame: str) -> Array:
        """See `source.Wrist`."""
        return np.asarray(self.tree.T(camera_frame, self.frame, time_ns) @ self.T_frame_hand)


@dataclass(frozen=True, eq=False)
class TopicWrist:
    """A wrist whose pose is told by a topic, in the camera's frame or in one that tf knows."""

    track: PoseTrack
    parent: str
    """Name of the frame in which the poses are."""
    tree: TransformTree
    T_frame_hand: Array
    """Pose of the hand's root link in what the topic tells the pose of, shape (4, 4)."""

    def T_camera_hand(self, time_ns: int, camera_frame: str) -> Array:
        """See `source.Wrist`."""
        T_camera_parent = self.tree.T(camera_frame, self.parent, time_ns)
        return np.asarray(T_camera_parent @ self.track.at(time_ns) @ self.T_frame_hand)
