"""A recording played back in real time: what comes while something is processed is dropped."""

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Protocol

from inhand.errors import InputError
from inhand.streams.pose_track import NS
from inhand.streams.source import Arrival


class Clock(Protocol):
    """Tells the time and lets it pass."""

    def now(self) -> float:
        """Time since some moment [s]."""
        ...

    def sleep(self, seconds: float) -> None:
        """Return when `seconds` have passed."""
        ...


class SystemClock:
    """The clock on the wall."""

    def now(self) -> float:
        """See `Clock.now`."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """See `Clock.sleep`."""
        time.sleep(seconds)


def in_real_time(arrivals: Iterator[Arrival], rate: float, clock: Clock) -> Iterator[Arrival]:
    """Each image when it is due, or the newest that is; those passed over are counted as dropped.

    Args:
        arrivals: the images of a recording.
        rate: times as fast as they were recorded, positive; 1 is real time.
        clock: tells the time.

    Raises:
        InputError: the source breaks off; the images before are given.
    """
    coming = _LookAhead(arrivals)
    if coming.next is not None:
        start, first = clock.now(), coming.next.time_ns
    while coming.next is not None:
        due = start + (coming.next.time_ns - first) / NS / rate
        if (wait := due - clock.now()) > 0:
            clock.sleep(wait)
        position = first + (clock.now() - start) * NS * rate
        newest, dropped = coming.take(), 0
        while coming.next is not None and coming.next.time_ns <= position:
            dropped += newest.dropped + 1
            newest = coming.take()
        yield replace(newest, dropped=newest.dropped + dropped)
    if coming.error is not None:
        raise coming.error


class _LookAhead:
    """Knows the next image before it is taken; keeps the error at the end until then."""

    def __init__(self, arrivals: Iterator[Arrival]) -> None:
        self._arrivals = arrivals
        self.next: Arrival | None = None
        self.error: InputError | None = None
        self._advance()

    def take(self) -> Arrival:
        """The next image."""
        taken = self.next
        assert taken is not None
        self._advance()
        return taken

    def _advance(self) -> None:
        try:
            self.next = next(self._arrivals, None)
        except InputError as error:
            self.next, self.error = None, error
