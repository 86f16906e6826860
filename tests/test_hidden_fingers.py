from dataclasses import replace

import numpy as np
import pytest
from held_object import HeldObject, distance_to_hand, held_object

from inhand.config import EvidenceConfig, SelectionConfig
from inhand.geometry.se3 import exp, transform
from inhand.stages.evidence import gather_evidence
from inhand.stages.hidden_fingers import place_hidden_fingers
from inhand.stages.results import Configurations, HandState, PoseSet

CONFIG = SelectionConfig()
TOUCHING = np.array([-0.25, 0.0])
"""In the scenes the first finger is 2 mm deep in the object; turned by this it touches it."""
AWAY = np.array([-0.8, 0.0])
"""The first finger, swung open."""


def state_of(
    scene: HeldObject, allowed: np.ndarray, score: np.ndarray, *, hidden: bool = True
) -> HandState:
    """The true hand with its first finger swung open; the image allows some configurations of it.

    Of the second finger it allows nothing else.
    """
    hand, true = scene.hand, scene.hand_state
    joints = true.joint_vector.copy()
    joints[hand.fingers[0].joints] += AWAY
    certain = np.ones(len(hand.hand.links), dtype=bool)
    certain[hand.fingers[0].links] = not hidden
    poses = hand.link_poses(joints[None], true.T_camera_hand[None])[0]
    other = Configurations(joints[None, hand.fingers[1].joints], np.ones(1))
    first = Configurations(allowed, score)
    return HandState(joints, true.T_camera_hand, poses, certain, (first, other))


def placed(
    scene: HeldObject, state: HandState, T: np.ndarray, config: SelectionConfig = CONFIG
) -> tuple[PoseSet, np.ndarray]:
    poses = PoseSet(T.astype(np.float32), np.linspace(1, 0.9, len(T), dtype=np.float32))
    evidence = gather_evidence(
        scene.observation, state, scene.segment, scene.hand, EvidenceConfig()
    )
    return place_hidden_fingers(poses, evidence, scene.obj, config)


def configurations(scene: HeldObject, count: int = 200) -> np.ndarray:
    """Many of the first finger; the first one touches the object."""
    joints = scene.hand.fingers[0].joints
    lower, upper = scene.hand.hand.lower[joints], scene.hand.hand.upper[joints]
    tried = np.random.default_rng(0).uniform(lower, upper, (count, len(joints)))
    tried[0] = scene.hand_state.joint_vector[joints] + TOUCHING
    return np.asarray(tried)


@pytest.mark.parametrize("name", ["cylinder", "cuboid"])
def test_a_hidden_finger_is_placed_where_it_touches_the_object(name: str) -> None:
    scene = held_object(name)
    tried = configurations(scene)
    state = state_of(scene, tried, np.ones(len(tried)))
    _, joints = placed(scene, state, scene.T_camera_object[None])
    hand, links = scene.hand, scene.hand.hand.fingers[0].links
    points = transform(scene.T_camera_object, scene.obj.model.surface.points)
    link = hand.link_poses(joints[None], state.T_camera_hand[None])[0]
    gap = distance_to_hand(points, hand, replace(state, T_camera_link=link), links).min()
    before = distance_to_hand(points, hand, state, links).min()
    assert before > 0.01
    assert -0.003 < gap < 0.004
    second = hand.fingers[1].joints
    np.testing.assert_array_equal(joints[second], state.joint_vector[second])


def test_what_the_image_speaks_against_needs_a_reason() -> None:
    """Two configurations touch the object; the image prefers one of them."""
    scene = held_object("cylinder")
    tried = configurations(scene, 1).repeat(2, axis=0)
    tried[1] += 0.005
    for score in ([1.0, 0.5], [1.0, 1.0]):
        state = state_of(scene, tried, np.array(score))
        _, joints = placed(scene, state, scene.T_camera_object[None])
        np.testing.assert_array_equal(joints[scene.hand.fingers[0].joints], tried[0])
    # If reaching for the object gains less than it must, the finger stays.
    stubborn = replace(CONFIG, finger_elsewhere=1.0)
    _, joints = placed(scene, state, scene.T_camera_object[None], stubborn)
    np.testing.assert_array_equal(joints, state.joint_vector)
    # Or if the image speaks against it more than the gap costs.
    tried[0] = state.joint_vector[scene.hand.fingers[0].joints]
    state = state_of(scene, tried, np.array([1.0, 0.0]))
    _, joints = placed(scene, state, scene.T_camera_object[None])
    np.testing.assert_array_equal(joints, state.joint_vector)


def test_a_finger_that_the_image_shows_stays() -> None:
    scene = held_object("cylinder")
    tried = configurations(scene)
    state = state_of(scene, tried, np.ones(len(tried)), hidden=False)
    poses, joints = placed(scene, state, scene.T_camera_object[None])
    np.testing.assert_array_equal(joints, state.joint_vector)
    assert poses.score.tolist() == [1.0]


def test_a_pose_that_no_finger_can_give_way_to_falls_behind() -> None:
    """The finger can only be where the first pose, moved along the finger's way, is."""
    scene = held_object("cylinder")
    tried = configurations(scene, 1)
    state = state_of(scene, tried, np.ones(1))
    state = replace(state, joint_vector=scene.hand_state.joint_vector)
    finger = scene.hand.fingers[0].links[-1]
    into = scene.hand_state.T_camera_link[finger][:3, 3] - scene.T_camera_object[:3, 3]
    shift = exp(np.array([0, 0, 0, *(0.02 * into / np.linalg.norm(into))]))
    T = np.stack([shift @ scene.T_camera_object, scene.T_camera_object])
    poses, _ = placed(scene, state, T)
    np.testing.assert_allclose(poses.T_camera_object[0], scene.T_camera_object, atol=1e-6)
    # Beyond the poses that are judged nothing changes place.
    poses, _ = placed(scene, state, T, replace(CONFIG, grasps=1))
    np.testing.assert_allclose(poses.T_camera_object[0], T[0], atol=1e-6)


def test_nothing_was_tried_or_found() -> None:
    scene = held_object("cylinder")
    state = replace(state_of(scene, configurations(scene, 1), np.ones(1)), allowed=())
    poses, joints = placed(scene, state, scene.T_camera_object[None])
    assert len(poses) == 1
    np.testing.assert_array_equal(joints, state.joint_vector)
    poses, joints = placed(scene, state, np.zeros((0, 4, 4)))
    assert len(poses) == 0
    np.testing.assert_array_equal(joints, state.joint_vector)
