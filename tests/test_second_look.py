"""A finger that the image did not seem to support explains what was taken for the object."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from held_object import CAMERA, HeldObject, Q, held_object

from inhand import EstimatorConfig, PoseEstimate, PoseEstimator, estimator
from inhand.config import SecondLookConfig
from inhand.estimator import StageResults
from inhand.evaluation.metrics import ObjectMetric
from inhand.stages import segmentation
from inhand.stages.results import HandState, PoseSet, Segment, Selection
from inhand.stages.second_look import doubted, hands_in_segment, with_missed_fingers
from inhand.synth.scene import Scene

CONFIG = EstimatorConfig()


def missed_finger(scene: HeldObject, *numbers: int) -> HandState:
    """The true hand, but for some fingers, by default the first, that are wide open."""
    hand, state = scene.hand, scene.hand_state
    q, certain = state.joint_vector.copy(), state.certain.copy()
    for number in numbers or (0,):
        finger = hand.fingers[number]
        q[finger.joints] = hand.hand.lower[finger.joints]
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


def check_true_hand(found: HandState, scene: HeldObject) -> None:
    """The hand is where it is in the scene, and its links where its joints put them."""
    assert np.abs(found.joint_vector - Q).max() < np.radians(3)
    assert np.abs(found.T_camera_hand - scene.hand_state.T_camera_hand)[:3, 3].max() < 0.001
    links = scene.hand.link_poses(found.joint_vector[None], found.T_camera_hand[None])[0]
    np.testing.assert_allclose(found.T_camera_link, links, atol=1e-6)


@pytest.mark.parametrize("number", range(2))
def test_a_missed_finger_is_found_in_the_segment(number: int) -> None:
    scene = held_object("industrial_part")
    missed, segment = missed_finger(scene, number), finger_as_segment(scene, number)
    (found,) = hands_in_segment(scene.observation, missed, segment, scene.hand, CONFIG)
    check_true_hand(found, scene)
    assert found.certain[scene.hand.fingers[number].links].any()


def test_a_finger_that_is_certain_stays() -> None:
    scene = held_object("industrial_part")
    certain = replace(missed_finger(scene), certain=scene.hand_state.certain)
    segment = finger_as_segment(scene)
    assert hands_in_segment(scene.observation, certain, segment, scene.hand, CONFIG) == []


def test_the_object_is_no_finger() -> None:
    scene = held_object("cuboid")
    missed = missed_finger(scene)
    assert hands_in_segment(scene.observation, missed, scene.segment, scene.hand, CONFIG) == []


def joined(*segments: Segment) -> Segment:
    """All their points."""
    return Segment(
        np.concatenate([s.points for s in segments]),
        np.concatenate([s.normals for s in segments]),
        np.concatenate([s.hand_distance for s in segments]),
        np.concatenate([s.weight for s in segments]),
    )


def left_by_the_object(
    scene: HeldObject, missed: HandState, segment: Segment, poses: int = 1
) -> HandState | None:
    """The hand with missed fingers where the true object leaves what they explain."""
    T = scene.T_camera_object[None].astype(np.float32)[:poses]
    found = Selection(PoseSet(T, np.ones(poses, dtype=np.float32)), 0.9, missed.joint_vector)
    parts = scene.observation, missed, found, segment, scene.hand, scene.obj
    return with_missed_fingers(*parts, CONFIG)


@pytest.mark.parametrize("missed", [(0,), (1,), (0, 1)])
def test_fingers_are_found_in_what_the_object_leaves(missed: tuple[int, ...]) -> None:
    scene = held_object("industrial_part")
    fingers = [finger_as_segment(scene, number) for number in missed]
    state = missed_finger(scene, *missed)
    found = left_by_the_object(scene, state, joined(scene.segment, *fingers))
    assert found is not None
    check_true_hand(found, scene)
    for number in missed:
        assert found.certain[scene.hand.fingers[number].links].any()


def test_no_finger_is_found_where_none_was_missed() -> None:
    scene = held_object("industrial_part")
    finger, missed = finger_as_segment(scene), missed_finger(scene)
    every = joined(scene.segment, finger)
    few = np.zeros(len(every.points), dtype=bool)
    few[: len(scene.segment.points)] = True
    few[-int(CONFIG.second_look.least_left) + 1 :] = True
    for state, segment, poses in (
        (missed, scene.segment, 1),  # the object explains all
        (missed, every.where(few), 1),  # hardly anything is left
        (replace(scene.hand_state, certain=missed.certain), every, 1),  # the hand explains the rest
        (replace(missed, certain=scene.hand_state.certain), every, 1),  # it shows elsewhere
        (missed, every, 0),  # there is no answer
    ):
        assert left_by_the_object(scene, state, segment, poses) is None


def test_readings_of_something_else_are_no_finger() -> None:
    scene = held_object("industrial_part")
    aside = replace(finger_as_segment(scene), points=scene.segment.points[:1] + 0.2)
    aside = replace(aside, points=np.repeat(aside.points, len(aside.weight), axis=0))
    segment = joined(scene.segment, aside)
    assert left_by_the_object(scene, missed_finger(scene), segment) is None


def test_a_finger_is_not_moved_if_the_image_pulls_it_back() -> None:
    scene, elsewhere = held_object("industrial_part"), np.array([0.2, 0.4])
    finger, state = scene.hand.fingers[0], scene.hand_state
    q, certain = state.joint_vector.copy(), state.certain.copy()
    q[finger.joints], certain[finger.links[-1]] = elsewhere, False
    poses = scene.hand.link_poses(q[None], state.T_camera_hand[None])[0]
    stray = replace(scene, hand_state=replace(state, T_camera_link=poses))
    segment = joined(scene.segment, finger_as_segment(stray))
    # The finger could explain these readings, but it is seen where it is.
    assert left_by_the_object(scene, replace(state, certain=certain), segment) is None


def estimated(
    scene: HeldObject, look: SecondLookConfig, monkeypatch: pytest.MonkeyPatch
) -> tuple[PoseEstimate, StageResults, int]:
    """The answer, what the stages made, and how often the object was searched, with a hand of which
    a finger was missed."""
    missed, searches = missed_finger(scene), []
    monkeypatch.setattr(estimator, "estimate_hand_state", lambda *args: missed)

    def segment_object(*args: Any) -> Segment:
        searches.append(args)
        return segmentation.segment_object(*args)

    monkeypatch.setattr(estimator, "segment_object", segment_object)
    config = replace(CONFIG, second_look=look)
    pose_estimator = PoseEstimator(scene.hand.hand, scene.obj.model, config, "cpu")
    found, stages = pose_estimator.run(scene.depth, CAMERA, scene.hand_state.T_camera_hand)
    return found, stages, len(searches)


@pytest.mark.parametrize("sure", [0.0, 1.0])
def test_an_answer_has_the_finger_that_was_missed(
    sure: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = held_object("cuboid")
    look = replace(CONFIG.second_look, doubt_below=sure)  # 1: every answer is looked for again
    found, stages, searches = estimated(scene, look, monkeypatch)
    assert searches == 1 + int(sure)
    assert found.T_camera_object is not None
    joints = [found.joint_positions[name] for name in scene.hand.hand.joint_names]
    assert np.abs(np.array(joints) - Q).max() < np.radians(3)
    error = ObjectMetric(scene.obj.model).adi(found.T_camera_object, scene.T_camera_object)
    assert error < 0.002
    assert stages.hand_state is not None
    assert stages.hand_state.certain[scene.hand.fingers[0].links].any()


def test_missed_fingers_are_not_looked_for_if_so_configured(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = held_object("cuboid")
    look = replace(CONFIG.second_look, left_explained=1.0)
    found, _, _ = estimated(scene, look, monkeypatch)
    assert found.found
    assert "missed_fingers" not in found.timings


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
