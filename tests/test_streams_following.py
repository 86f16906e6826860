"""Following a stream: time stamps in seconds, images that come late, clocks that are set back."""

from dataclasses import replace
from typing import Any

import pytest
from any_stream import CAMERA, MS, START, FakeSource, found

from inhand.errors import InputError
from inhand.estimate import PoseEstimate
from inhand.streams.following import Following
from inhand.streams.source import Frame


class Noted:
    """A tracker that notes what it is told."""

    def __init__(self) -> None:
        self.told: list[Any] = []

    def reset(self) -> None:
        self.told.append("reset")

    def update(self, depth: Any, camera: Any, T: Any, *, time: float) -> PoseEstimate:
        assert camera == CAMERA
        self.told.append(round(time - START / 1e9, 3))
        return found()


def at(ms: int) -> Frame:
    return replace(FakeSource([0]).frame(0), time_ns=START + ms * MS)


def test_images_one_after_the_other() -> None:
    tracker = Noted()
    following = Following(tracker)  # type: ignore[arg-type]
    assert all(following(at(ms)).found for ms in (0, 33, 5000))
    assert tracker.told == [0, 0.033, 5]


@pytest.mark.parametrize("ms", [100, 67, -900])
def test_a_late_image_is_refused_and_the_track_goes_on(ms: int) -> None:
    tracker = Noted()
    following = Following(tracker)  # type: ignore[arg-type]
    following(at(100))
    with pytest.raises(InputError, match=r"before the one before it"):
        following(at(ms))
    following(at(133))
    assert tracker.told == [0.1, 0.133]


def test_a_clock_that_is_set_back_begins_another_track() -> None:
    tracker = Noted()
    following = Following(tracker)  # type: ignore[arg-type]
    for ms in (100, -60_000, -59_967):
        following(at(ms))
    assert tracker.told == [0.1, "reset", -60, -59.967]
