"""Fixed scenes of the project's own hand and objects: the demo, and a set to test accuracy on.

Poses and joint positions are written down instead of drawn, so that these scenes stay the same
when the way random scenes are drawn changes. Only sensor and wrist errors come from a seed.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from inhand.builtin.hand import write_hand
from inhand.builtin.objects import OBJECTS
from inhand.camera import Camera
from inhand.geometry import se3
from inhand.hand import Hand
from inhand.object_model import ObjectModel
from inhand.synth.grasp import Grasp
from inhand.synth.scene import CLEAN, NOISY, Scene, SceneMaker, SceneProtocol, with_errors

CAMERA = Camera(fx=615.0, fy=615.0, cx=319.5, cy=239.5, width=640, height=480)
"""The camera of all fixed scenes."""

Six = tuple[float, float, float, float, float, float]


class FixedScene(NamedTuple):
    """A scene in numbers; poses are rotation vector [rad] and translation [m]."""

    object_name: str
    protocol: SceneProtocol
    hand_object: Six
    """T_hand_object."""
    q: tuple[float, float, float, float]
    """Proximal and distal joint of finger 1, then of finger 2 [rad]."""
    camera_hand: Six
    """T_camera_hand."""


DEMO = FixedScene(
    "industrial_part",
    NOISY,
    (-0.2385, 0.7334, -2.3035, -0.0320, -0.0050, 0.1457),
    (1.4004, 0.2465, 0.2619, 0.2013),
    (1.8821, 0.7102, -0.4654, 0.0000, 0.0963, 0.4051),
)

REGRESSION = (
    FixedScene(
        "cylinder",
        CLEAN,
        (2.4639, -1.1343, 0.0222, -0.0068, -0.0096, 0.1282),
        (1.2826, 0.4286, 1.1308, 0.0212),
        (1.1404, -0.7742, 0.4515, 0.0668, 0.0652, 0.4427),
    ),
    FixedScene(
        "ellipsoid",
        CLEAN,
        (1.5542, 0.4087, -1.7188, -0.0062, 0.0074, 0.1410),
        (1.3196, 0.1249, 0.9856, 0.2129),
        (-1.6760, -1.0779, 1.0395, 0.1098, -0.0099, 0.4234),
    ),
    FixedScene(
        "cuboid",
        NOISY,
        (0.4611, 1.1216, 1.2144, -0.0147, -0.0045, 0.1472),
        (1.2161, 0.0021, 0.5069, 0.8430),
        (-2.4265, -0.0027, 0.7234, 0.0678, -0.0460, 0.7057),
    ),
    FixedScene(
        "industrial_part",
        CLEAN,
        (0.1429, -1.1270, 0.8039, 0.0266, 0.0032, 0.1490),
        (0.4220, 0.5786, 1.2557, 0.8987),
        (-2.1053, 0.4800, -2.0810, -0.0735, 0.0220, 0.5745),
    ),
    FixedScene(
        "bottle",
        NOISY,
        (-1.7523, 1.8411, -1.3706, -0.0357, -0.0076, 0.1668),
        (1.3919, 0.0095, 0.2437, 0.3236),
        (0.8481, 0.8887, -0.7829, -0.0157, 0.0800, 0.6217),
    ),
    FixedScene(
        "can",
        CLEAN,
        (1.2225, 2.2354, 1.8124, 0.0086, 0.0241, 0.1370),
        (0.8065, 0.0193, 0.7092, 0.7308),
        (0.5425, -0.7666, 0.4248, 0.0258, 0.0319, 0.5390),
    ),
    FixedScene(
        "can",
        NOISY,
        (1.7617, 0.3150, -0.4066, 0.0122, -0.0320, 0.1550),
        (0.6322, 0.6460, 0.9268, 0.8732),
        (1.6175, -1.2057, 1.4697, -0.0515, 0.0954, 0.3669),
    ),
    FixedScene(
        "industrial_part",
        NOISY,
        (-0.3341, -0.2284, 0.1562, -0.0253, -0.0166, 0.1582),
        (1.1796, 0.7406, 0.3433, 0.1791),
        (-0.4395, -2.1231, -1.1143, 0.0564, -0.1020, 0.6124),
    ),
)
"""All six objects; visible shares from 0.4 to 1, half of them with sensor noise."""


def demo_scene(device: str = "cpu") -> Scene:
    """An industrial part, partly behind a finger, seen by a structured-light camera."""
    return _build(DEMO, seed=0, device=device)


def regression_scenes(device: str = "cpu") -> list[Scene]:
    """Eight scenes for the accuracy regression test."""
    return [_build(fixed, seed, device) for seed, fixed in enumerate(REGRESSION)]


@cache
def builtin_hand() -> Hand:
    """The project's own hand."""
    with TemporaryDirectory() as folder:
        return Hand.from_urdf(write_hand(Path(folder)))


@cache
def builtin_object(name: str) -> ObjectModel:
    """One of the project's own objects, by its name in `OBJECTS`."""
    return replace(ObjectModel.from_mesh(OBJECTS[name]()), name=name)


def _build(fixed: FixedScene, seed: int, device: str) -> Scene:
    rng = np.random.default_rng(seed)
    grasp = Grasp(se3.exp(np.array(fixed.hand_object)), np.array(fixed.q))
    hand, obj = builtin_hand(), builtin_object(fixed.object_name)
    maker = SceneMaker(hand, obj, CAMERA, fixed.protocol, device=device)
    scene = maker.render(grasp, se3.exp(np.array(fixed.camera_hand)), rng)
    return with_errors(scene, fixed.protocol, rng)
