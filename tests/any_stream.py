"""A source, a clock and an estimator that do as the test says."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from inhand.camera import Camera
from inhand.errors import InputError
from inhand.estimate import PoseEstimate
from inhand.streams.bag import BagKind
from inhand.streams.runner import Result, Summary
from inhand.streams.source import Arrival, Frame

CAMERA = Camera(60.0, 60.0, 15.5, 11.5, 32, 24)
MS = 1_000_000
START = 1_700_000_000 * 1000 * MS
T_OBJECT, T_HAND = np.eye(4), np.eye(4)
T_OBJECT[:3, 3] = 0.01, -0.02, 0.5
T_HAND[:3, 3] = -0.03, 0.0, 0.45


@dataclass
class FakeClock:
    """Time passes only by sleeping, or when a test lets it."""

    time: float = 1000.0

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        assert seconds > 0
        self.time += seconds


@dataclass
class FakeSource:
    """Images taken at `times_ms`, by name; then `error`, if there is one."""

    times_ms: Sequence[int]
    without_wrist: Sequence[int] = ()
    unreadable: Sequence[int] = ()
    error: str = ""
    decoded: list[int] = field(default_factory=list)
    name: str = "fake"
    description: tuple[str, ...] = ()
    kind: BagKind | None = None

    @property
    def count(self) -> int:
        return len(self.times_ms)

    def arrivals(self) -> Iterator[Arrival]:
        for number, ms in enumerate(self.times_ms):
            yield Arrival(START + ms * MS, partial(self.frame, number))
        if self.error:
            raise InputError(self.error)

    def frame(self, number: int) -> Frame:
        self.decoded.append(number)
        depth = np.full((24, 32), 0.5 + number, dtype=np.float32)
        problem = ""
        if number in self.without_wrist:
            problem = "no wrist pose: it is never told"
        if number in self.unreadable:
            problem = "the image is damaged"
        return Frame(
            str(number),
            START + self.times_ms[number] * MS,
            "camera",
            CAMERA,
            None if number in self.unreadable else depth,
            None if problem else T_HAND,
            problem,
        )

    def close(self) -> None:
        pass


def found(frame: Frame | None = None) -> PoseEstimate:
    return PoseEstimate(
        True, "", T_OBJECT, {"bend": 0.5, "twist": -0.1}, T_HAND, 0.75, timings={"wrist": 0.0123}
    )


def not_found(frame: Frame) -> PoseEstimate:
    return PoseEstimate(False, "the object is hidden", None, {"bend": 0.5}, T_HAND, 0.0)


@dataclass
class Kept:
    """An output that keeps everything; `fault` is called before each result is taken."""

    fault: Callable[[Result], None] = lambda result: None
    results: list[Result] = field(default_factory=list)
    summaries: list[Summary] = field(default_factory=list)

    def write(self, result: Result) -> None:
        self.fault(result)
        self.results.append(result)

    def finish(self, summary: Summary) -> None:
        self.summaries.append(summary)

    @property
    def names(self) -> list[int]:
        return [int(r.frame.name) for r in self.results]
