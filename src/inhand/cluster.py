"""Spreading independent work over a Ray cluster."""

import importlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from inhand.errors import InputError

Job = TypeVar("Job")
Result = TypeVar("Result")


def map_on_ray(
    make_worker: Callable[[], Callable[[Job], Result]], jobs: Sequence[Job]
) -> Iterator[Result]:
    """Results of jobs in the order in which they come, with a worker for every CPU of a cluster.

    `RAY_ADDRESS` names the cluster; without it, Ray starts on this machine. All its machines must
    see the files that the workers need under the same paths.

    Args:
        make_worker: makes the function that does a job, in the worker's own process; it is sent
            there, so it must not hold on to a device or an open file.
        jobs: what to work on, sent one by one.

    Raises:
        InputError: Ray is not installed, or a worker died or could not be made.
    """
    try:
        ray: Any = importlib.import_module("ray")
    except ImportError as error:
        raise InputError('--ray needs Ray: pip install "inhand[ray]"') from error
    ours = not ray.is_initialized()
    if ours:
        ray.init(log_to_driver=False)
    try:
        count = min(len(jobs), max(1, int(ray.cluster_resources().get("CPU", 1))))
        actor = ray.remote(_Actor)
        pool = ray.util.ActorPool([actor.remote(make_worker) for _ in range(count)])
        yield from pool.map_unordered(lambda a, job: a.work.remote(job), jobs)
    except ray.exceptions.RayActorError as error:
        reason = str(error).strip().splitlines()[-1].strip()
        raise InputError(
            f"a worker on the Ray cluster died ({reason}); the same command goes on where it "
            "stopped"
        ) from error
    finally:
        if ours:
            ray.shutdown()


class _Actor:
    """A worker as Ray needs it."""

    def __init__(self, make_worker: Callable[[], Any]) -> None:
        self._work = make_worker()

    def work(self, job: Any) -> Any:
        return self._work(job)
