from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import tiny_urdf
from hand_view import CAMERA, seen, wrist
from held_object import Q, built_in_hand, held_object

from inhand.config import HandStateConfig, ObservationConfig
from inhand.geometry.mesh import box
from inhand.geometry.se3 import exp
from inhand.hand import Hand
from inhand.kernels.depth import DepthRenderer
from inhand.packed import PackedHand
from inhand.stages.finger_search import FingerSearch
from inhand.stages.hand_visibility import Support, hand_support, nearest_around
from inhand.stages.observation import Observation, observe

CONFIG = HandStateConfig()


def search_of(observation: Observation, config: HandStateConfig = CONFIG) -> FingerSearch:
    return FingerSearch(observation, built_in_hand(), config)


def best(search: FingerSearch, T_camera_hand: np.ndarray) -> np.ndarray:
    """The joint vector of every finger's best configuration."""
    q = np.zeros(4)
    found, _ = search.alternatives(T_camera_hand, np.random.default_rng(0))
    for finger, configurations in zip(built_in_hand().hand.fingers, found, strict=True):
        q[list(finger.joints)] = configurations[0]
    return q


def support_of(observation: Observation, q: np.ndarray, T_camera_hand: np.ndarray) -> Support:
    hand = built_in_hand()
    links = hand.link_poses(q[None], T_camera_hand[None])[0]
    return hand_support(observation, hand, links, CONFIG)


def certain(observation: Observation, q: np.ndarray, T_camera_hand: np.ndarray) -> np.ndarray:
    """Whether the image supports each of the four finger links, finger by finger, shape (2, 2)."""
    support = support_of(observation, q, T_camera_hand).links
    links = [finger.links for finger in built_in_hand().hand.fingers]
    return np.asarray(support[np.array(links)] > CONFIG.certain_support)


