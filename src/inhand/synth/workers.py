"""Making the images of a data set in this process, in several, or on a Ray cluster."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path

from inhand.cluster import map_on_ray
from inhand.errors import InputError
from inhand.processes import WorkerPool
from inhand.synth.dataset import Workshop
from inhand.synth.plan import Plan

Job = tuple[int, int]
"""Numbers of scene and image."""
CHUNK = 8
"""Images that a process makes before it reports."""


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
    pool = WorkerPool(partial(_chunk_maker, folder, plan, device), workers)
    try:
        yield from pool.map(_chunks(jobs))
    except BrokenProcessPool as error:
        raise InputError(
            "a worker process died, for want of memory perhaps: try fewer workers; the same "
            "command goes on where it stopped"
        ) from error
    finally:
        pool.close()


def make_on_ray(folder: Path, plan: Plan, jobs: Sequence[Job], device: str) -> Iterator[int]:
    """As `make_here`, with a worker for every CPU of a Ray cluster: see `cluster.map_on_ray`.

    Raises:
        InputError: Ray is not installed, or a worker died.
    """
    return map_on_ray(partial(_chunk_maker, folder.resolve(), plan, device), _chunks(jobs))


def _chunk_maker(folder: Path, plan: Plan, device: str) -> Callable[[Sequence[Job]], int]:
    return partial(_make_with, Workshop(folder, plan, device))


def _make_with(workshop: Workshop, chunk: Sequence[Job]) -> int:
    for job in chunk:
        workshop.make(*job)
    return len(chunk)


def _chunks(jobs: Sequence[Job]) -> list[Sequence[Job]]:
    return [jobs[i : i + CHUNK] for i in range(0, len(jobs), CHUNK)]
