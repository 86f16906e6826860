"""The pipeline as a whole: repeatable, free of state, for hands of any build."""

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import FrozenInstanceError, fields, replace
from functools import cache
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest
import tiny_urdf

from inhand import EstimatorConfig, Hand, PoseEstimate, PoseEstimator
from inhand.builtin.hand import write_hand
from inhand.camera import Camera
from inhand.errors import InputError
from inhand.estimator import StageResults
from inhand.evaluation.hand_errors import wrist_error
from inhand.evaluation.metrics import ObjectMetric
from inhand.geometry.se3 import check_rigid, exp
from inhand.kernels import launch as seam
from inhand.kernels.depth import DepthRenderer
from inhand.synth.demo import builtin_object
from inhand.synth.scene import Scene
from inhand.urdf import read_urdf

STAGES = [
    "observation",
    "wrist",
    "hand_state",
    "segmentation",
    "evidence",
    "hypotheses",
    "clustering",
    "refinement",
    "pruning",
    "selection",
]
CONFIGS = {"default": EstimatorConfig(), "paper": EstimatorConfig.paper()}


def make(scene: Scene, config: EstimatorConfig | None = None) -> PoseEstimator:
    return PoseEstimator(scene.hand, scene.obj, config, "cpu")


@pytest.fixture(scope="module", params=CONFIGS)
def config(request: pytest.FixtureRequest) -> EstimatorConfig:
    return CONFIGS[request.param]


@pytest.fixture(scope="module")
def scene(scenes: list[Scene]) -> Scene:
    """The one that most tests look at."""
    return scenes[3]


@pytest.fixture(scope="module")
def estimator(scene: Scene, config: EstimatorConfig) -> PoseEstimator:
    return make(scene, config)


@pytest.fixture(scope="module")
def first(estimator: PoseEstimator, scene: Scene) -> PoseEstimate:
    """The first answer of a new estimator."""
    return estimate(estimator, scene)


def estimate(estimator: PoseEstimator, scene: Scene) -> PoseEstimate:
    """At half the resolution, to be quick."""
    return estimator.estimate(
        scene.depth[::2, ::2], scene.camera.subsampled(2), scene.T_camera_hand_given
    )


def assert_same(one: Any, other: Any) -> None:
    """Equal to the last bit, but for the timings."""
    if isinstance(one, PoseEstimate):
        names = [f.name for f in fields(one) if f.name != "timings"]
        one, other = ([getattr(e, name) for name in names] for e in (one, other))
    if isinstance(one, Sequence) and not isinstance(one, str):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)
    elif hasattr(one, "scores"):
        assert_same([one.T_camera_object, one.scores], [other.T_camera_object, other.scores])
    elif isinstance(one, np.ndarray):
        np.testing.assert_array_equal(one, other)
    else:
        assert one == other


class DeadlyDepth:
    """A depth image that ends the process that reads it."""

    def __array__(self, *_args: Any, **_options: Any) -> NoReturn:
        os._exit(1)


@pytest.mark.parametrize("workers", [1, 2])
def test_a_batch_has_the_same_answers(
    scenes: list[Scene], scene: Scene, estimator: PoseEstimator, first: PoseEstimate, workers: int
) -> None:
    images = [
        (depth[::2, ::2], scene.camera.subsampled(2), scene.T_camera_hand_given)
        for depth in (scene.depth, 0 * scene.depth, scenes[7].depth, scene.depth)
    ]
    found = estimator.estimate_batch(iter(images), workers)
    assert_same([found[0], found[3]], [first, first])
    assert not found[1].found
    assert_same(found[2], estimator.estimate(*images[2]))
    assert estimator.estimate_batch([], workers) == []
    with pytest.raises(InputError, match="depth"):
        estimator.estimate_batch([images[0], (None, *images[0][1:])], workers)
    assert_same(estimator.estimate_batch(images[:1], workers), [first])


FIRST_IMAGES = """
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from inhand import PoseEstimator
from inhand.synth.demo import regression_scenes

scenes = regression_scenes()[:4]
estimators = [PoseEstimator(scene.hand, scene.obj, device="cpu") for scene in scenes]

def pose(i):
    scene = scenes[i]
    image = scene.depth[::2, ::2], scene.camera.subsampled(2), scene.T_camera_hand_given
    return estimators[i].estimate(*image).T_camera_object

with ThreadPoolExecutor(4) as pool:
    together = list(pool.map(pose, range(4)))
np.testing.assert_array_equal(together, [pose(i) for i in range(4)])
"""


