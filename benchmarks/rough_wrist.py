"""What a configuration for a badly known wrist is worth, and what it costs.

    python benchmarks/rough_wrist.py [FRAMES ...]

First on 36 scenes of the built-in hand: six of each built-in object, with structured-light errors
and a wall behind, at least a fifth of the object visible. The given wrist is the true one, moved by
exactly so much in a random direction and turned by exactly so much about a random axis.

Then, where folders of frames are named, on every second of their frames: as they are; with a wall
instead of the hand, all of whose pixels get the hand's median depth, or 3 cm less or more; and with
the given wrist moved by 6 cm. An answer is right when its ADI is below 5 mm.
"""

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import numpy as np
from numpy.typing import NDArray

from inhand import EstimatorConfig, Hand, ObjectModel, PoseEstimator
from inhand.builtin.objects import OBJECTS
from inhand.camera import Camera
from inhand.config import WristConfig
from inhand.datasets.frames import (
    LABEL_HAND,
    find_frames,
    load_object,
    need_hand,
    need_objects,
    read_frame,
)
from inhand.evaluation.metrics import ObjectMetric
from inhand.geometry.se3 import exp
from inhand.synth.demo import CAMERA, builtin_hand, builtin_object
from inhand.synth.scene import NOISY, SceneMaker

SCENES = 6
"""Scenes of every object."""
OFFSETS = ((0.001, 0.3), (0.005, 2.0), (0.010, 4.0), (0.020, 8.0), (0.030, 12.0))
"""How far the given wrist is off [m, degrees]."""
WALLS = (0.0, -0.03, 0.03)
"""How far behind the hand's median depth the wall stands [m]."""
LOST = 0.06
"""How far the wrist is off that no longer shows the hand [m]."""
RIGHT = 0.005
"""ADI of a right answer is below this [m]."""
ROUGH = WristConfig(
    prior_sd_translation=0.010,
    prior_sd_rotation=0.06,
    search_sd_translation=0.012,
    search_sd_rotation=0.08,
    samples=512,
    starts=9,
)
"""As in examples/05_tune_the_config.py."""
CONFIGS = {"default": EstimatorConfig(), "rough wrist": replace(EstimatorConfig(), wrist=ROUGH)}


@dataclass(frozen=True, eq=False)
class Case:
    """An image with a wrist, and what is true."""

    kind: str
    """What was done to it."""
    depth: NDArray[np.float32]
    camera: Camera
    T_camera_hand: NDArray[np.float64]
    """The wrist pose that is given, shape (4, 4)."""
    hand: Hand
    obj: ObjectModel
    T_camera_object: NDArray[np.float64]
    """True pose, shape (4, 4)."""


def direction(rng: np.random.Generator) -> NDArray[np.float64]:
    """A random unit vector, shape (3,)."""
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def scenes() -> Iterator[Case]:
    """The scenes, at every offset of the wrist."""
    protocol = replace(NOISY, visible=(0.2, 1.0))
    for name in OBJECTS:
        maker = SceneMaker(builtin_hand(), builtin_object(name), CAMERA, protocol)
        for seed in range(SCENES):
            scene = maker.make(np.random.default_rng([7, seed]))
            rng = np.random.default_rng([8, seed])
            way, axis = direction(rng), direction(rng)
            for metres, degrees in OFFSETS:
                moved = scene.T_camera_hand @ exp(np.r_[np.radians(degrees) * axis, metres * way])
                moved[:3, 3] = scene.T_camera_hand[:3, 3] + metres * way
                kind = f"{1000 * metres:.0f} mm, {degrees:g} degrees"
                truth = scene.T_camera_object
                yield Case(kind, scene.depth, CAMERA, moved, scene.hand, scene.obj, truth)


def frames(folders: list[Path]) -> Iterator[Case]:
    """Every second frame, as it is, without the hand, and with a wrist that is somewhere else."""
    hand = Hand.from_urdf(need_hand(folders[0]))
    objects = need_objects(folders[0])
    for number, path in enumerate(find_frames(folders)[::2]):
        frame = read_frame(path)
        given, truth = frame.T_camera_hand_given, frame.truth.T_camera_object
        obj = load_object(objects, frame.object_name)
        plain = Case("as it is", frame.depth, frame.camera, given, hand, obj, truth)
        yield plain
        is_hand = frame.truth.label == LABEL_HAND
        for behind in WALLS:
            depth = frame.depth.copy()
            depth[is_hand] = np.median(depth[is_hand & (depth > 0)]) + behind
            yield replace(plain, kind="a wall instead of the hand", depth=depth)
        moved = given.copy()
        moved[:3, 3] += LOST * direction(np.random.default_rng([9, number]))
        yield replace(plain, kind="the wrist 6 cm off", T_camera_hand=moved)


def measure(cases: Iterable[Case]) -> None:
    """Print what becomes of the cases, kind by kind."""
    rows: dict[tuple[str, str], list[tuple[bool, bool, float, float]]] = {}
    estimators: dict[tuple[str, str], PoseEstimator] = {}
    for case in cases:
        metric = ObjectMetric(case.obj)
        for name, config in CONFIGS.items():
            key = (name, case.obj.name)
            if key not in estimators:
                estimators[key] = PoseEstimator(case.hand, case.obj, config)
                estimators[key].estimate(case.depth, case.camera, case.T_camera_hand)  # warm
            start = process_time()
            e = estimators[key].estimate(case.depth, case.camera, case.T_camera_hand)
            time = process_time() - start
            T = e.T_camera_object
            right = T is not None and metric.adi(T, case.T_camera_object) < RIGHT
            rows.setdefault((case.kind, name), []).append((e.found, right, e.confidence, time))
    for (kind, name), results in rows.items():
        found, right, confidence, time = map(np.array, zip(*results, strict=True))
        print(
            f"{kind}; {name}: {right.sum()} of {len(found)} right, {(~found).sum()} refused, "
            f"{(confidence > 0.9).sum()} above 0.9 of which {(right & (confidence > 0.9)).sum()} "
            f"right; {1000 * np.median(time):.0f} ms of CPU time (median)",
            flush=True,
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("frames", type=Path, nargs="*")
    args = parser.parse_args()
    measure(scenes())
    if args.frames:
        measure(frames(args.frames))
