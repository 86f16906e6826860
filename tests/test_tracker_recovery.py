"""When a lost tracker takes an answer of the estimator, and what it makes of it."""

from dataclasses import replace

import numpy as np
import pytest
from held_object import HeldObject, built_in_object, held_object

from inhand.estimate import PoseEstimate
from inhand.geometry import se3
from inhand.geometry.se3 import moved, rotation_angle, transform
from inhand.object_symmetry import rotations_about
from inhand.tracking.config import TrackerConfig
from inhand.tracking.gaussian import twist_between
from inhand.tracking.recovery import Sighting, resumed, same_place, stands_beside_the_hand
from inhand.tracking.track import Track

CONFIG = TrackerConfig()
WELL_KNOWN = np.diag([0.02] * 3 + [0.001] * 3) ** 2
WRIST = se3.exp(np.array([0.3, -0.2, 0.4, 0.05, 0.1, 0.5]))


def shifted(T: np.ndarray, by: list[float]) -> np.ndarray:
    out = T.copy()
    out[:3, 3] += by
    return out


def track_of(held: HeldObject) -> Track:
    """The truth as a track, its object well known."""
    state, joints = held.hand_state, len(held.hand.hand.rest)
    return Track(
        given=state.T_camera_hand,
        T_camera_hand=state.T_camera_hand,
        joint_vector=state.joint_vector,
        hand_covariance=np.eye(6 + joints) * 1e-6,
        certain=np.ones(len(held.hand.hand.links), dtype=bool),
        T_camera_object=held.T_camera_object,
        object_covariance=WELL_KNOWN,
        lasting=np.zeros((6, 6)),
        motion=np.zeros(6),
        motion_covariance=WELL_KNOWN,
        hand_motion=np.zeros(6),
        answer=held.T_camera_object,
        images=10,
        confidence=0.2,
    )


def answer_of(
    held: HeldObject, T_camera_object: np.ndarray, q: np.ndarray | None = None
) -> PoseEstimate:
    """An answer of the estimator with the object there, and the hand where it is or at `q`."""
    joints = held.hand_state.joint_vector if q is None else q
    return PoseEstimate(
        found=True,
        reason="",
        T_camera_object=T_camera_object,
        joint_positions=held.hand.hand.joint_dict(joints),
        T_camera_hand=held.hand_state.T_camera_hand,
        confidence=0.97,
        timings={},
    )


def test_answers_agree_if_the_object_is_at_one_place_in_the_hand() -> None:
    obj, T_hand_object = built_in_object("cuboid"), se3.exp(np.array([0.1, 0.5, 0, 0, 0.02, 0.1]))
    before = Sighting(np.eye(4), T_hand_object)
    assert Sighting(WRIST, WRIST @ T_hand_object).agrees_with(before, obj, CONFIG)
    slid = shifted(T_hand_object, [0.0, 0.01, 0.0])
    assert not Sighting(WRIST, WRIST @ slid).agrees_with(before, obj, CONFIG)
    assert not Sighting(WRIST, T_hand_object).agrees_with(before, obj, CONFIG)


def test_turns_that_do_not_show_are_one_place() -> None:
    obj = built_in_object("cylinder")
    axis = obj.model.symmetry.axis
    assert axis is not None
    spun = rotations_about(obj.model.centre, axis, 1.0)[0]
    tilted = rotations_about(obj.model.centre, np.cross(axis, [0.6, 0.8, 0.1]), 0.6)[0]
    assert same_place(WRIST, WRIST @ spun, obj, CONFIG)
    assert not same_place(WRIST, WRIST @ tilted, obj, CONFIG)


@pytest.mark.parametrize("name", ["cuboid", "industrial_part"])
def test_the_object_stands_beside_the_hand(name: str) -> None:
    held = held_object(name)
    rest = (track_of(held), held.observation, held.hand, held.obj, CONFIG)
    assert stands_beside_the_hand(answer_of(held, held.T_camera_object), *rest)
    # Nor does the answer's hand matter, as long as the followed one leaves the object to be seen.
    elsewhere = np.zeros_like(held.hand_state.joint_vector)
    assert stands_beside_the_hand(answer_of(held, held.T_camera_object, elsewhere), *rest)


@pytest.mark.parametrize("finger", [0, 1])
def test_a_finger_is_not_the_object(finger: int) -> None:
    held = held_object("cylinder")
    part = held.hand.fingers[finger]
    link = held.hand_state.T_camera_link[part.links[-1]]
    middle = transform(link, held.hand.hand.links[part.links[-1]].mesh.vertices).mean(axis=0)
    centre = transform(held.T_camera_object, held.obj.model.centre[None])[0]
    there = shifted(held.T_camera_object, list(middle - centre))
    q = held.hand_state.joint_vector.copy()
    q[part.joints] = 0.0
    rest = (track_of(held), held.observation, held.hand, held.obj, CONFIG)
    assert not stands_beside_the_hand(answer_of(held, there, q), *rest)


def test_a_track_that_agrees_counts_as_much_as_it_is_known() -> None:
    held = held_object("industrial_part")
    track, centre = track_of(held), held.obj.model.centre
    rest = (held.hand_state.T_camera_hand, held.hand, held.obj, CONFIG)
    answer = answer_of(held, shifted(held.T_camera_object, [0.003, 0.0, 0.0]))
    after = resumed(track, answer, *rest)
    way = twist_between(track.T_camera_object, after.T_camera_object, centre)
    assert 0 < way[3] < 0.001, "near the track, which is known better"
    assert (np.linalg.eigvalsh(WELL_KNOWN - after.object_covariance) > -1e-12).all()
    vague = replace(track, object_covariance=100 * WELL_KNOWN)
    after = resumed(vague, answer, *rest)
    way = twist_between(track.T_camera_object, after.T_camera_object, centre)
    assert 0.001 < way[3] < 0.003


def test_a_track_elsewhere_does_not_count() -> None:
    held = held_object("industrial_part")
    turned = moved(held.T_camera_object, np.array([0, 2.5, 0, 0, 0, 0]), held.obj.model.centre)
    args = (held.hand_state.T_camera_hand, held.hand, held.obj, CONFIG)
    after = resumed(track_of(held), answer_of(held, turned), *args)
    np.testing.assert_array_equal(after.T_camera_object, turned)
    assert np.trace(after.whole_covariance) > 10 * np.trace(WELL_KNOWN)


def test_an_answer_turned_by_a_symmetry_does_not_turn_the_track() -> None:
    held = held_object("cuboid")
    symmetry = held.obj.model.symmetry
    assert len(symmetry.rotations) > 1
    answer = answer_of(held, held.T_camera_object @ symmetry.rotations[1])
    args = (held.hand_state.T_camera_hand, held.hand, held.obj, CONFIG)
    after = resumed(track_of(held), answer, *args)
    turn = rotation_angle(after.T_camera_object[:3, :3], held.T_camera_object[:3, :3])
    assert turn < np.radians(2)
