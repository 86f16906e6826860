"""Fixtures shared by all tests."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from inhand.synth.demo import regression_scenes
from inhand.synth.scene import Scene

# The same examples every time, however slow the machine is.
settings.register_profile("inhand", derandomize=True, deadline=None)
settings.load_profile("inhand")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The development data (hands, objects, frames), which live outside the repository."""
    beside = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("INHAND_SHARED", beside))
    if not folder.is_dir():
        pytest.skip("the development data are not here; set INHAND_SHARED to their folder")
    return folder


@pytest.fixture(scope="session")
def scenes() -> list[Scene]:
    """Eight fixed scenes of the project's own hand and objects."""
    return regression_scenes()


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Ctrl-C raises KeyboardInterrupt, also where the tests run in the background of a shell."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
