"""A finger that the image did not seem to support explains what was taken for the object."""

from dataclasses import replace

import numpy as np
import pytest
from held_object import HeldObject, Q, held_object

from inhand import EstimatorConfig, PoseEstimator
from inhand.config import SecondLookConfig
from inhand.stages.results import HandState, PoseSet, Segment, Selection
from inhand.stages.second_look import doubted, hands_in_segment
from inhand.synth.scene import Scene

CONFIG = EstimatorConfig()


def missed_finger(scene: HeldObject, number: int = 0) -> HandState:
    """The true hand, but for one finger that is wide open."""
    hand, state = scene.hand, scene.hand_state
    finger = hand.fingers[number]
    q = state.joint_vector.copy()
    q[finger.joints] = hand.hand.lower[finger.joints]
    certain = state.certain.copy()
    certain[finger.links] = False
    poses = hand.link_poses(q[None], state.T_camera_hand[None])[0]
    return HandState(q, state.T_camera_hand, poses, certain)


def finger_as_segment(scene: HeldObject, number: int = 0) -> Segment:
    """What the camera sees of the true finger, taken for the object."""
    links = scene.hand.fingers[number].links
    surfaces = [scene.hand.hand.links[i].surface for i in links]
    poses = scene.hand_state.T_camera_link[links]
    points = np.concatenate(
        [s.points @ T[:3, :3].T + T[:3, 3] for s, T in zip(surfaces, poses, strict=True)]
    )
    normals = np.concatenate(
        [s.normals @ T[:3, :3].T for s, T in zip(surfaces, poses, strict=True)]
    )
    seen = (points * normals).sum(axis=1) < 0
    count = int(seen.sum())
    return Segment(
        points[seen].astype(np.float32),
        normals[seen].astype(np.float32),
        np.full(count, 0.02, dtype=np.float32),
        np.ones(count, dtype=np.float32),
    )


@pytest.mark.parametrize("number", range(2))
def test_a_missed_finger_is_found_in_the_segment(number: int) -> None:
    scene = held_object("industrial_part")
    missed, segment = missed_finger(scene, number), finger_as_segment(scene, number)
    (found,) = hands_in_segment(scene.observation, missed, segment, scene.hand, CONFIG)
    assert np.abs(found.joint_vector - Q).max() < np.radians(3)
    assert np.abs(found.T_camera_hand - scene.hand_state.T_camera_hand)[:3, 3].max() < 0.001
    assert found.certain[scene.hand.fingers[number].links].any()
    np.testing.assert_allclose(
        found.T_camera_link,
        scene.hand.link_poses(found.joint_vector[None], found.T_camera_hand[None])[0],
        atol=1e-6,
    )


def test_a_finger_that_is_certain_stays() -> None:
    scene = held_object("industrial_part")
    certain = replace(missed_finger(scene), certain=scene.hand_state.certain)
    segment = finger_as_segment(scene)
    assert hands_in_segment(scene.observation, certain, segment, scene.hand, CONFIG) == []


def test_the_object_is_no_finger() -> None:
    scene = held_object("cuboid")
    missed = missed_finger(scene)
    assert hands_in_segment(scene.observation, missed, scene.segment, scene.hand, CONFIG) == []


def answer(confidence: float) -> Selection:
    """An answer of that confidence."""
    pose = PoseSet(np.eye(4, dtype=np.float32)[None], np.ones(1, dtype=np.float32))
    return Selection(pose, confidence, Q)


def test_an_answer_in_a_segment_that_may_be_a_finger_is_doubted() -> None:
    scene = held_object("industrial_part")
    missed, segment = missed_finger(scene), finger_as_segment(scene)
    sure, unsure = (
        doubted(answer(p), missed, segment, scene.hand, CONFIG.second_look).confidence
        for p in (0.9, 0.5)
    )
    assert unsure < sure < 0.1
    # The same odds are taken from both.
    assert sure / (1 - sure) == pytest.approx(9 * unsure / (1 - unsure))


def test_an_answer_is_not_doubted_where_no_finger_was_missed() -> None:
    scene, cuboid = held_object("industrial_part"), held_object("cuboid")
    certain = replace(missed_finger(scene), certain=scene.hand_state.certain)
    for hand_state, segment, hand in (
        (certain, finger_as_segment(scene), scene.hand),
        (missed_finger(cuboid), cuboid.segment, cuboid.hand),
    ):
        found = doubted(answer(0.9), hand_state, segment, hand, CONFIG.second_look)
        assert found.confidence == pytest.approx(0.9)


def test_only_unsure_answers_are_looked_at_again(scenes: list[Scene]) -> None:
    scene = scenes[0]
    given = scene.depth, scene.camera, scene.T_camera_hand_given
    config = replace(CONFIG, second_look=SecondLookConfig(below=1.0))
    again, once = (PoseEstimator(scene.hand, scene.obj, c, "cpu") for c in (config, CONFIG))
    first, second = once.estimate(*given), again.estimate(*given)
    assert first.confidence > CONFIG.second_look.below
    assert "second_look" not in first.timings
    assert "second_look" in second.timings
    assert second.confidence >= first.confidence
