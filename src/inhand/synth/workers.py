"""Making the images of a data set in this process, in several, or on a Ray cluster."""

import importlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from inhand.errors import InputError
from inhand.synth.dataset import Plan, Workshop

Job = tuple[int, int]
"""Numbers of scene and image."""
CHUNK = 8
"""Images that a process makes before it reports."""

_workshop: Workshop | None = None


def make_here(folder: Path, plan: Plan, jobs: Sequence[Job], device: str) -> Iterator[int]:
    """Make images in this process; gives the number made, again and again.

    Args:
        folder: folder of a data set that was started.
        plan: its plan.
        jobs: the images to make.
        device: Warp device name.
    """
    workshop = Workshop(folder, plan, device)
    for job in jobs:
        workshop.make(*job)
        yield 1


def make_in_processes(
    folder: Path, plan: Plan, jobs: Sequence[Job], device: str, workers: int
) -> Iterator[int]:
    """As `make_here`, in `workers` processes.

    Raises:
        InputError: a process died.
    """
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, context, _start_worker, (folder, plan, device))
    try:
        for done in as_completed([pool.submit(_make_chunk, chunk) for chunk in _chunks(jobs)]):
            yield done.result()
    except BrokenProcessPool as error:
        raise InputError(
            "a worker process died, for want of memory perhaps: try fewer workers; the same "
            "command goes on where it stopped"
        ) from error
    finally:
        pool.shutdown(cancel_futures=True)


def make_on_ray(folder: Path, plan: Plan, jobs: Sequence[Job], device: str) -> Iterator[int]:
    """As `make_here`, with an actor for every CPU of a Ray cluster.

    `RAY_ADDRESS` names the cluster; without it, Ray starts on this machine. All its machines must
    see the data set's folder, the hand and the objects under the same paths.

    Raises:
        InputError: Ray is not installed.
    """
    try:
        ray = importlib.import_module("ray")
    except ImportError as error:
        raise InputError('--ray needs Ray: pip install "inhand[ray]"') from error
    ours = not ray.is_initialized()
    if ours:
        ray.init(log_to_driver=False)
    try:
        count = max(1, int(ray.cluster_resources().get("CPU", 1)))
        actor = ray.remote(_RayWorker)
        actors = [actor.remote(folder.resolve(), plan, device) for _ in range(count)]
        pool = importlib.import_module("ray.util").ActorPool(actors)
        yield from pool.map_unordered(lambda a, chunk: a.make.remote(chunk), _chunks(jobs))
    finally:
        if ours:
            ray.shutdown()


class _RayWorker:
    def __init__(self, folder: Path, plan: Plan, device: str) -> None:
        self._workshop = Workshop(folder, plan, device)

    def make(self, chunk: Sequence[Job]) -> int:
        for job in chunk:
            self._workshop.make(*job)
        return len(chunk)


def _chunks(jobs: Sequence[Job]) -> list[Sequence[Job]]:
    return [jobs[i : i + CHUNK] for i in range(0, len(jobs), CHUNK)]


def _start_worker(folder: Path, plan: Plan, device: str) -> None:
    global _workshop
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process decides when to stop
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _workshop = Workshop(folder, plan, device)


def _end_with_parent() -> None:
    """End this process when its parent is gone, however it went."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _make_chunk(chunk: Sequence[Job]) -> int:
    assert _workshop is not None
    for job in chunk:
        _workshop.make(*job)
    return len(chunk)
