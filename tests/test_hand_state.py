from dataclasses import replace

import numpy as np
import pytest
from hand_view import off_by, seen, wrist
from held_object import CAMERA, HeldObject, Q, built_in_hand, held_object
from reference_depth import plane_depth

from inhand.config import HandStateConfig, ObservationConfig, WristConfig
from inhand.errors import NoAnswer
from inhand.geometry.mesh import box
from inhand.geometry.se3 import exp
from inhand.stages.hand_state import estimate_hand_state
from inhand.stages.observation import Observation, observe
from inhand.stages.results import HandState, Wrist


def estimated(observation: Observation, T_camera_hand: np.ndarray, seed: int = 0) -> HandState:
    return estimate_hand_state(
        replace(observation, T_camera_hand=T_camera_hand),
        Wrist(T_camera_hand),
        built_in_hand(),
        HandStateConfig(),
        WristConfig(),
        np.random.default_rng(seed),
    )


def wrong_wrist(scene: HeldObject) -> np.ndarray:
    """The true wrist, off by some millimetres and a degree."""
    error = np.array([0.01, -0.015, 0.01, 0.002, -0.003, 0.002])
    return np.asarray(scene.hand_state.T_camera_hand @ exp(error))


@pytest.mark.parametrize("name", ["cuboid", "industrial_part", "ellipsoid"])
def test_joints_and_wrist_are_found_around_an_object(name: str) -> None:
    scene = held_object(name)
    state = estimated(scene.observation, wrong_wrist(scene))
    np.testing.assert_allclose(state.joint_vector, Q, atol=0.06)
    distance, angle = off_by(state.T_camera_hand, scene.hand_state.T_camera_hand)
    assert distance < 0.002
    assert angle < 0.6
    assert state.certain.all()


def test_the_links_are_where_joints_and_wrist_put_them() -> None:
    scene = held_object("cuboid")
    state = estimated(scene.observation, wrong_wrist(scene))
    expected = state.T_camera_hand @ scene.hand.hand.forward_kinematics(state.joint_vector)
    np.testing.assert_allclose(state.T_camera_link, expected, atol=1e-12)
    assert (state.joint_vector >= scene.hand.hand.lower).all()
    assert (state.joint_vector <= scene.hand.hand.upper).all()


def test_the_same_seed_gives_the_same_state_to_the_bit() -> None:
    scene = held_object("cuboid")
    one, again = (estimated(scene.observation, wrong_wrist(scene), seed=3) for _ in range(2))
    np.testing.assert_array_equal(one.joint_vector, again.joint_vector)
    np.testing.assert_array_equal(one.T_camera_hand, again.T_camera_hand)


def test_a_finger_that_is_not_there_is_not_certain() -> None:
    hand, T = built_in_hand(), wrist(distance=0.6, height=0.1)
    links = list(hand.hand.fingers[1].links)
    state = estimated(seen(hand, Q, T, without=links), T)
    assert not state.certain[links].any()
    assert np.delete(state.certain, links).all()


@pytest.mark.parametrize("depth", [0.45, 0.7], ids=["in front", "behind"])
def test_a_hand_that_is_not_in_the_image_is_no_answer(depth: float) -> None:
    """A wall is there instead, in front of where the hand should be or behind it."""
    hand, T = built_in_hand(), wrist(distance=0.6, height=0.1)
    wall = (box([2.0, 2.0, 0.01]), exp(np.array([0, 0, 0, 0, 0, depth])))
    nothing = range(len(hand.hand.links))
    with pytest.raises(NoAnswer, match="does not show the hand"):
        estimated(seen(hand, Q, T, without=nothing, others=[wall]), T)


NOISE = 0.005 * np.random.default_rng(0).normal(size=(CAMERA.height, CAMERA.width))


def with_noise(depth: np.ndarray, T_camera_hand: np.ndarray) -> Observation:
    """An image of `held_object.CAMERA` with noise of 5 mm."""
    noisy = np.where(depth > 0, depth + NOISE, 0).astype(np.float32)
    reach = built_in_hand().hand.reach
    return observe(noisy, CAMERA, T_camera_hand, reach, 0.06, ObservationConfig(), "cpu")


def test_a_hand_that_is_seen_badly_is_there_still() -> None:
    scene = held_object("cuboid")
    T = scene.hand_state.T_camera_hand
    state = estimated(with_noise(scene.depth, T), T)
    distance, angle = off_by(state.T_camera_hand, T)
    assert distance < 0.004
    assert angle < 2


@pytest.mark.parametrize("behind", [-0.03, 0.03])
def test_a_noisy_wall_is_no_hand(behind: float) -> None:
    T = held_object("cuboid").hand_state.T_camera_hand
    wall = plane_depth(CAMERA, np.array([0, 0, 1.0]), T[2, 3] + behind)
    with pytest.raises(NoAnswer, match="does not show the hand"):
        estimated(with_noise(wall, T), T)
