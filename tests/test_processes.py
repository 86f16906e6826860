"""Work shared among processes: order, errors, deaths, and how far ahead jobs are fetched."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from inhand.processes import WorkerPool, _start


def make_worker(offset: int) -> Any:
    """A function that adds; the process that it is called in is part of what it gives."""

    def work(job: int) -> tuple[int, int]:
        if job < 0:
            raise ValueError(f"cannot do {job}")
        if job > 1000:
            os._exit(1)
        time.sleep(0.05 / (1 + job))  # the first take longest
        return offset + job, os.getpid()

    return work


@pytest.fixture(scope="module")
def pool() -> Iterator[WorkerPool[int, tuple[int, int]]]:
    """Two processes that add 100."""
    pool: WorkerPool[int, tuple[int, int]] = WorkerPool(partial(make_worker, 100), 2)
    yield pool
    pool.close()


def test_results_come_in_the_order_of_the_jobs(pool: WorkerPool[int, tuple[int, int]]) -> None:
    found = list(pool.map(iter(range(20))))
    assert [value for value, _ in found] == list(range(100, 120))
    assert os.getpid() not in {process for _, process in found}


def test_jobs_are_not_fetched_long_before_they_are_needed(
    pool: WorkerPool[int, tuple[int, int]],
) -> None:
    fetched = []

    def jobs() -> Iterator[int]:
        for job in range(100):
            fetched.append(job)
            yield job

    for done, _ in enumerate(pool.map(jobs()), start=1):
        assert len(fetched) <= done + 2 * pool.count


def test_an_error_reaches_the_caller_and_the_pool_goes_on(
    pool: WorkerPool[int, tuple[int, int]],
) -> None:
    with pytest.raises(ValueError, match="cannot do -1"):
        list(pool.map([1, -1, 2]))
    assert [value for value, _ in pool.map([3])] == [103]
    assert list(pool.map([])) == []


def test_a_death_is_noticed() -> None:
    pool: WorkerPool[int, tuple[int, int]] = WorkerPool(partial(make_worker, 0), 1)
    with pytest.raises(BrokenProcessPool):
        list(pool.map([1, 1001, 2]))
    pool.close()


def test_a_process_that_comes_when_the_pool_is_gone_ends_quietly(tmp_path: Path) -> None:
    gone = tmp_path / "gone"
    late = multiprocessing.get_context("spawn").Process(target=_start, args=(gone,))
    late.start()
    late.join()
    assert late.exitcode == 0


def test_nothing_is_left_of_a_process_that_was_killed(tmp_path: Path) -> None:
    script = tmp_path / "killed.py"
    script.write_text(
        "import os, signal\n"
        "from inhand.processes import WorkerPool\n"
        "def worker():\n"
        "    return lambda job: os.getpid()\n"
        "if __name__ == '__main__':\n"
        "    pool = WorkerPool(worker, 1)\n"
        "    print(*pool.map([0]), flush=True)\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    folder = tmp_path / "temporary"
    folder.mkdir()
    killed = subprocess.run(
        [sys.executable, script], env=os.environ | {"TMPDIR": str(folder)}, capture_output=True
    )
    assert killed.returncode == -signal.SIGKILL
    worker = int(killed.stdout)
    for _ in range(200):
        if not list(folder.iterdir()) and not Path(f"/proc/{worker}").exists():
            break
        time.sleep(0.05)
    else:
        pytest.fail("its worker or its file is still there")
