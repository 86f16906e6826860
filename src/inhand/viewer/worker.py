"""One thread that does what a page asks for, and skips what has been overtaken."""

import logging
import threading
from collections.abc import Callable
from typing import Any

from inhand.errors import InputError

logger = logging.getLogger(__name__)


class Worker:
    """Runs jobs one after the other in a thread of its own.

    A job that is still waiting when another of its name comes is dropped: while a slider moves,
    only the last position counts. So drawing needs no locks, and never falls behind.

    Args:
        tell: called with a message for the user when a job failed.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._jobs: dict[str, Callable[[], Any]] = {}
        self._changed = threading.Condition()
        self._busy = self._stopped = False
        self._thread = threading.Thread(target=self._run, name="inhand viewer", daemon=True)
        self._thread.start()

    def submit(self, name: str, job: Callable[[], Any]) -> None:
        """Have a job done, instead of any of that name that has not begun."""
        with self._changed:
            self._jobs.pop(name, None)
            self._jobs[name] = job
            self._changed.notify_all()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until there is nothing left to do; False if that takes longer [s]."""
        with self._changed:
            return self._changed.wait_for(lambda: not (self._jobs or self._busy), timeout)

    def stop(self) -> None:
        """Drop what has not begun, and end with what has."""
        with self._changed:
            self._jobs.clear()
            self._stopped = True
            self._changed.notify_all()
        self._thread.join()

    def _run(self) -> None:
        while (job := self._next()) is not None:
            try:
                job()
            except InputError as error:
                self._tell(str(error))
            except Exception as error:  # the page goes on; what failed is in the log
                logger.exception("the viewer failed")
                self._tell(f"{type(error).__name__}: {error}")

    def _next(self) -> Callable[[], Any] | None:
        with self._changed:
            self._busy = False
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._jobs or self._stopped)
            if self._stopped:
                return None
            self._busy = True
            return self._jobs.pop(next(iter(self._jobs)))
