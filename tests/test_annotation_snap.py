"""Snapping finds the truth from a bad start, and leaves alone what the image does not show."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labelling_data import true_label

from inhand.annotation.images import RawImage
from inhand.annotation.session import Label
from inhand.annotation.snap import SnapConfig, Snapper
from inhand.errors import InputError, NoAnswer
from inhand.evaluation.hand_errors import wrist_error
from inhand.geometry.se3 import exp, transform
from inhand.packed import PackedHand, PackedObject
from inhand.synth.scene import Scene

CYLINDER, ELLIPSOID, PART, CAN, NOISY_CAN = 0, 1, 3, 5, 6


def raw_image(scene: Scene) -> RawImage:
    return RawImage(scene.depth, scene.camera)


def snapper(scene: Scene) -> Snapper:
    return Snapper(PackedHand(scene.hand, "cpu"), PackedObject(scene.obj, "cpu"))


def displaced(scene: Scene, turn: np.ndarray, shift: np.ndarray) -> Label:
    """The truth, with the object turned about its centre [rad] and moved [m]."""
    label = true_label(scene)
    centre = transform(label.T_camera_object, scene.obj.centre[None])[0]
    move = exp(np.concatenate([turn, shift]))
    move[:3, 3] += centre - move[:3, :3] @ centre
    return replace(label, T_camera_object=move @ label.T_camera_object)


@pytest.mark.parametrize("number", [CYLINDER, ELLIPSOID, PART, CAN, NOISY_CAN])
@pytest.mark.parametrize("seed", range(3))
def test_the_object_is_found_from_a_bad_start(scenes: list[Scene], number: int, seed: int) -> None:
    rng, scene = np.random.default_rng(seed), scenes[number]
    directions = rng.normal(size=(2, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    start = displaced(scene, np.radians(20) * directions[0], 0.015 * directions[1])
    tool = snapper(scene)
    snapped = tool.snap_object(raw_image(scene), start)
    error = tool.metric.pose_error(snapped.T_camera_object, scene.T_camera_object)
    assert error.translation < 0.001
    assert np.degrees(error.rotation) < 1
    assert replace(snapped, T_camera_object=start.T_camera_object) == start


@pytest.mark.parametrize("number", [CYLINDER, PART])
def test_wrist_and_fingers_are_found_from_a_bad_start(scenes: list[Scene], number: int) -> None:
    scene = scenes[number]
    truth = true_label(scene)
    signs = (1, -1, -1, 1)
    joints = {
        name: position + sign * np.radians(8)
        for (name, position), sign in zip(truth.joint_positions.items(), signs, strict=True)
    }
    start = replace(
        truth,
        T_camera_hand=exp(np.array([0.02, -0.03, 0.02, 0.004, -0.003, 0.004]))
        @ truth.T_camera_hand,
        joint_positions=joints,
    )
    snapped = snapper(scene).snap_hand(raw_image(scene), start)
    wrist = wrist_error(snapped.T_camera_hand, truth.T_camera_hand)
    assert wrist.translation < 0.001
    assert np.degrees(wrist.rotation) < 0.3
    for name, position in snapped.joint_positions.items():
        assert position == pytest.approx(truth.joint_positions[name], abs=np.radians(1.5)), name
    np.testing.assert_array_equal(snapped.T_camera_object, start.T_camera_object)


def test_a_hidden_finger_stays_where_the_user_put_it(scenes: list[Scene]) -> None:
    scene = scenes[NOISY_CAN]
    first = scene.hand.fingers[0]
    assert not (scene.images.segmentation == 1 + first.links[-1]).any()
    truth = true_label(scene)
    snapped = snapper(scene).snap_hand(raw_image(scene), truth)
    for joint in first.joints:
        name = scene.hand.joint_names[joint]
        moved = abs(snapped.joint_positions[name] - truth.joint_positions[name])
        assert moved < SnapConfig().idle_way


@settings(max_examples=10)
@given(st.floats(-3.1, 3.1), st.sampled_from([0, 1]))
def test_of_poses_that_look_alike_the_nearest_is_kept(
    scenes: list[Scene], spin: float, flip: int
) -> None:
    scene = scenes[CYLINDER]
    symmetry = scene.obj.symmetry
    assert symmetry.axis is not None
    turn = np.eye(4)
    turn[:3, :3] = exp(np.concatenate([spin * symmetry.axis, np.zeros(3)]))[:3, :3]
    turn[:3, 3] = symmetry.centre - turn[:3, :3] @ symmetry.centre
    alike = scene.T_camera_object @ symmetry.rotations[flip] @ turn
    start = replace(true_label(scene), T_camera_object=alike)
    snapped = snapper(scene).snap_object(raw_image(scene), start)
    np.testing.assert_allclose(snapped.T_camera_object, alike, atol=0.012)


def test_snapping_again_gives_the_same(scenes: list[Scene]) -> None:
    start = displaced(scenes[PART], np.array([0.1, 0.2, -0.1]), np.array([0.005, 0.003, 0.008]))
    tool, raw = snapper(scenes[PART]), raw_image(scenes[PART])
    assert tool.snap_object(raw, start) == tool.snap_object(raw, start)
    assert tool.snap_hand(raw, start) == tool.snap_hand(raw, start)


def test_nothing_there_is_said(scenes: list[Scene]) -> None:
    scene, tool = scenes[PART], snapper(scenes[PART])
    away = displaced(scene, np.zeros(3), np.array([0.1, 0, 0]))
    with pytest.raises(NoAnswer, match="object where it is; move it closer"):
        tool.snap_object(raw_image(scene), away)
    T = scene.T_camera_hand.copy()
    T[0, 3] += 0.1
    with pytest.raises(NoAnswer, match="hand where it is; move it closer"):
        tool.snap_hand(raw_image(scene), replace(true_label(scene), T_camera_hand=T))
    empty = RawImage(np.zeros_like(scene.depth), scene.camera)
    for snap in (tool.snap_object, tool.snap_hand):
        with pytest.raises(NoAnswer, match="depth readings"):
            snap(empty, true_label(scene))


def test_parameters_are_checked() -> None:
    with pytest.raises(InputError, match="leash"):
        SnapConfig(leash=-1)
