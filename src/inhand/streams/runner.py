"""The loop: images in, estimates out, and every image accounted for."""

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from itertools import islice
from typing import Any, Protocol

from inhand.errors import InputError
from inhand.estimate import PoseEstimate
from inhand.streams.replay import Clock, SystemClock, in_real_time
from inhand.streams.source import Arrival, Frame, Source

Estimate = Callable[[Frame], PoseEstimate]
"""Estimates an image whose depth and wrist pose are there: an estimator, or a tracker, which needs
the time as well."""


@dataclass(frozen=True)
class Counts:
    """What became of the images so far."""

    processed: int = 0
    """Images taken from the source: those estimated, and those that could not be."""
    found: int = 0
    """Images with an answer."""
    dropped: int = 0
    """Images passed over because they came while another was being processed."""
    without_wrist: int = 0
    """Images not estimated because the source has no wrist pose for them."""
    refused: int = 0
    """Images not estimated because they could not be decoded or were bad input."""

    def after(self, result: "Result") -> "Counts":
        """What became of the images up to and with this result."""
        refused = result.frame.depth is None
        return Counts(
            processed=self.processed + 1,
            found=self.found + result.estimate.found,
            dropped=self.dropped + result.dropped,
            without_wrist=self.without_wrist + (not refused and result.frame.T_camera_hand is None),
            refused=self.refused + refused,
        )

    def in_words(self) -> str:
        """What became of the images; what did not happen is left out, dropped images never."""
        parts = [f"{self.processed} processed", f"{self.found} found", f"{self.dropped} dropped"]
        if self.without_wrist:
            parts.append(f"{self.without_wrist} without wrist pose")
        if self.refused:
            parts.append(f"{self.refused} unreadable")
        return ", ".join(parts)


@dataclass(frozen=True)
class Result:
    """An image and its estimate."""

    frame: Frame
    estimate: PoseEstimate
    """With `found=False` and the reason where the image could not be estimated."""
    dropped: int
    """Images dropped between the one before and this one."""


@dataclass(frozen=True)
class Summary:
    """How a run ended."""

    source: str
    """Name of the source."""
    counts: Counts
    stopped: str
    """Why the run ended before the source did; empty if it did not."""
    first_problem: str = ""
    """The first image that could not be estimated, and why; empty if all could."""
    first_not_found: str = ""
    """The first image that was estimated without an answer, and why; empty if all have one."""

    def as_dict(self) -> dict[str, Any]:
        """The summary in JSON's types."""
        return {
            "source": self.source,
            **asdict(self.counts),
            "stopped": self.stopped,
            "first_problem": self.first_problem,
            "first_not_found": self.first_not_found,
        }


class Output(Protocol):
    """Where results go."""

    def write(self, result: Result) -> None:
        """Take a result.

        Raises:
            InputError: it cannot be written; what was written before stays readable.
        """
        ...

    def finish(self, summary: Summary) -> None:
        """Take the end of the run, and close; called once, however the run ended.

        Raises:
            InputError: it cannot be written.
        """
        ...


def run(
    source: Source,
    estimate: Estimate,
    outputs: Sequence[Output],
    *,
    rate: float | None = None,
    limit: int | None = None,
    report: Callable[[Counts], None] = lambda counts: None,
    clock: Clock | None = None,
) -> Summary:
    """Estimate the images of a source one after the other and write the results.

    Args:
        source: where the images come from.
        estimate: estimates one image.
        outputs: where the results go; all are finished, however the run ends.
        rate: times as fast as recorded, dropping what comes in between; None: every image.
        limit: stop after this many images.
        report: told the counts after every image.
        clock: tells the time.

    Raises:
        InputError: an argument makes no sense; or the source breaks off or an output cannot be
            written, and the rest is written.
        KeyboardInterrupt: Ctrl-C; all results are written.
    """
    counts, stopped = Counts(), "it broke off unexpectedly"
    first_problem = first_not_found = ""
    try:
        check_pace(source, rate, limit)
        arrivals: Iterator[Arrival] = source.arrivals()
        if rate is not None:
            arrivals = in_real_time(arrivals, rate, clock or SystemClock())
        for arrival in islice(arrivals, limit):
            result = _process(arrival, estimate)
            with interrupt_held():
                counts = counts.after(result)
                first_problem = first_problem or _problem(result)
                first_not_found = first_not_found or _not_found(result)
                for output in outputs:
                    output.write(result)
            report(counts)
        cut = counts.processed == limit and counts.processed + counts.dropped != source.count
        stopped = f"after {limit} images" if cut else ""
    except KeyboardInterrupt:
        stopped = "interrupted"
        raise
    except InputError as error:
        stopped = str(error)
        raise
    finally:
        summary = Summary(source.name, counts, stopped, first_problem, first_not_found)
        with interrupt_held():
            _finish(outputs, summary)
    return summary


def check_pace(source: Source, rate: float | None, limit: int | None) -> None:
    """Raise InputError if `rate` or `limit` make no sense for a source; see `run`."""
    if limit is not None and limit < 1:
        raise InputError(f"the limit must be at least 1 image, got {limit}")
    if rate is not None and not 0 < rate < float("inf"):
        raise InputError(f"the rate must be positive (1 is real time), got {rate:g}")
    if rate is not None and source.count is None:
        raise InputError("a camera plays in real time already: leave out the rate")


def _process(arrival: Arrival, estimate: Estimate) -> Result:
    frame = arrival.decode()
    if frame.depth is None or frame.T_camera_hand is None:
        return Result(frame, _no_estimate(frame.problem), arrival.dropped)
    try:
        answer = estimate(frame)
    except InputError as error:
        frame = replace(frame, depth=None, problem=str(error))
        answer = _no_estimate(frame.problem)
    return Result(frame, answer, arrival.dropped)


def _no_estimate(reason: str) -> PoseEstimate:
    return PoseEstimate(False, reason, None, {}, None, 0.0)


def _problem(result: Result) -> str:
    """Why an image could not be estimated, a sentence with its name; empty if it could."""
    frame = result.frame
    return f"image {frame.name}: {frame.problem}" if frame.problem else ""


def _not_found(result: Result) -> str:
    """Why an image that could be estimated has no answer, with its name; empty if it has one."""
    if result.frame.problem or result.estimate.found:
        return ""
    return f"image {result.frame.name}: {result.estimate.reason}"


def _finish(outputs: Sequence[Output], summary: Summary) -> None:
    """Finish all outputs, the first at the end: it then knows if another could not be."""
    errors: list[Exception] = []
    for output in reversed(outputs):
        try:
            output.finish(summary)
        except Exception as error:  # raised again when the others are finished
            errors.append(error)
            summary = replace(summary, stopped=summary.stopped or str(error))
    if errors:
        raise errors[0]


@contextmanager
def interrupt_held() -> Iterator[None]:
    """Ctrl-C waits until the block is done, so that no file is left half written."""
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield  # it comes to another thread, or is ignored
        return
    pressed: list[int] = []
    signal.signal(signal.SIGINT, lambda number, stack: pressed.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if pressed:
        before(signal.SIGINT, None)
