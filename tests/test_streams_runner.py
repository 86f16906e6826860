"""The loop: every image accounted for, backpressure by a clock that the test moves, faults."""

import os
import signal
from typing import Any

import pytest
from any_stream import FakeClock, FakeSource, Kept, found, not_found
from hypothesis import given
from hypothesis import strategies as st

from inhand.errors import InputError
from inhand.estimate import PoseEstimate
from inhand.streams.replay import in_real_time
from inhand.streams.runner import Counts, Result, run
from inhand.streams.source import Frame


class Slow:
    """An estimator that takes `seconds` of a fake clock."""

    def __init__(self, clock: FakeClock, seconds: float) -> None:
        self.clock, self.seconds = clock, seconds

    def __call__(self, frame: Frame) -> PoseEstimate:
        self.clock.time += self.seconds
        return found()


EVERY_100_MS = list(range(0, 1000, 100))


def test_every_image_by_default_however_slow() -> None:
    clock, output = FakeClock(), Kept()
    summary = run(FakeSource(EVERY_100_MS), Slow(clock, 3.0), [output], clock=clock)
    assert output.names == list(range(10))
    assert summary.counts == Counts(processed=10, found=10)
    assert summary.stopped == ""
    assert output.summaries == [summary]


@pytest.mark.parametrize(
    ("seconds", "rate", "taken"),
    [
        (0.05, 1.0, [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]),
        # After the image at 0 it is 0.26: that at 0.2 is the newest, that at 0.1 is dropped.
        (0.26, 1.0, [0, 2, 5, 7, 9]),
        (0.26, 0.5, [0, 1, 2, 3, 5, 6, 7, 9]),
        (0.06, 4.0, [0, 2, 4, 7, 9]),
        (5.0, 1.0, [0, 9]),
    ],
)
def test_in_real_time_the_newest_is_taken(seconds: float, rate: float, taken: list[int]) -> None:
    clock, output, source = FakeClock(), Kept(), FakeSource(EVERY_100_MS)
    summary = run(source, Slow(clock, seconds), [output], rate=rate, clock=clock)
    assert output.names == taken
    assert source.decoded == taken, "what is dropped need not be decoded"
    assert summary.counts.processed == len(taken)
    assert summary.counts.dropped == 10 - len(taken)
    gaps = [b - a - 1 for a, b in zip([-1, *taken], taken, strict=False)]
    assert [r.dropped for r in output.results] == gaps


def test_in_real_time_nothing_comes_early() -> None:
    clock = FakeClock()
    when = []
    for arrival in in_real_time(FakeSource([0, 100, 700]).arrivals(), 2.0, clock):
        when.append((arrival.decode().name, clock.time - 1000.0))
    assert [name for name, _ in when] == ["0", "1", "2"]
    assert [t for _, t in when] == pytest.approx([0, 0.05, 0.35])


times = st.lists(st.integers(0, 5000), min_size=1, max_size=40, unique=True).map(sorted)


@given(times, st.floats(0.001, 2), st.floats(0.1, 10))
def test_dropped_and_processed_are_all(ms: list[int], seconds: float, rate: float) -> None:
    clock, output = FakeClock(), Kept()
    summary = run(FakeSource(ms), Slow(clock, seconds), [output], rate=rate, clock=clock)
    assert summary.counts.processed + summary.counts.dropped == len(ms)
    assert output.names == sorted(set(output.names))
    assert output.names[-1] == len(ms) - 1, "the last image is always taken"


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf")])
def test_a_rate_is_positive(rate: float) -> None:
    output = Kept()
    with pytest.raises(InputError, match="rate must be positive"):
        run(FakeSource([0]), found, [output], rate=rate)
    assert len(output.summaries) == 1


def test_images_that_cannot_be_estimated_are_reported_and_counted() -> None:
    source = FakeSource(range(5), without_wrist=[1], unreadable=[3])

    def estimate(frame: Frame) -> PoseEstimate:
        if frame.name == "4":
            raise InputError("the median depth is 4500 m")
        return not_found(frame) if frame.name == "2" else found()

    output, reports = Kept(), list[Counts]()
    summary = run(source, estimate, [output], report=reports.append)
    assert [r.estimate.reason for r in output.results] == [
        "",
        "no wrist pose: it is never told",
        "the object is hidden",
        "the image is damaged",
        "the median depth is 4500 m",
    ]
    assert summary.counts == Counts(processed=5, found=1, without_wrist=1, refused=2)
    assert summary.first_problem == "image 1: no wrist pose: it is never told"
    assert summary.first_not_found == "image 2: the object is hidden"
    assert [c.processed for c in reports] == [1, 2, 3, 4, 5]


def test_limit() -> None:
    output = Kept()
    summary = run(FakeSource(range(5)), found, [output], limit=2)
    assert output.names == [0, 1]
    assert summary.stopped == "after 2 images"


