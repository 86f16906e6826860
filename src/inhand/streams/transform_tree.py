"""The tree of coordinate frames that tf tells of."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from inhand.geometry.se3 import inverse
from inhand.streams.pose_track import PoseTrack
from inhand.streams.source import NoPose

Array = NDArray[np.float64]


class TransformTree:
    """Frames, each with its pose in a parent over time or for all time.

    Args:
        longest_gap: poses are interpolated between two that are at most this far apart [s].
    """

    def __init__(self, longest_gap: float) -> None:
        self._longest_gap = longest_gap
        self._parent: dict[str, str] = {}
        self._pose: dict[str, PoseTrack | Array] = {}

    @property
    def frames(self) -> list[str]:
        """Names of all frames, sorted."""
        return sorted({*self._parent, *self._parent.values()})

    def add(
        self,
        parent: str,
        child: str,
        time_ns: int,
        position: Sequence[float],
        quaternion: Sequence[float],
        *,
        static: bool = False,
    ) -> None:
        """Add the pose of a frame in its parent: position [m] and quaternion (x, y, z, w).

        Raises:
            ValueError: the numbers are no pose.
        """
        parent, child = plain_name(parent), plain_name(child)
        known = self._pose.get(child)
        if static or self._parent.get(child) != parent or not isinstance(known, PoseTrack):
            known = PoseTrack(f"the pose of {child} in {parent}", self._longest_gap)
        known.add(time_ns, position, quaternion)
        self._parent[child] = parent
        self._pose[child] = known.at(time_ns) if static else known

    def connected(self, a: str, b: str) -> bool:
        """Whether two frames hang together.

        Raises:
            NoPose: the frames go in a circle.
        """
        return self._path(a)[-1] == self._path(b)[-1]

    def T(self, target: str, source: str, time_ns: int) -> Array:
        """The pose of frame `source` in frame `target`, shape (4, 4), at a time [ns].

        Raises:
            NoPose: they do not hang together, or a pose on the way is not known for that time.
        """
        up, down = self._path(target), self._path(source)
        if up[-1] != down[-1]:
            raise NoPose(f"tf does not connect {target} with {source}")
        # Poses from the common ancestor to the root cancel, and need not be known.
        common = next(frame for frame in up if frame in down)
        T_common_target = self._chain(up[: up.index(common)], time_ns)
        T_common_source = self._chain(down[: down.index(common)], time_ns)
        return np.asarray(inverse(T_common_target) @ T_common_source)

    def _path(self, frame: str) -> list[str]:
        """The frame, its parent, and so on to the root."""
        path = [plain_name(frame)]
        while (parent := self._parent.get(path[-1])) is not None:
            if parent in path:
                raise NoPose(f"tf goes in a circle at {parent}")
            path.append(parent)
        return path

    def _chain(self, frames: list[str], time_ns: int) -> Array:
        """The pose of the first frame in the parent of the last."""
        T = np.eye(4)
        for frame in frames:
            pose = self._pose[frame]
            T = (pose.at(time_ns) if isinstance(pose, PoseTrack) else pose) @ T
        return T


def plain_name(frame: str) -> str:
    """A frame's name without the leading slash that early ROS gave it."""
    return frame.lstrip("/")