def hand_pose(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Joints and wrist of a hand that shows both its fingers."""
    rng = np.random.default_rng(seed)
    T = wrist(rng.normal(0, 0.4, 3).tolist(), 0.6, 0.1)
    return rng.uniform([0.2, 0.1, 0.2, 0.1], [1.3, 1.2, 1.3, 1.2]), T


@pytest.mark.parametrize("seed", range(8))
def test_the_joints_of_an_empty_hand_are_found(seed: int) -> None:
    q, T = hand_pose(seed)
    observation = seen(built_in_hand(), q, T)
    np.testing.assert_allclose(best(search_of(observation), T), q, atol=0.15)
    assert certain(observation, q, T).all()


@pytest.mark.parametrize("name", ["cuboid", "industrial_part", "cylinder"])
def test_the_joints_around_an_object_are_found(name: str) -> None:
    scene = held_object(name)
    T = scene.hand_state.T_camera_hand
    np.testing.assert_allclose(best(search_of(scene.observation), T), Q, atol=0.15)


@pytest.mark.parametrize(("distance", "step"), [(0.0, 3), (0.004, 4), (0.01, 4), (0.01, 1)])
def test_the_least_depth_around(distance: float, step: int) -> None:
    q, T = hand_pose(0)
    observation = seen(built_in_hand(), q, T)
    coarse = observation.camera.subsampled(step)
    found = nearest_around(observation, distance, step).reshape(coarse.height, coarse.width)
    radius = round(distance * observation.camera.fx / observation.sphere[0][2] / step)
    depth = np.where(observation.depth > 0, observation.depth, np.inf)
    for v, u in np.random.default_rng(0).integers(0, found.shape, (200, 2)):
        low, high = np.array([v, u]) - radius, np.array([v, u]) + radius + 1
        rows, columns = (slice(max(a, 0) * step, b * step) for a, b in zip(low, high, strict=True))
        assert found[v, u] == depth[rows, columns].min()


def test_fingers_are_found_though_the_wrist_is_a_little_off() -> None:
    found = []
    for seed in range(40):
        q, T = hand_pose(seed)
        observation = seen(built_in_hand(), q, T)
        rng = np.random.default_rng(seed)
        turned = T @ exp(np.array([*rng.normal(0, 0.03, 3), 0, 0, 0]))
        alternatives, _ = search_of(observation).alternatives(turned, rng)
        for finger, one in zip(built_in_hand().hand.fingers, alternatives, strict=True):
            off = np.abs(one - q[list(finger.joints)]).max(axis=1).min()
            found.append(off < 0.2)
    assert np.mean(found) > 0.88


def test_alternatives_are_few_and_possible_and_repeatable() -> None:
    scene = held_object("cuboid")
    hand, T = scene.hand.hand, scene.hand_state.T_camera_hand
    search = search_of(scene.observation, replace(CONFIG, alternatives=3))
    (found, allowed), (again, _) = (
        search.alternatives(T, np.random.default_rng(1)) for _ in range(2)
    )
    assert len(found) == len(hand.fingers) == len(allowed)
    for finger, configurations, same, more in zip(hand.fingers, found, again, allowed, strict=True):
        joints = list(finger.joints)
        assert more.joints.shape == (CONFIG.allowed, len(joints))
        assert (np.diff(more.score) <= 0).all()
        assert 1 <= len(configurations) <= 3
        assert configurations.shape[1] == len(joints)
        assert (configurations >= hand.lower[joints]).all()
        assert (configurations <= hand.upper[joints]).all()
        np.testing.assert_array_equal(configurations, same)


def long_finger(folder: Path) -> PackedHand:
    """A palm with a finger of four joints, of which the first spreads it."""
    limits = '<limit lower="-0.3" upper="1.6" effort="1" velocity="1"/>'
    bone, names = '<box size="0.016 0.014 0.036"/>', ("a", "b", "c", "d")
    links = [tiny_urdf.link(name, bone, '<origin xyz="0 0 0.02"/>') for name in names]
    joints = [
        tiny_urdf.joint(f"to_{child}", parent, child, inside=limits, axis=axis, xyz="0 0 0.04")
        for parent, child, axis in zip(
            ("palm", *names[:3]), names, ("0 1 0", *3 * ["1 0 0"]), strict=True
        )
    ]
    palm = tiny_urdf.link("palm", '<box size="0.08 0.03 0.08"/>')
    return PackedHand(Hand.from_urdf(tiny_urdf.write(folder, palm, *links, *joints)), "cpu")


def test_alternatives_of_a_finger_of_many_joints_are_not_neighbours(tmp_path: Path) -> None:
    hand = long_finger(tmp_path)
    for seed in range(6):
        rng = np.random.default_rng(seed)
        T, q = wrist(rng.normal(0, 0.4, 3).tolist(), 0.6, 0.1), rng.uniform(0, 1.2, 4)
        search = FingerSearch(seen(hand, q, T), hand, CONFIG)
        (found,), _ = search.alternatives(T, rng)
        assert len(found) == CONFIG.alternatives
        # 2,048 configurations of four joints are a seventh of the range apart: 0.28.
        for one, other in combinations(found, 2):
            assert np.abs(one - other).max() > 0.28


@pytest.mark.parametrize("missing", [0, 1])
@pytest.mark.parametrize("bent", [(1.4, 0.3), (1.6, 0.8), (1.8, 0.2), (2.2, 0.1), (1.05, 0.0)])
def test_a_finger_does_not_claim_the_readings_of_another(
    missing: int, bent: tuple[float, float]
) -> None:
    """Only one finger is there, where the other one could be as well."""
    hand = built_in_hand()
    links = hand.hand.fingers[missing].links
    q, (_, T) = np.array([*bent, *bent]), hand_pose(1)
    observation = seen(hand, q, T, without=links)
    found = best(search_of(observation), T)
    there = list(hand.hand.fingers[1 - missing].joints)
    np.testing.assert_allclose(found[there], q[there], atol=0.15)
    assert not certain(observation, found, T)[missing].any()
    assert certain(observation, found, T)[1 - missing].all()


@pytest.mark.parametrize("hidden", [0, 1])
def test_a_hidden_finger_has_no_support(hidden: int) -> None:
    hand = built_in_hand()
    q, T = hand_pose(0)
    # A board in front of the half of the image that shows this finger.
    tips = hand.link_poses(q[None], T[None])[0, [f.links[-1] for f in hand.hand.fingers], 0, 3]
    side = np.sign(tips[hidden] - tips[1 - hidden])
    board = exp(np.array([0, 0, 0, 0.8 * tips.mean() + side * 0.2, 0, 0.45]))
    observation = seen(hand, q, T, others=[(box([0.4, 0.6, 0.002]), board)])
    assert not certain(observation, q, T)[hidden].any()
    assert certain(observation, q, T)[1 - hidden].all()
    assert certain(seen(hand, q, T), q, T).all()


def test_a_finger_at_a_wrong_place_has_no_support() -> None:
    q, T = hand_pose(2)
    observation = seen(built_in_hand(), q, T)
    np.testing.assert_array_equal(certain(observation, q + [0.5, 0, 0, 0], T), [[0, 0], [1, 1]])


def test_the_whole_hand_has_support_where_it_is() -> None:
    q, T = hand_pose(2)
    observation = seen(built_in_hand(), q, T)
    right = support_of(observation, q, T).whole
    errors = exp(np.array([[0, 0, 0, 0, 0.02, 0], [0, 0, 0, 0.05, 0, 0], [0, 0, 1.0, 0, 0, 0]]))
    wrong = [support_of(observation, q, T @ error).whole for error in errors]
    assert max(wrong) < right - 0.2


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_hand_whose_fingers_are_elsewhere_is_there(seed: int) -> None:
    q, T = hand_pose(seed)
    hand, observation = built_in_hand().hand, seen(built_in_hand(), q, T)
    elsewhere = np.where(q > (hand.lower + hand.upper) / 2, hand.lower, hand.upper)
    assert not certain(observation, elsewhere, T).any()
    assert support_of(observation, elsewhere, T).whole > CONFIG.min_hand_support
    turned = T @ exp(np.array([0, 0, 1.0, 0, 0, 0]))
    assert support_of(observation, q, turned).whole < CONFIG.min_hand_support


@pytest.mark.parametrize("seed", range(6))
def test_a_hand_of_which_most_is_too_near_for_the_sensor_is_there(seed: int) -> None:
    q, T = hand_pose(seed)
    hand = built_in_hand()
    posed = hand.link_poses(q[None], T[None])[0]
    depth, link = DepthRenderer([x.mesh for x in hand.hand.links]).render(CAMERA, posed)

    def support_in(depth: np.ndarray) -> float:
        reach, config = hand.hand.reach, ObservationConfig()
        observation = observe(depth, CAMERA, T, reach, 0.05, config, "cpu")
        return support_of(observation, q, T).whole

    near = depth < np.quantile(depth[link >= 0], 0.7)
    assert support_in(np.where(near, np.float32(0), depth)) > CONFIG.min_hand_support
    # A hole in a wall, with the hand's outline, is no hand.
    hole = np.where(link >= 0, np.float32(0), np.float32(0.75))
    assert support_in(hole) < CONFIG.min_hand_support


def test_the_best_of_every_finger_is_combined() -> None:
    q, T = hand_pose(3)
    starts = np.tile(q, (3, 1)) + [[0, 0, 0.3, 0.1], [0.3, -0.1, 0, 0], [0.4, 0.2, -0.3, 0.2]]
    wrists = np.repeat(T[None], 3, axis=0)
    combined, wrist_found = search_of(seen(built_in_hand(), q, T)).best_combination(starts, wrists)
    np.testing.assert_array_equal(combined, q)
    np.testing.assert_array_equal(wrist_found, T)
