"""A RealSense camera as a source, with a driver that the test makes up."""

import sys
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from any_stream import T_HAND, Kept, found

from inhand.camera import Camera
from inhand.errors import InputError
from inhand.streams.config import StreamConfig
from inhand.streams.open_source import open_source
from inhand.streams.runner import Counts, run

CONFIG = StreamConfig(T_camera_hand=T_HAND, size=(8, 6), frame_rate=15)


class Driver:
    """The part of pyrealsense2 that is used; `numbers` are those of the images it will give."""

    stream = SimpleNamespace(depth="depth")
    format = SimpleNamespace(z16="z16")

    def __init__(self, numbers: list[int]) -> None:
        self.numbers = numbers
        self.wishes: list[Any] = []
        self.started = self.stopped = 0
        self.fault = ""
        self.memory = np.zeros((6, 8), dtype=np.uint16)

    def config(self) -> Any:
        return SimpleNamespace(
            enable_device=lambda serial: self.wishes.append(serial),
            enable_stream=lambda *wish: self.wishes.append(wish),
        )

    def pipeline(self) -> Any:
        return SimpleNamespace(start=self.start, stop=self.stop, wait_for_frames=self.wait)

    def start(self, config: Any) -> Any:
        if self.fault:
            raise RuntimeError(self.fault)
        self.started += 1
        lens = SimpleNamespace(fx=9.0, fy=9.5, ppx=3.5, ppy=2.5, width=8, height=6)
        video = SimpleNamespace(get_intrinsics=lambda: lens)
        sensor = SimpleNamespace(get_depth_scale=lambda: np.float32(0.00025))
        return SimpleNamespace(
            get_stream=lambda kind: SimpleNamespace(as_video_stream_profile=lambda: video),
            get_device=lambda: SimpleNamespace(first_depth_sensor=lambda: sensor),
        )

    def stop(self) -> None:
        self.stopped += 1

    def wait(self, timeout_ms: int) -> Any:
        assert timeout_ms == 5000
        if not self.numbers:
            raise RuntimeError("Frame didn't arrive within 5000")
        number = self.numbers.pop(0)
        self.memory[:] = 1000 + number  # the driver reuses its memory
        image = SimpleNamespace(
            get_frame_number=lambda: number,
            get_timestamp=lambda: 1_700_000_000_000.25 + 66 * number,
            get_data=lambda: self.memory,
        )
        return SimpleNamespace(get_depth_frame=lambda: image)


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> Driver:
    driver = Driver([10, 11, 11, 14, 15, 3, 4])
    monkeypatch.setitem(sys.modules, "pyrealsense2", driver)
    return driver


def test_images_and_what_the_camera_tells(driver: Driver) -> None:
    source = open_source("realsense:1234", CONFIG)
    assert driver.wishes == ["1234", ("depth", 8, 6, "z16", 15)]
    assert source.count is None
    arrivals = source.arrivals()
    first, second = next(arrivals), next(arrivals)
    frame = first.decode()  # after the driver has reused its memory
    assert frame.depth is not None
    np.testing.assert_allclose(frame.depth, 1010 * 0.00025, rtol=1e-6)
    assert frame.camera.fx == 9.0
    assert frame.camera.cy == 2.5
    assert frame.camera.depth_unit == 0.00025
    assert frame.time_ns == pytest.approx(1_700_000_000_660_250_000, abs=1000)
    np.testing.assert_array_equal(frame.T_camera_hand, T_HAND)
    assert second.decode().name == "11"
    source.close()
    assert driver.stopped == 1


def test_dropped_images_are_counted_until_the_camera_is_gone(driver: Driver) -> None:
    """Number 11 comes twice, 12 and 13 never, and then the camera starts anew."""
    output, reports = Kept(), list[Counts]()
    source = open_source("realsense", CONFIG)
    with pytest.raises(InputError, match=r"sends nothing any more: Frame didn't arrive"):
        run(source, found, [output], report=reports.append)
    assert output.names == [10, 11, 14, 15, 3, 4]
    assert [r.dropped for r in output.results] == [0, 0, 2, 0, 0, 0]
    assert reports[-1] == Counts(processed=6, found=6, dropped=2)
    assert "sends nothing" in output.summaries[0].stopped


def test_limit_stops_a_camera(driver: Driver) -> None:
    output = Kept()
    run(open_source("realsense", CONFIG), found, [output], limit=2)
    assert output.names == [10, 11]


def test_no_camera(driver: Driver) -> None:
    driver.fault = "No device connected"
    with pytest.raises(InputError, match=r"cannot start.*No device connected.*8 x 6 pixels"):
        open_source("realsense", CONFIG)


def test_no_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(InputError, match=r"pip install 'inhand\[realsense\]'"):
        open_source("realsense", CONFIG)


def test_a_camera_does_not_tell_the_wrist(driver: Driver) -> None:
    with pytest.raises(InputError, match="give --hand-pose FILE"):
        open_source("realsense", StreamConfig())
    assert not driver.started


def test_another_camera_must_count_depth_as_this_one_does(driver: Driver) -> None:
    given = Camera(9.1, 9.6, 3.4, 2.4, 8, 6, depth_unit=0.00025)
    source = open_source("realsense", replace(CONFIG, camera=given))
    assert next(source.arrivals()).decode().camera == given
    millimetres = replace(CONFIG, camera=replace(given, depth_unit=0.001))
    with pytest.raises(InputError, match=r'write "depth_unit_m": 0\.00025 there'):
        open_source("realsense", millimetres)
    assert driver.stopped == 1
