"""Image sequences: motion without jumps, fingers that stay on the object, truth in every image."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from inhand.camera import Camera
from inhand.cli import main
from inhand.datasets import bop
from inhand.datasets.bop_images import read_image
from inhand.datasets.bop_scene import read_scene
from inhand.datasets.frames import find_frames, read_frame
from inhand.errors import InputError
from inhand.geometry import se3
from inhand.synth.demo import builtin_hand, builtin_object
from inhand.synth.motion import Leg, MotionProtocol, poses_along, time_stamps, wrist_errors
from inhand.synth.renderer import BACKGROUND_BODY, OBJECT_BODY
from inhand.synth.scene import CLEAN, SceneMaker
from inhand.synth.sequence import Sequence, SequenceMaker

CAMERA = Camera(150, 150, 79.5, 59.5, 160, 120)
MOTION = MotionProtocol(occluders=1.5)
NUMBER = 90
vectors = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array)


@pytest.fixture(scope="module")
def maker() -> SequenceMaker:
    protocol = replace(CLEAN, distance=(0.45, 0.6))
    scenes = SceneMaker(builtin_hand(), builtin_object("cuboid"), CAMERA, protocol)
    return SequenceMaker(scenes, MOTION)


@pytest.fixture(scope="module")
def sequence(maker: SequenceMaker) -> Sequence:
    return maker.plan(NUMBER, np.random.default_rng(3))


@given(vectors, vectors, vectors, vectors)
def test_legs_are_smooth_and_end_where_they_say(
    turn: np.ndarray, shift: np.ndarray, pivot: np.ndarray, place: np.ndarray
) -> None:
    T = se3.exp(np.concatenate([place, shift]))
    legs = [Leg(0.5, turn, shift), Leg(0.7, -turn, -shift)]
    times = np.linspace(0, 1.5, 301)
    poses = poses_along(T, pivot, legs, times)
    np.testing.assert_allclose(poses[0], T, atol=1e-9)
    np.testing.assert_allclose(poses[-1], T, atol=1e-9)  # there and back
    half = se3.transform(poses[100], pivot[None])[0] - se3.transform(T, pivot[None])[0]
    np.testing.assert_allclose(half, shift, atol=1e-9)
    # A minimum-jerk motion is at most 1.875 times as fast as it is on average.
    at = np.stack([se3.transform(pose, pivot[None])[0] for pose in poses])
    fastest = np.linalg.norm(np.diff(at, axis=0), axis=1).max() / times[1]
    assert fastest <= 1.876 * np.linalg.norm(shift) / 0.5 + 1e-9


def test_fingers_stay_on_an_object_that_moves(maker: SequenceMaker, sequence: Sequence) -> None:
    grasps = maker._scenes.grasps
    moved = np.linalg.norm(np.ptp(sequence.T_hand_object[:, :3, 3], axis=0))
    assert moved > 0.004
    for finger in grasps.hand.fingers:
        gaps = grasps.object_gaps(sequence.T_hand_object, sequence.q, finger.links, 10**6)
        assert np.abs(gaps).max() < 0.0007  # samples and voxels see an edge no better
    palm = grasps.hand.palm_links
    assert grasps.object_gaps(sequence.T_hand_object, sequence.q, palm, 10**6).min() > 0


def test_nothing_jumps(sequence: Sequence) -> None:
    frames = np.diff(sequence.times) * MOTION.rate
    step = np.linalg.norm(np.diff(sequence.T_camera_hand[:, :3, 3], axis=0), axis=1) / frames
    assert step.max() < 0.02
    turn = se3.rotation_angle(
        sequence.T_hand_object[1:, :3, :3], sequence.T_hand_object[:-1, :3, :3]
    )
    assert (turn / frames).max() < np.radians(8)


def test_frames_are_dropped_as_often_as_asked() -> None:
    times = time_stamps(4000, MotionProtocol(dropped=0.1), np.random.default_rng(0))
    steps = np.rint(np.diff(times) * 30)
    np.testing.assert_allclose(steps / 30, np.diff(times), atol=1e-9)
    assert steps.min() == 1
    assert 0.08 < 1 - 4000 / (times[-1] * 30 + 1) < 0.12
    assert (np.diff(time_stamps(50, MotionProtocol(dropped=0), np.random.default_rng(0))) > 0).all()


def test_the_given_wrist_is_off_in_place_and_in_turn(sequence: Sequence) -> None:
    p, true, told = CLEAN, sequence.T_camera_hand, sequence.T_camera_hand_given
    place = np.linalg.norm((told - true)[:, :3, 3], axis=1)
    turn = se3.rotation_angle(told[:, :3, :3], true[:, :3, :3])
    for error, sd in ((place, p.wrist_translation), (turn, p.wrist_rotation)):
        assert 0.3 * sd < error.min() < error.max() < 5 * sd


def test_wrist_errors_are_a_constant_with_a_slow_drift_and_a_small_jitter() -> None:
    times = np.arange(300) / 30
    many = np.stack(
        [
            wrist_errors(times, 0.004, 0.026, MotionProtocol(), np.random.default_rng(seed))
            for seed in range(200)
        ]
    )
    sd = np.array([0.026] * 3 + [0.004] * 3)
    whole = np.sqrt(1 + 0.3**2 + 0.03**2)
    np.testing.assert_allclose(many.std(axis=(0, 1)) / sd, whole, rtol=0.15)
    step = np.diff(many, axis=1).std(axis=(0, 1)) / sd
    drift = 0.3 * np.sqrt(2 * (1 - np.exp(-1 / 90)))
    np.testing.assert_allclose(step, np.hypot(drift, np.sqrt(2) * 0.03), rtol=0.05)


def test_occluders_come_and_go(maker: SequenceMaker, sequence: Sequence) -> None:
    shares, others = [], []
    for i in range(0, NUMBER, 2):
        scene = maker.render(sequence, i, np.random.default_rng(i))
        shares.append(scene.visible_share)
        others.append(np.count_nonzero(scene.images.segmentation == BACKGROUND_BODY))
        visible = scene.images.segmentation == OBJECT_BODY
        np.testing.assert_allclose(
            scene.depth[visible], scene.images.object_depth[visible], atol=1e-4
        )
    assert len(sequence.occluders.time) > 0
    assert min(others) == 0
    assert max(others) > 200
    assert min(shares) < 0.5 * max(shares)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "moving"
    assert synth(folder, tmp_path_factory.mktemp("camera") / "camera.json", "--workers", "1") == 0
    return folder


def synth(folder: Path, camera: Path, *more: str) -> int:
    names = ("fx", "fy", "cx", "cy", "width", "height")
    camera.write_text(json.dumps({name: getattr(CAMERA, name) for name in names}))
    options = ["--sequence", "--rate", "20", "--objects", "can", "--number", "10", "--seed", "4"]
    more = (*more, "--device", "cpu", "--camera", str(camera), "--distance", "0.4", "0.6")
    return main(["synth", str(folder), *options, *more])


def test_a_scene_is_a_sequence_with_time_stamps(dataset: Path) -> None:
    scenes = sorted((dataset / bop.SPLIT).iterdir())
    assert len(scenes) == 2
    for scene in scenes:
        images = [read_image(scene, i) for i in sorted(read_scene(scene).truth)]
        times = np.array([image.time for image in images])
        assert times[0] == 0
        np.testing.assert_allclose(np.rint(np.diff(times) * 20), np.diff(times) * 20, atol=1e-9)
        wrists = [image.hand.T_camera_hand[:3, 3] for image in images if image.hand is not None]
        assert np.linalg.norm(np.diff(wrists, axis=0), axis=1).max() < 0.05
        assert len(np.unique(images[0].depth)) > 2
        assert images[0].instances[0].visible_share >= 0.35
    frames = [read_frame(path) for path in find_frames([dataset])]
    assert [frame.time for frame in frames[:10]] == times.tolist() or len(frames) == 20


def test_the_order_of_the_images_changes_no_byte(dataset: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    assert synth(again, tmp_path / "camera.json", "--workers", "2") == 0
    for file in sorted(dataset.rglob("*.png")) + sorted(dataset.rglob("scene_*.json")):
        assert file.read_bytes() == (again / file.relative_to(dataset)).read_bytes()


def test_a_benchmark_runs_on_a_sequence(dataset: Path, tmp_path: Path) -> None:
    command = ["bench", str(dataset), "--out", str(tmp_path), "--limit", "2", "--device", "cpu"]
    assert main([*command, "--methods", "icp-from-truth+mask@0mm"]) == 0


@pytest.mark.parametrize("bad", [("--rate", "0"), ("--rest", "1.2"), ("--rest", "nan")])
def test_a_motion_that_makes_no_sense_is_refused(
    bad: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert synth(tmp_path / "bad", tmp_path / "camera.json", *bad) == 2
    assert "rest" in capsys.readouterr().err


def test_a_broken_time_stamp_is_refused(dataset: Path) -> None:
    scene = sorted((dataset / bop.SPLIT).iterdir())[0]
    path = scene / bop.CAMERA
    text = path.read_text()
    try:
        path.write_text(text.replace('"time": 0.0', '"time": "now"', 1))
        with pytest.raises(InputError, match="time"):
            read_image(scene, 0)
    finally:
        path.write_text(text)