def test_a_limit_that_is_all_there_is_stops_nothing() -> None:
    clock = FakeClock()
    assert run(FakeSource(range(5)), found, [Kept()], limit=5).stopped == ""
    assert run(FakeSource(range(5)), found, [Kept()], limit=9).stopped == ""
    # In real time the images at 0 and 900 ms are taken: with those dropped, that is all.
    slow = Slow(clock, 5.0)
    summary = run(FakeSource(EVERY_100_MS), slow, [Kept()], rate=1.0, limit=2, clock=clock)
    assert summary.counts == Counts(processed=2, found=2, dropped=8)
    assert summary.stopped == ""


def test_a_camera_is_always_stopped_by_the_limit() -> None:
    class Live(FakeSource):
        count = None  # type: ignore[assignment]

    assert run(Live(range(5)), found, [Kept()], limit=5).stopped == "after 5 images"


def test_a_limit_is_positive() -> None:
    with pytest.raises(InputError, match="at least 1 image"):
        run(FakeSource(range(5)), found, [Kept()], limit=0)


def test_a_camera_has_no_rate() -> None:
    class Live(FakeSource):
        count = None  # type: ignore[assignment]

    with pytest.raises(InputError, match="real time already"):
        run(Live(range(5)), found, [Kept()], rate=1.0)


@pytest.mark.parametrize("rate", [None, 1000.0])
def test_a_source_that_breaks_off(rate: float | None) -> None:
    output, clock = Kept(), FakeClock()
    source = FakeSource([0, 100, 200], error="the file is damaged")
    with pytest.raises(InputError, match="the file is damaged"):
        run(source, found, [output], rate=rate, clock=clock)
    assert output.names == [0, 1, 2]
    (summary,) = output.summaries
    assert summary.stopped == "the file is damaged"
    assert summary.counts.processed == 3


def test_an_output_that_cannot_write_stops_the_run_and_the_others_are_finished() -> None:
    def full(result: Result) -> None:
        if result.frame.name == "2":
            raise InputError("no space left")

    first, broken, last = Kept(), Kept(full), Kept()
    with pytest.raises(InputError, match="no space left"):
        run(FakeSource(range(5)), found, [first, broken, last])
    assert first.names == [0, 1, 2]
    assert broken.names == last.names == [0, 1]
    for output in (first, broken, last):
        assert [s.stopped for s in output.summaries] == ["no space left"]


@pytest.mark.parametrize("kind", [InputError, RuntimeError])
def test_all_outputs_are_finished_when_one_cannot_be(kind: type[Exception]) -> None:
    class Unfinishable(Kept):
        def finish(self, summary: Any) -> None:
            raise kind("no space left for the index")

    first, last = Kept(), Kept()
    with pytest.raises(kind, match="no space left for the index"):
        run(FakeSource(range(2)), found, [first, Unfinishable(), last])
    assert len(first.summaries) == len(last.summaries) == 1


def test_ctrl_c_between_images_finishes_the_outputs(interruptible: None) -> None:
    def estimate(frame: Frame) -> PoseEstimate:
        if frame.name == "2":
            os.kill(os.getpid(), signal.SIGINT)
        return found()

    output = Kept()
    with pytest.raises(KeyboardInterrupt):
        run(FakeSource(range(5)), estimate, [output])
    assert output.names == [0, 1]
    assert [s.stopped for s in output.summaries] == ["interrupted"]


def test_ctrl_c_while_writing_waits_for_the_whole_result(interruptible: None) -> None:
    def pressed(result: Result) -> None:
        if result.frame.name == "1":
            os.kill(os.getpid(), signal.SIGINT)

    first, second = Kept(pressed), Kept()
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        run(FakeSource(range(5)), found, [first, second])
    assert first.names == second.names == [0, 1]
    assert second.summaries[0].stopped == "interrupted"
    assert second.summaries[0].counts.processed == 2
    assert signal.getsignal(signal.SIGINT) is before


def test_ctrl_c_that_is_ignored_stays_ignored() -> None:
    """As for a command that a shell runs in the background."""

    def pressed(result: Result) -> None:
        os.kill(os.getpid(), signal.SIGINT)

    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        summary = run(FakeSource(range(3)), found, [Kept(pressed)])
    finally:
        signal.signal(signal.SIGINT, before)
    assert summary.counts.processed == 3


def test_a_bug_in_the_estimator_finishes_the_outputs() -> None:
    def broken(frame: Frame) -> PoseEstimate:
        raise RuntimeError("a bug")

    output = Kept()
    with pytest.raises(RuntimeError, match="a bug"):
        run(FakeSource(range(5)), broken, [output])
    assert len(output.summaries) == 1
    assert output.summaries[0].stopped