def test_threads_may_estimate_the_first_images_of_a_process(scenes: list[Scene]) -> None:
    """They meet kernels that are not loaded yet at the same time; `scenes` has compiled them."""
    assert subprocess.run([sys.executable, "-c", FIRST_IMAGES]).returncode == 0


@pytest.mark.parametrize("workers", [0, 1.5, "all", True])
def test_a_batch_needs_a_number_of_workers(estimator: PoseEstimator, workers: Any) -> None:
    with pytest.raises(InputError, match="workers must be a"):
        estimator.estimate_batch([], workers)


def test_a_batch_goes_on_after_a_worker_died(
    scene: Scene, estimator: PoseEstimator, first: PoseEstimate
) -> None:
    image = scene.depth[::2, ::2], scene.camera.subsampled(2), scene.T_camera_hand_given
    with pytest.raises(InputError, match="worker process died"):
        estimator.estimate_batch([(DeadlyDepth(), *image[1:])], 2)
    assert_same(estimator.estimate_batch([image], 2), [first])


# Repeatable


def test_same_seed_same_answer(scene: Scene, config: EstimatorConfig, first: PoseEstimate) -> None:
    assert first.found
    assert_same(estimate(make(scene, config), scene), first)


def test_no_state_is_left_by_other_frames(
    scenes: list[Scene], scene: Scene, estimator: PoseEstimator, first: PoseEstimate
) -> None:
    for other in (scenes[7], replace(scene, depth=0 * scene.depth)):
        estimate(estimator, other)
    assert_same(estimate(estimator, scene), first)


