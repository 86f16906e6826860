"""The pose of one frame in another over time, interpolated."""

import math
from array import array
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from inhand.streams.source import NoPose

Array = NDArray[np.float64]

NS = 1_000_000_000
"""Nanoseconds in a second."""


class PoseTrack:
    """Poses of one thing by time, in any order; a later one of the same time replaces the earlier.

    Args:
        name: what the poses are of, for messages.
        longest_gap: poses are interpolated between two that are at most this far apart [s].
    """

    def __init__(self, name: str, longest_gap: float) -> None:
        self.name = name
        self._longest_gap = longest_gap
        self._times, self._values = array("q"), array("d")
        self._sorted: tuple[NDArray[np.int64], Array] | None = None

    def add(self, time_ns: int, position: Sequence[float], quaternion: Sequence[float]) -> None:
        """Add a pose: position [m], shape (3,), and quaternion (x, y, z, w).

        Raises:
            ValueError: the numbers are no pose.
        """
        length = math.hypot(*quaternion)  # plain floats: a long recording tells millions
        if not 1e-6 < length < 1e6:
            raise ValueError(f"the quaternion {list(quaternion)} is no rotation")
        if not all(map(math.isfinite, position)):
            raise ValueError(f"the position {list(position)} is not finite")
        self._times.append(time_ns)
        self._values.extend(position)
        self._values.extend(x / length for x in quaternion)
        self._sorted = None

    def at(self, time_ns: int) -> Array:
        """The pose, shape (4, 4), at a time [ns]: position linear, rotation by slerp.

        Raises:
            NoPose: the time is not between two poses that are close enough.
        """
        times, values = self._in_order()
        after = int(np.searchsorted(times, time_ns))
        if after < len(times) and times[after] == time_ns:
            return _transform(values[after, :3], Rotation.from_quat(values[after, 3:]))
        if not 0 < after < len(times):
            raise NoPose(self._outside(time_ns, times))
        before = after - 1
        gap = int(times[after] - times[before])
        if gap > self._longest_gap * NS:
            raise NoPose(
                f"{self.name} is missing for {gap / NS:.2f} s around this time, and is "
                f"interpolated over {self._longest_gap:g} s at most"
            )
        share = int(time_ns - times[before]) / gap
        a, b = values[before], values[after]
        turn = Slerp([0, 1], Rotation.from_quat([a[3:], b[3:]]))(share)
        return _transform((1 - share) * a[:3] + share * b[:3], turn)

    def _in_order(self) -> tuple[NDArray[np.int64], Array]:
        if self._sorted is None:
            times = np.array(self._times, dtype=np.int64)
            values = np.array(self._values, dtype=np.float64).reshape(-1, 7)
            order = np.argsort(times, kind="stable")
            times, values = times[order], values[order]
            last_of_time = np.append(times[1:] != times[:-1], True)[: len(times)]
            self._sorted = times[last_of_time], values[last_of_time]
        return self._sorted

    def _outside(self, time_ns: int, times: NDArray[np.int64]) -> str:
        if not len(times):
            return f"{self.name} is never told"
        if time_ns < times[0]:
            return f"{self.name} is told from {(times[0] - time_ns) / NS:.3f} s after this time on"
        return f"{self.name} is last told {(time_ns - times[-1]) / NS:.3f} s before this time"


def _transform(position: Array, rotation: Rotation) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), position
    return T
