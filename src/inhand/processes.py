"""Work shared among processes of this machine."""

import multiprocessing
import os
import pickle
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any, Generic, TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")


class WorkerPool(Generic[Job, Result]):
    """Processes that wait for work until the pool is closed or gone, or its own process is.

    They are started as they are needed. As every process that Python spawns, they import the main
    script anew, which must not start work then: `if __name__ == "__main__":`.

    Args:
        make_worker: makes the function that does a job, in the worker's own process; it is sent
            there, so it must not hold on to a device or an open file.
        count: number of processes.
    """

    def __init__(self, make_worker: Callable[[], Callable[[Job], Result]], count: int) -> None:
        context = multiprocessing.get_context("spawn")
        self.count = count
        # In a file, as this process waits until a new one has read what it is sent, which it does
        # when it has imported the main script.
        self._made_of = NamedTemporaryFile(prefix="inhand-")  # noqa: SIM115  # as long as the pool
        pickle.dump(make_worker, self._made_of)
        self._made_of.flush()
        self._pool = ProcessPoolExecutor(count, context, _start, (Path(self._made_of.name),))

    def map(self, jobs: Iterable[Job]) -> Iterator[Result]:
        """Results in the order of the jobs, which are fetched not much earlier than needed.

        Raises:
            concurrent.futures.process.BrokenProcessPool: a process died.
        """
        begun: deque[Future[Result]] = deque()
        try:
            for job in jobs:
                begun.append(self._pool.submit(_work, job))
                if len(begun) > 2 * self.count:
                    yield begun.popleft().result()
            while begun:
                yield begun.popleft().result()
        finally:
            for future in begun:
                future.cancel()

    def close(self) -> None:
        """End the processes when they have done what they have begun."""
        self._pool.shutdown(cancel_futures=True)
        self._made_of.close()


_worker: Callable[[Any], Any] | None = None


def _start(made_of: Path) -> None:
    global _worker
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process decides when to stop
    threading.Thread(target=_end_with_parent, args=(made_of,), daemon=True).start()
    try:
        make_worker = pickle.loads(made_of.read_bytes())
    except FileNotFoundError:  # the pool is gone before this process was needed
        os._exit(0)
    _worker = make_worker()


def _end_with_parent(leftover: Path) -> None:
    """End this process when its parent is gone, however it went."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        leftover.unlink(missing_ok=True)  # by a parent that was killed
        os._exit(1)


def _work(job: Any) -> Any:
    assert _worker is not None
    return _worker(job)
