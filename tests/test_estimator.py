"""The pipeline as a whole: repeatable, free of state, for hands of any build."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import FrozenInstanceError, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tiny_urdf

from inhand import EstimatorConfig, Hand, ObjectModel, PoseEstimate, PoseEstimator
from inhand.camera import Camera
from inhand.estimator import StageResults
from inhand.evaluation.metrics import ObjectMetric, wrist_error
from inhand.geometry.se3 import check_rigid, exp
from inhand.kernels import launch as seam
from inhand.kernels.depth import DepthRenderer
from inhand.synth.demo import builtin_object
from inhand.synth.scene import Scene

STAGES = (
    "observation wrist hand_state segmentation evidence hypotheses clustering refinement pruning "
    "selection"
).split()
CONFIGS = {"default": EstimatorConfig(), "paper": EstimatorConfig.paper()}


@pytest.fixture(params=CONFIGS)
def config(request: pytest.FixtureRequest) -> EstimatorConfig:
    return CONFIGS[request.param]


def make(scene: Scene, config: EstimatorConfig | None = None) -> PoseEstimator:
    return PoseEstimator(scene.hand, scene.obj, config, "cpu")


def estimate(estimator: PoseEstimator, scene: Scene) -> PoseEstimate:
    """At half the resolution, to be quick."""
    return estimator.estimate(
        scene.depth[::2, ::2], scene.camera.subsampled(2), scene.T_camera_hand_given
    )


def assert_same(one: Any, other: Any) -> None:
    """Equal to the last bit, but for the timings."""
    if isinstance(one, PoseEstimate):
        one, other = ([getattr(e, f.name) for f in fields(e)[:-1]] for e in (one, other))
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


# Repeatable


def test_same_seed_same_answer(scenes: list[Scene], config: EstimatorConfig) -> None:
    scene = scenes[3]
    estimator = make(scene, config)
    first = estimate(estimator, scene)
    assert first.found
    assert_same(estimate(estimator, scene), first)
    assert_same(estimate(make(scene, config), scene), first)


def test_no_state_is_left_by_other_frames(scenes: list[Scene], config: EstimatorConfig) -> None:
    scene = scenes[3]
    estimator = make(scene, config)
    first = estimate(estimator, scene)
    for other in (scenes[7], scenes[0], replace(scene, depth=0 * scene.depth)):
        estimate(estimator, other)
    assert_same(estimate(estimator, scene), first)


@pytest.mark.parametrize("threads", [1, 3, 8])
def test_same_answer_on_any_number_of_threads(
    scenes: list[Scene], config: EstimatorConfig, threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = scenes[3]
    estimator = make(scene, config)
    first = estimate(estimator, scene)
    with ThreadPoolExecutor(threads) as pool:
        monkeypatch.setattr(seam, "_pool", lambda: pool)
        monkeypatch.setattr(seam, "cpu_count", lambda: threads)
        monkeypatch.setattr(seam, "SLICED_FROM_OPERATIONS", 100)
        assert_same(estimate(estimator, scene), first)


def test_same_answer_from_any_kind_of_array(scenes: list[Scene]) -> None:
    scene = scenes[3]
    camera, T = scene.camera.subsampled(2), scene.T_camera_hand_given
    depth = scene.depth[::2, ::2].copy()
    estimator = make(scene)
    first = estimator.estimate(depth, camera, T)
    for same in (
        depth.astype(np.float64),
        np.asfortranarray(depth),
        depth.astype(">f4"),
        depth.tolist(),
        np.where(depth == 0, np.nan, depth),
        np.where(depth == 0, np.inf, depth),
        np.ma.masked_array(np.where(depth == 0, 0.4, depth), depth == 0),
    ):
        assert_same(estimator.estimate(same, camera, T.tolist()), first)


def test_input_is_left_alone(scenes: list[Scene]) -> None:
    depth, T = scenes[3].depth[::2, ::2].copy(), scenes[3].T_camera_hand_given.copy()
    for array in (depth, T):
        array.flags.writeable = False
    assert make(scenes[3]).estimate(depth, scenes[3].camera.subsampled(2), T).found


# The answer


def test_answer_is_complete(scenes: list[Scene], config: EstimatorConfig) -> None:
    scene = scenes[3]
    answer = estimate(make(scene, config), scene)
    assert answer.found
    assert answer.reason == ""
    assert 0 < answer.confidence <= 1
    assert list(answer.timings) == STAGES
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


def test_candidates_are_as_many_as_asked_for_and_distinct(scenes: list[Scene]) -> None:
    scene = scenes[0]
    config = EstimatorConfig()
    config = replace(config, selection=replace(config.selection, candidates=4))
    answer = estimate(make(scene, config), scene)
    assert len(answer.candidates) == 4
    metric = ObjectMetric(scene.obj)
    poses = [candidate.T_camera_object for candidate in answer.candidates]
    for i, pose in enumerate(poses):
        assert all(metric.add(other, pose) > 0.0005 for other in poses[:i])


def test_another_seed_finds_the_same_pose(scenes: list[Scene]) -> None:
    scene = scenes[3]
    metric = ObjectMetric(scene.obj)
    for seed in (1, 2, 3):
        answer = estimate(make(scene, EstimatorConfig(seed=seed)), scene)
        assert answer.T_camera_object is not None
        assert metric.adi(answer.T_camera_object, scene.T_camera_object) < 0.005


def test_what_every_stage_returned(scenes: list[Scene], config: EstimatorConfig) -> None:
    scene = scenes[3]
    arguments = scene.depth[::2, ::2], scene.camera.subsampled(2), scene.T_camera_hand_given
    estimator = make(scene, config)
    answer, results = estimator.run(*arguments)
    assert_same(answer, estimator.estimate(*arguments))
    for field in fields(StageResults):
        assert getattr(results, field.name) is not None
    for stage in ("hypotheses", "clustered", "refined", "pruned", "selection"):
        poses = getattr(results, stage)
        assert poses.T_camera_object.shape == (len(poses.score), 4, 4)
        assert np.isfinite(poses.score).all()


def test_stages_that_were_not_reached(scenes: list[Scene]) -> None:
    scene = scenes[0]
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


HANDS = {
    "gripper": (parallel_gripper, [0.03]),
    "three fingers": (three_finger_hand, [0.4, 0.5, 0.3, 0.6, 0.5]),
    "one finger": (one_finger_without_a_palm, [0.3]),
}


@pytest.mark.parametrize("name", HANDS)
@pytest.mark.parametrize("view", [0, 1, 2])
def test_hands_of_any_build(
    tmp_path: Path, config: EstimatorConfig, name: str, view: int
) -> None:
    build, joints = HANDS[name]
    hand, obj, q = build(tmp_path), builtin_object("cuboid"), np.array(joints)
    T_camera_hand = exp(np.array([[2.0, 0.3, 0.2], [1.7, -0.6, 0.4], [-1.6, 0.2, 0.9]][view] + 3 * [0.0]))
    T_camera_hand[:3, 3] = [0, 0, 0.45] - T_camera_hand[:3, :3] @ hand.reach[0]
    T_camera_object = T_camera_hand @ exp(np.array([0.2, 0.1, 0.5, 0.0, 0.0, 0.09]))
    depth = render(hand, obj, q, T_camera_hand, T_camera_object)
    answer = PoseEstimator(hand, obj, config, "cpu").estimate(depth, CAMERA, T_camera_hand)
    assert answer.found
    print(answer.confidence, answer.joint_positions, ObjectMetric(obj).adi(answer.T_camera_object, T_camera_object))


CAMERA = Camera(300, 300, 159.5, 119.5, width=320, height=240)


def render(hand: Hand, obj: ObjectModel, q: np.ndarray, T_camera_hand: np.ndarray, T_camera_object: np.ndarray) -> np.ndarray:
    meshes = [*(link.mesh for link in hand.links), obj.mesh]
    poses = [*(T_camera_hand @ hand.forward_kinematics(q)), T_camera_object]
    return DepthRenderer(meshes, "cpu").render(CAMERA, np.stack(poses))[0]
