"""A RealSense camera as a source; `pyrealsense2` is needed only here."""

from collections.abc import Iterator
from functools import partial
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.errors import InputError
from inhand.streams.bag import BagKind
from inhand.streams.config import StreamConfig
from inhand.streams.given_camera import check_fits
from inhand.streams.source import Arrival, Frame

FRAME_ID = "camera_depth_optical_frame"
"""Name of the camera's coordinate frame, as its ROS driver calls it."""
NS_PER_MS = 1e6


class RealSense:
    """A live RealSense camera; see `source.Source`.

    The driver keeps only the newest image: those that come while one is being processed are
    dropped, and counted by the numbers that the camera gives its images.

    Args:
        serial: serial number of the camera; empty for the only one.
        config: size, frame rate and the wrist's constant pose.

    Raises:
        InputError: the driver or the camera is missing, the wrist's pose is not given, or the
            camera in `config` is of other images.
    """

    count: int | None = None
    kind: BagKind | None = None

    def __init__(self, serial: str, config: StreamConfig) -> None:
        if config.T_camera_hand is None:
            raise InputError(
                "a camera does not tell the wrist's pose: give --hand-pose FILE (for a wrist that "
                "does not move against the camera)"
            )
        rs = _driver()
        self.name = f"realsense:{serial}" if serial else "realsense"
        self._T_camera_hand = config.T_camera_hand
        self._patience_ms = round(1000 * config.patience)
        self._pipeline = rs.pipeline()
        try:
            profile = self._pipeline.start(_wishes(rs, serial, config))
        except RuntimeError as error:
            raise InputError(
                f"cannot start the camera {self.name}: {error}. Is it plugged in and not in use? "
                f"Asked for depth of {config.size[0]} x {config.size[1]} pixels at "
                f"{config.frame_rate:g} Hz"
            ) from error
        try:
            own = _read_camera(rs, profile)
            given = config.camera
            self._camera = own if given is None else check_fits(given, own, "its own calibration")
        except InputError:
            self.close()
            raise
        self.description = (
            f"depth: {self.name}, {self._camera.width} x {self._camera.height} pixels",
            f"camera: {'as given' if config.camera else 'its own calibration'}",
            "wrist: as given, the same for all images",
        )

    def arrivals(self) -> Iterator[Arrival]:
        """See `source.Source.arrivals`."""
        last: int | None = None
        while True:
            image = self._newest()
            number = int(image.get_frame_number())
            if number == last:
                continue
            # A camera that starts anew counts from the beginning.
            dropped = number - last - 1 if last is not None and number > last else 0
            last = number
            time_ns = round(image.get_timestamp() * NS_PER_MS)
            # The driver reuses its memory, so the pixels are copied before the next image.
            counts = np.array(image.get_data(), dtype=np.uint16)
            yield Arrival(time_ns, partial(self._frame, number, time_ns, counts), dropped)

    def close(self) -> None:
        """See `source.Source.close`."""
        self._pipeline.stop()

    def _newest(self) -> Any:
        try:
            return self._pipeline.wait_for_frames(self._patience_ms).get_depth_frame()
        except RuntimeError as error:
            raise InputError(f"the camera {self.name} sends nothing any more: {error}") from error

    def _frame(self, number: int, time_ns: int, counts: NDArray[np.uint16]) -> Frame:
        depth = (counts * self._camera.depth_unit).astype(np.float32)
        return Frame(str(number), time_ns, FRAME_ID, self._camera, depth, self._T_camera_hand)


def _driver() -> ModuleType:
    try:
        import pyrealsense2
    except ImportError as error:
        raise InputError(
            "a RealSense camera needs its driver: pip install 'inhand[realsense]' "
            f"(pyrealsense2: {error})"
        ) from error
    return pyrealsense2


def _wishes(rs: Any, serial: str, config: StreamConfig) -> Any:
    wishes = rs.config()
    if serial:
        wishes.enable_device(serial)
    rate = round(config.frame_rate)
    wishes.enable_stream(rs.stream.depth, *config.size, rs.format.z16, rate)
    return wishes


def _read_camera(rs: Any, profile: Any) -> Camera:
    """Intrinsics and depth unit as the camera tells them; its depth images have no distortion."""
    lens = profile.get_stream(rs.stream.depth).as_video_stream_profile().get_intrinsics()
    unit = profile.get_device().first_depth_sensor().get_depth_scale()
    return Camera(
        lens.fx, lens.fy, lens.ppx, lens.ppy, lens.width, lens.height, round(float(unit), 9)
    )
