"""The page's worker: one job at a time, the latest of its kind, and no end by a failure."""

import threading
from collections.abc import Iterator
from functools import partial

import pytest

from inhand.errors import InputError
from inhand.viewer.worker import Worker


@pytest.fixture
def told() -> list[str]:
    return []


@pytest.fixture
def worker(told: list[str]) -> Iterator[Worker]:
    worker = Worker(told.append)
    yield worker
    worker.stop()


def test_what_was_overtaken_is_dropped(worker: Worker) -> None:
    gate, done = threading.Event(), list[str]()
    worker.submit("block", gate.wait)
    for i in range(5):
        worker.submit("draw", partial(done.append, str(i)))
    worker.submit("other", lambda: done.append("other"))
    gate.set()
    assert worker.wait(10)
    assert done == ["4", "other"]


def test_jobs_run_in_one_thread(worker: Worker) -> None:
    threads: set[int] = set()
    for i in range(10):
        worker.submit(str(i), lambda: threads.add(threading.get_ident()))
    assert worker.wait(10)
    assert len(threads) == 1
    assert threading.get_ident() not in threads


def test_a_failure_is_told_and_the_next_job_done(
    worker: Worker, told: list[str], caplog: pytest.LogCaptureFixture
) -> None:
    def fail(error: Exception) -> None:
        raise error

    done: list[int] = []
    worker.submit("a", lambda: fail(InputError("the file is missing")))
    worker.submit("b", lambda: fail(ZeroDivisionError("by nothing")))
    worker.submit("c", lambda: done.append(1))
    assert worker.wait(10)
    assert told == ["the file is missing", "ZeroDivisionError: by nothing"]
    assert done == [1]
    assert "Traceback" in caplog.text  # of what is not the user's mistake
    assert "the file is missing" not in caplog.text


def test_waiting_ends() -> None:
    worker, gate = Worker(lambda message: None), threading.Event()
    worker.submit("block", gate.wait)
    assert not worker.wait(0.01)
    gate.set()
    worker.stop()


def test_stopping_drops_what_has_not_begun() -> None:
    worker, gate, begun = Worker(print), threading.Event(), threading.Event()
    done: list[int] = []

    def block() -> None:
        begun.set()
        gate.wait()

    worker.submit("block", block)
    worker.submit("draw", lambda: done.append(1))
    assert begun.wait(10)
    threading.Timer(0.1, gate.set).start()
    worker.stop()
    assert done == []
