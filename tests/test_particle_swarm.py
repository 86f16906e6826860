from dataclasses import replace

import numpy as np
import pytest
from held_object import HeldObject, Q, held_object
from scipy.spatial import cKDTree

from inhand.config import HandStateConfig
from inhand.geometry.se3 import inverse, transform
from inhand.hand import Finger
from inhand.stages.particle_swarm import FingerCost, minimise, search_fingers
from inhand.stages.results import Wrist

CONFIG = HandStateConfig(method="swarm")
SCENE = "cuboid"


def valley(x: np.ndarray) -> np.ndarray:
    """Smallest at (0.5, -0.2)."""
    return np.asarray(((x - [0.5, -0.2]) ** 2 * [1, 10]).sum(axis=1))


def test_the_swarm_descends_within_the_limits() -> None:
    seen: list[np.ndarray] = []

    def cost(x: np.ndarray) -> np.ndarray:
        seen.append(x)
        return valley(x)

    lower, upper = np.array([-1.0, -0.5]), np.array([2.0, 1.0])
    config = replace(CONFIG, generations=20)
    best = minimise(cost, lower, upper, config, np.random.default_rng(0))
    assert [x.shape for x in seen] == [(15, 2)] * 21
    assert all((x >= lower).all() and (x <= upper).all() for x in seen)
    assert valley(best[None])[0] == min(valley(x).min() for x in seen)
    np.testing.assert_allclose(best, [0.5, -0.2], atol=0.02)


def test_the_minimum_may_lie_on_a_limit() -> None:
    config = replace(CONFIG, generations=20)
    best = minimise(
        valley, np.array([0.8, 0.0]), np.array([2.0, 1.0]), config, np.random.default_rng(0)
    )
    np.testing.assert_allclose(best, [0.8, 0.0], atol=0.01)


def finger_cost(scene: HeldObject) -> FingerCost:
    wrist = Wrist(scene.hand_state.T_camera_hand)
    return FingerCost(scene.observation, wrist, scene.hand, CONFIG)


def finger_surface(
    scene: HeldObject, finger: Finger, q: np.ndarray
) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Link, points and normals, camera frame, of every link of a finger."""
    poses = scene.hand.link_poses(q[None], scene.hand_state.T_camera_hand[None])[0]
    surfaces = []
    for i in finger.links:
        surface = scene.hand.hand.links[i].surface
        surfaces.append(
            (i, transform(poses[i], surface.points), surface.normals @ poses[i, :3, :3].T)
        )
    return surfaces


@pytest.mark.parametrize("finger_index", [0, 1])
def test_the_cost_counts_finger_points_on_the_scene(finger_index: int) -> None:
    scene = held_object(SCENE)
    finger = scene.hand.hand.fingers[finger_index]
    joints = list(finger.joints)
    particles = Q[joints] + np.array([[0, 0], [0.05, -0.1], [0.3, 0.2], [-0.4, 0.5]])
    tree = cKDTree(scene.observation.points)
    expected = []
    for particle in particles:
        q = Q.copy()
        q[joints] = particle
        lcp = 0
        for _, points, normals in finger_surface(scene, finger, q):
            distance, nearest = tree.query(points)
            cosine = (normals * scene.observation.normals[nearest]).sum(axis=1)
            agree = cosine > np.cos(CONFIG.lcp_normal_angle)
            lcp += int(((distance < CONFIG.lcp_distance) & agree).sum())
        expected.append(-lcp)
    assert min(expected) < -100
    found = finger_cost(scene)(finger, Q, [], particles)
    np.testing.assert_allclose(found, expected, atol=1)  # a point may lie on a threshold


def test_penetration_of_placed_links_is_penalised_linearly() -> None:
    """The finger on the right lies across the palm and the finger on the left."""
    scene = held_object(SCENE)
    hand = scene.hand.hand
    left, right = hand.fingers
    placed = [*hand.palm_links, *left.links]
    particles = np.array([[2.6, 1.0], [2.2, 1.5], [1.9, 0.3], [0.0, 0.0]])
    found = finger_cost(scene)(right, Q, placed, particles)
    expected = []
    for particle in particles:
        q = Q.copy()
        q[list(right.joints)] = particle
        poses = scene.hand.link_poses(q[None], scene.hand_state.T_camera_hand[None])[0]
        depths = [0.0]
        for link, points, _ in finger_surface(scene, right, q):
            # The proximal link overlaps the palm in its hinge.
            others = list(left.links) if link == right.links[0] else placed
            depths += [
                -hand.links[i].distance_field.distance(transform(inverse(poses[i]), points)).min()
                for i in others
            ]
        expected.append(max(depths))
    colliding = np.array(expected) > CONFIG.collision_distance
    assert colliding.tolist() == [True, True, True, False]
    penalty = CONFIG.collision_penalty * (1 + np.array(expected)[colliding])
    np.testing.assert_allclose(found[colliding], penalty, rtol=1e-4)
    assert found[3] <= 0


def test_search_finds_the_fingers_and_repeats_itself() -> None:
    scene = held_object(SCENE)
    wrist = Wrist(scene.hand_state.T_camera_hand)
    config = replace(CONFIG, particles=60, generations=8, lcp_distance=0.003)
    found, again = (
        search_fingers(scene.observation, wrist, scene.hand, config, np.random.default_rng(3))
        for _ in range(2)
    )
    np.testing.assert_array_equal(found.joint_vector, again.joint_vector)
    np.testing.assert_allclose(found.joint_vector, Q, atol=np.radians(6))
    np.testing.assert_allclose(
        found.T_camera_link,
        scene.hand.link_poses(found.joint_vector[None], wrist.T_camera_hand[None])[0],
    )
