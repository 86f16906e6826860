"""Work spread over a local Ray cluster."""

import os
import sys
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from inhand.cluster import map_on_ray
from inhand.errors import InputError


def squarer() -> Callable[[], Callable[[int], tuple[int, int]]]:
    """Makes workers that die of the job 13; local, since a cluster cannot import this file."""

    def make() -> Callable[[int], tuple[int, int]]:
        def square(job: int) -> tuple[int, int]:
            if job == 13:
                os._exit(1)
            return job, job**2

        return square

    return make


@pytest.fixture(scope="module")
def cluster() -> Iterator[None]:
    """Ray on this machine."""
    ray: Any = pytest.importorskip("ray")
    ray.init(num_cpus=2, log_to_driver=False, include_dashboard=False)
    yield
    ray.shutdown()


@pytest.mark.usefixtures("cluster")
def test_every_job_is_done_once() -> None:
    jobs = list(range(12))
    assert dict(map_on_ray(squarer(), jobs)) == {job: job**2 for job in jobs}
    assert list(map_on_ray(squarer(), [])) == []


@pytest.mark.usefixtures("cluster")
def test_a_dead_worker_is_one_line() -> None:
    with pytest.raises(InputError, match="goes on where it stopped"):
        list(map_on_ray(squarer(), [1, 13]))


def test_missing_ray_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r'--ray needs Ray: pip install "inhand\[ray\]"'):
        list(map_on_ray(squarer(), [1]))
