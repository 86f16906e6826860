"""What a robot with a depth camera records: images, camera info, and tf with a moving wrist."""

import numpy as np
from numpy.typing import NDArray
from ros_recording import (
    MS,
    OPTICAL,
    Messages,
    Sent,
)
from scipy.spatial.transform import Rotation, Slerp

from inhand.camera import Camera
from inhand.geometry.se3 import exp
from inhand.streams.config import StreamConfig
from inhand.streams.source import Frame, Source

CAMERA = Camera(60.0, 61.0, 15.5, 11.5, 32, 24)
START = 1_700_000_000 * 1000 * MS
FRAMES = 5
DEPTH, INFO = "/camera/depth/image_rect_raw", "/camera/depth/camera_info"
T_WORLD_CAMERA = exp(np.array([0.3, -0.2, 0.1, 0.5, 0.2, 1.0]))
T_WORLD_HAND = exp(np.array([[0.1, 0.9, -0.4, 0.6, 0.1, 1.4], [0.2, 0.5, -0.3, 0.7, 0.0, 1.3]]))
"""At the first and the last of the poses told."""
LATE = 7 * MS
"""From taking an image to recording it."""


def pixels(number: int) -> NDArray[np.uint16]:
    return (400 + number + np.arange(24 * 32).reshape(24, 32) % 50).astype(np.uint16)


def image_time(number: int) -> int:
    return START + (10 + 33 * number) * MS


def true_pose(time_ns: int) -> NDArray[np.float64]:
    """The wrist in the world, told every 50 ms along a way from the first to the last pose."""
    share = (time_ns - START) / (200 * MS)
    T = np.eye(4)
    way = Slerp([0, 1], Rotation.from_matrix(T_WORLD_HAND[:, :3, :3]))
    T[:3, :3] = way(share).as_matrix()
    T[:3, 3] = (1 - share) * T_WORLD_HAND[0, :3, 3] + share * T_WORLD_HAND[1, :3, 3]
    return T


def images(make: Messages, topic: str = DEPTH) -> list[Sent]:
    times = [image_time(i) for i in range(FRAMES)]
    return [Sent(topic, t + LATE, make.image(pixels(i), t)) for i, t in enumerate(times)]


def camera_info(make: Messages, topic: str = INFO) -> list[Sent]:
    return [Sent(topic, START, make.camera_info(CAMERA))]


def tf(make: Messages, hand: str = "palm") -> list[Sent]:
    camera = make.transforms(("world", OPTICAL, T_WORLD_CAMERA, 0))
    moving = [
        Sent("/tf", t + 60 * MS, make.transforms(("world", hand, true_pose(t), t)))
        for t in range(START, START + 201 * MS, 50 * MS)
    ]
    return [Sent("/tf_static", START, camera), *moving]


def everything(make: Messages) -> list[Sent]:
    chatter = Sent("/chatter", START, make.text("hello"))
    return [chatter, *images(make), *camera_info(make), *tf(make)]


CONFIG = StreamConfig(root_link="palm")


def frames(source: Source) -> list[Frame]:
    return [arrival.decode() for arrival in source.arrivals()]


def check_wrist(found: list[Frame]) -> None:
    for frame in found:
        assert frame.T_camera_hand is not None, frame.problem
        expected = np.linalg.inv(T_WORLD_CAMERA) @ true_pose(frame.time_ns)
        np.testing.assert_allclose(frame.T_camera_hand, expected, atol=1e-6)