@pytest.mark.parametrize("threads", [1, 3, 8])
def test_same_answer_on_any_number_of_threads(
    scene: Scene,
    estimator: PoseEstimator,
    first: PoseEstimate,
    threads: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(seam, "cpu_count", lambda: threads)
    monkeypatch.setattr(seam, "_idle_threads", cache(seam._idle_threads.__wrapped__))
    monkeypatch.setattr(seam, "HANDOVER_OPERATIONS", 25)
    assert_same(estimate(estimator, scene), first)


def test_same_answer_from_any_kind_of_array(scene: Scene) -> None:
    camera, T = scene.camera.subsampled(4), scene.T_camera_hand_given
    depth = scene.depth[::4, ::4].copy()
    estimator = make(scene)
    first = estimator.estimate(depth, camera, T)
    for same in (
        np.asfortranarray(depth.astype(">f8")),
        depth.tolist(),
        np.where(depth == 0, np.nan, depth),
        np.where(depth == 0, -np.inf, depth),
        np.ma.masked_array(np.where(depth == 0, 0.4, depth), depth == 0),
    ):
        assert_same(estimator.estimate(same, camera, T.tolist()), first)


def test_input_is_left_alone(scene: Scene) -> None:
    depth, T = scene.depth[::2, ::2].copy(), scene.T_camera_hand_given.copy()
    for array in (depth, T):
        array.flags.writeable = False
    assert make(scene).estimate(depth, scene.camera.subsampled(2), T).found


# The answer


def test_answer_is_complete(scene: Scene, config: EstimatorConfig, first: PoseEstimate) -> None:
    answer = first
    assert answer.found
    assert answer.reason == ""
    assert 0 < answer.confidence <= 1
    after = ["missed_fingers"] if config.second_look.left_explained < 1 else []
    assert list(answer.timings) == STAGES + after
    assert min(answer.timings.values()) >= 0
    assert set(answer.joint_positions) == set(scene.joint_positions)
    check_rigid(answer.T_camera_hand, "T_camera_hand")
    np.testing.assert_array_equal(answer.candidates[0].T_camera_object, answer.T_camera_object)
    assert 1 < len(answer.candidates) <= 100
    for candidate in answer.candidates:
        check_rigid(candidate.T_camera_object, "candidate")
    scores = [candidate.scores["score"] for candidate in answer.candidates]
    assert scores == sorted(scores, reverse=True)
    with pytest.raises(FrozenInstanceError):
        answer.confidence = 1.0  # type: ignore[misc]


def test_candidates_are_distinct_and_no_more_than_asked_for(scene: Scene) -> None:
    config = EstimatorConfig()
    every = estimate(make(scene, config), scene).candidates
    poses = [candidate.T_camera_object for candidate in every]
    metric = ObjectMetric(scene.obj)
    for i, pose in enumerate(poses):
        assert all(metric.add(other, pose) > 0.0005 for other in poses[:i])
    config = replace(config, selection=replace(config.selection, candidates=2))
    assert len(every) > 2
    assert_same(estimate(make(scene, config), scene).candidates, every[:2])


def test_another_seed_finds_the_same_pose(scene: Scene) -> None:
    metric = ObjectMetric(scene.obj)
    for seed in (1, 2):
        answer = estimate(make(scene, EstimatorConfig(seed=seed)), scene)
        assert answer.T_camera_object is not None
        assert metric.adi(answer.T_camera_object, scene.T_camera_object) < 0.005


def test_what_every_stage_returned(
    scene: Scene, estimator: PoseEstimator, first: PoseEstimate
) -> None:
    answer, results = estimator.run(
        scene.depth[::2, ::2], scene.camera.subsampled(2), scene.T_camera_hand_given
    )
    assert_same(answer, first)
    for field in fields(StageResults):
        assert getattr(results, field.name) is not None
    for stage in ("hypotheses", "clustered", "refined", "pruned", "selection"):
        poses = getattr(results, stage)
        assert poses.T_camera_object.shape == (len(poses.score), 4, 4)
        assert np.isfinite(poses.score).all()


def test_stages_that_were_not_reached(scene: Scene) -> None:
    depth, _ = DepthRenderer([link.mesh for link in scene.hand.links], "cpu").render(
        scene.camera,
        scene.T_camera_hand
        @ scene.hand.forward_kinematics(scene.hand.joint_vector(scene.joint_positions)),
    )
    answer, results = make(scene).run(depth, scene.camera, scene.T_camera_hand)
    assert not answer.found
    assert list(answer.timings) == STAGES[:4]
    assert results.hand_state is not None
    assert results.segment is None
    assert results.selection is None
    assert answer.T_camera_hand is not None
    assert wrist_error(answer.T_camera_hand, scene.T_camera_hand).translation < 0.003


# Hands of any build


def parallel_gripper(folder: Path) -> Hand:
    """One prismatic joint, and a second one that mimics it."""

    def jaw(name: str, side: int, inside: str) -> list[str]:
        limit = '<limit lower="0" upper="0.045"/>'
        return [
            tiny_urdf.link(
                name, '<box size="0.01 0.02 0.08"/>', '<origin xyz="0 0 0.04" rpy="0 0 0"/>'
            ),
            tiny_urdf.joint(
                f"{name}_slide",
                "palm",
                name,
                "prismatic",
                limit + inside,
                xyz=f"{0.05 * side} 0 0.02",
                axis=f"{-side} 0 0",
            ),
        ]

    palm = tiny_urdf.link("palm", '<box size="0.14 0.06 0.03"/>')
    return Hand.from_urdf(
        tiny_urdf.write(
            folder, palm, *jaw("left", 1, ""), *jaw("right", -1, '<mimic joint="left_slide"/>')
        )
    )


def three_finger_hand(folder: Path) -> Hand:
    """Three fingers of two joints around a round palm; the third one's far joint is a mimic."""
    limit = '<limit lower="-0.3" upper="1.2"/>'
    bone, middle = '<box size="0.014 0.018 0.05"/>', '<origin xyz="0 0 0.025"/>'
    parts = [tiny_urdf.link("palm", '<cylinder radius="0.05" length="0.03"/>')]
    for i in range(3):
        angle = 2 * np.pi * i / 3
        foot = f"{0.04 * np.cos(angle)} {0.04 * np.sin(angle)} 0.015"
        follow = '<mimic joint="near_joint2" multiplier="0.5" offset="0.1"/>' if i == 2 else ""
        parts += [
            tiny_urdf.link(f"near{i}", bone, middle),
            tiny_urdf.link(f"far{i}", bone, middle),
            tiny_urdf.joint(
                f"near_joint{i}", "palm", f"near{i}", inside=limit, xyz=foot,
                rpy=f"0 0 {angle}", axis="0 -1 0",
            ),
            tiny_urdf.joint(
                f"far_joint{i}", f"near{i}", f"far{i}", inside=limit + follow, xyz="0 0 0.052",
                axis="0 -1 0",
            ),
        ]  # fmt: skip
    return Hand.from_urdf(tiny_urdf.write(folder, *parts))


def one_finger_without_a_palm(folder: Path) -> Hand:
    """The root link has no shape, and the only joint turns without end."""
    return Hand.from_urdf(
        tiny_urdf.write(
            folder,
            tiny_urdf.link("palm", None),
            tiny_urdf.link("finger", '<box size="0.02 0.015 0.1"/>', '<origin xyz="0 0 0.05"/>'),
            tiny_urdf.joint("turn", "palm", "finger", "continuous", inside=""),
        )
    )


@pytest.mark.parametrize("number", [2, 6])
def test_a_joint_that_moves_no_shape_changes_nothing(
    scenes: list[Scene], number: int, tmp_path: Path
) -> None:
    """In the URDF of a hand whose sensor turns, that joint may come before those of the fingers."""
    scene = scenes[number]
    urdf = write_hand(tmp_path)
    start = '<robot name="adaptive_hand">'
    sensor = tiny_urdf.link("sensor", None) + tiny_urdf.joint("pan", "palm", "sensor")
    urdf.write_text(urdf.read_text().replace(start, start + sensor))
    hand = Hand.from_urdf(urdf)
    assert hand.joint_names == ("pan", *scene.hand.joint_names)
    plain, found = (
        estimate(PoseEstimator(h, scene.obj, device="cpu"), scene) for h in (scene.hand, hand)
    )
    angles = {name: q for name, q in found.joint_positions.items() if name != "pan"}
    assert_same(replace(found, joint_positions=angles), plain)


BUILDS: list[tuple[Callable[[Path], Hand], list[float]]] = [
    (parallel_gripper, [0.03]),
    (three_finger_hand, [-0.2, 0.5, -0.2, 0.6, -0.2]),
    (one_finger_without_a_palm, [0.3]),
]
CAMERA = Camera(300, 300, 159.5, 119.5, width=320, height=240)


@pytest.mark.parametrize(("build", "q"), BUILDS)
@pytest.mark.parametrize("turn", [(2.0, 0.3, 0.2), (-1.6, 0.2, 0.9)])
def test_hands_of_any_build(
    tmp_path: Path,
    config: EstimatorConfig,
    build: Callable[[Path], Hand],
    q: list[float],
    turn: tuple[float, float, float],
) -> None:
    hand, obj = build(tmp_path), builtin_object("cuboid")
    T_camera_hand = exp(np.array([*turn, 0, 0, 0]))
    T_camera_hand[:3, 3] = [0, 0, 0.45] - T_camera_hand[:3, :3] @ hand.reach[0]
    T_camera_object = T_camera_hand @ exp(np.array([0.2, 0.1, 0.5, 0, 0, 0.09]))
    poses = [*(T_camera_hand @ hand.forward_kinematics(q)), T_camera_object]
    meshes = [*(link.mesh for link in hand.links), obj.mesh]
    depth, _ = DepthRenderer(meshes, "cpu").render(CAMERA, np.stack(poses))
    answer = PoseEstimator(hand, obj, config, "cpu").estimate(depth, CAMERA, T_camera_hand)
    assert answer.T_camera_object is not None
    check_rigid(answer.T_camera_object, "T_camera_object")
    assert tuple(answer.joint_positions) == hand.all_joint_names
    found = hand.joint_vector(answer.joint_positions)  # also checks that mimic joints agree
    assert ((hand.lower <= found) & (found <= hand.upper)).all()
    limits = {joint.name: joint for joint in read_urdf(tmp_path / "hand.urdf").joints}
    for name, position in answer.joint_positions.items():
        assert limits[name].lower <= position <= limits[name].upper
    if config == EstimatorConfig() and build is not one_finger_without_a_palm:
        assert ObjectMetric(obj).adi(answer.T_camera_object, T_camera_object) < 0.003
        assert np.median(np.abs(found - q)) < 0.03  # some joints may not be seen
