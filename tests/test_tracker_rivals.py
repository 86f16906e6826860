"""Other poses that a search could hardly tell from its answer."""

from dataclasses import replace

import numpy as np
from held_object import HeldObject, held_object
from test_tracker_parts import CONFIG, SURE, follow_found, track_of

from inhand.estimate import Candidate, PoseEstimate
from inhand.geometry import se3
from inhand.geometry.se3 import exp, rotation_angle
from inhand.tracking.rivals import Rival, rivals_of, share_of_answer, told_apart

RULE = CONFIG.rivals
TURNED = exp(np.array([np.pi / 2, 0, 0, 0, 0, 0]))
SHIFTED = exp(np.array([0, 0, 0, 0.01, 0, 0]))


def answer_of(held: HeldObject, others: list[tuple[np.ndarray, float]]) -> PoseEstimate:
    """An answer with these candidates after the true pose, given from there, and their scores."""
    T = held.T_camera_object
    poses = [(T, 1.5), *((T @ other, score) for other, score in others)]
    return PoseEstimate(
        found=True,
        reason="",
        T_camera_object=T,
        joint_positions={},
        T_camera_hand=held.hand_state.T_camera_hand,
        confidence=0.9,
        candidates=tuple(Candidate(pose, {"score": score}) for pose, score in poses),
        timings={},
    )


def test_rivals_are_elsewhere_and_nearly_as_good() -> None:
    held = held_object("cuboid")
    nudged = exp(np.array([0, 0, 0, 0.001, 0, 0]))
    others = [(nudged, 1.49), (TURNED, 1.45), (TURNED @ nudged, 1.44), (SHIFTED, 1.2)]
    (rival,) = rivals_of(answer_of(held, others), held.T_camera_object, held.obj, RULE)
    np.testing.assert_allclose(rival.T_object_rival, TURNED, atol=1e-6)
    np.testing.assert_allclose(rival.lead, -0.05, atol=1e-9)


def test_a_turn_that_does_not_show_is_no_rival() -> None:
    held = held_object("cylinder")
    turns = [exp(np.array([0, 0, angle, 0, 0, 0])) for angle in (0.5, 1.0, 2.0)]
    others = [(turn, 1.5) for turn in turns]
    assert rivals_of(answer_of(held, others), held.T_camera_object, held.obj, RULE) == ()


def test_an_answer_without_candidates_has_no_rivals() -> None:
    held = held_object("cuboid")
    bare = replace(answer_of(held, []), candidates=())
    assert rivals_of(bare, held.T_camera_object, held.obj, RULE) == ()
    known = (Rival(TURNED, -0.1),)
    assert rivals_of(bare, held.T_camera_object, held.obj, RULE, known) == known


def test_a_second_search_adds_to_what_is_known() -> None:
    """Leads are over the candidate that is the followed pose, wherever the search ranks it."""
    held = held_object("cuboid")
    followed = held.T_camera_object @ TURNED
    others = [(TURNED, 1.45), (SHIFTED, 1.4)]
    known = (Rival(se3.inverse(TURNED) @ SHIFTED, -0.02),)
    kept, new = rivals_of(answer_of(held, others), followed, held.obj, RULE, known)
    assert kept is known[0]
    np.testing.assert_allclose(followed @ new.T_object_rival, held.T_camera_object, atol=1e-6)
    np.testing.assert_allclose(new.lead, 0.05, atol=1e-9)


def test_there_are_a_few_at_most() -> None:
    held = held_object("cuboid")
    others = [(exp(np.array([0, 0, 0, 0, 0, 0.01 * k])), 1.5) for k in range(1, 8)]
    found = rivals_of(answer_of(held, others), held.T_camera_object, held.obj, RULE)
    assert len(found) == RULE.most


def test_images_tell_rivals_apart() -> None:
    T, obj = np.eye(4), held_object("cuboid").obj
    rivals: tuple[Rival, ...] = (Rival(TURNED, 0.0), Rival(SHIFTED, 0.0))
    fitted = np.stack([TURNED, SHIFTED])
    for _ in range(30):
        leads = np.array([-0.1, -1.0])
        rivals = told_apart(rivals, T, fitted[: len(rivals)], leads, obj, RULE)
        if len(rivals) == 1:
            break
    (left,) = rivals
    np.testing.assert_array_equal(left.T_object_rival, TURNED)
    for _ in range(30):
        (left,) = told_apart((left,), T, TURNED[None], np.array([-0.1]), obj, RULE)
    np.testing.assert_allclose(left.lead, -0.1, atol=1e-4)


def test_a_rival_that_becomes_the_followed_pose_is_none() -> None:
    obj, nearly = held_object("cuboid").obj, exp(np.array([0, 0, 0, 0.001, 0, 0]))
    rivals = (Rival(TURNED, 0.0), Rival(SHIFTED, 0.0))
    fitted, leads = np.stack([nearly, SHIFTED]), np.array([0.1, -0.1])
    (left,) = told_apart(rivals, np.eye(4), fitted, leads, obj, RULE)
    np.testing.assert_array_equal(left.T_object_rival, SHIFTED)


def test_a_rival_that_is_right_takes_over() -> None:
    held = held_object("cuboid")
    wrong = held.T_camera_object @ TURNED
    right = Rival(se3.inverse(TURNED), 0.0)
    track = replace(track_of(held, SURE), T_camera_object=wrong, answer=wrong, rivals=(right,))
    alone = follow_found(held, replace(track, rivals=()))
    assert np.abs(alone.T_camera_object - held.T_camera_object).max() > 0.1
    for _ in range(5):
        found = follow_found(held, track)
        track = found.kept_in(track, 0.9, CONFIG)
    np.testing.assert_allclose(track.T_camera_object, held.T_camera_object, atol=0.02)
    assert all(rival.lead < 0 for rival in track.rivals)


def test_a_rival_that_is_wrong_is_dropped() -> None:
    held = held_object("cuboid")
    track = replace(track_of(held, SURE), rivals=(Rival(TURNED, 0.0),))
    for _ in range(10):
        track = follow_found(held, track).kept_in(track, 0.9, CONFIG)
    assert track.rivals == ()
    np.testing.assert_allclose(track.T_camera_object, held.T_camera_object, atol=0.02)


def test_a_rival_makes_unsure_as_far_as_it_is_likely() -> None:
    assert share_of_answer((), RULE) == 1
    np.testing.assert_allclose(share_of_answer((Rival(TURNED, 0.0),), RULE), 0.5)
    behind, ahead = (share_of_answer((Rival(TURNED, x),), RULE) for x in (-0.15, 0.05))
    assert ahead < 0.5 < 0.9 < behind < 1


def test_a_rival_is_turned_no_more_than_it_must_be() -> None:
    """Of poses that look the same: an answer must not jump by half a turn that does not show."""
    held = held_object("cuboid")
    symmetry = held.obj.model.symmetry
    assert len(symmetry.rotations) > 1
    others = [(SHIFTED @ symmetry.rotations[1], 1.45)]
    (rival,) = rivals_of(answer_of(held, others), held.T_camera_object, held.obj, RULE)
    assert rotation_angle(rival.T_object_rival[:3, :3], np.eye(3)) < 1e-3


def test_a_rival_that_is_hardly_elsewhere_does_not_make_unsure() -> None:
    near, far = (Rival(SHIFTED, 0.0, distance) for distance in (0.003, 0.008))
    assert share_of_answer((near,), RULE) == 1
    assert share_of_answer((near, far), RULE) == 0.5
