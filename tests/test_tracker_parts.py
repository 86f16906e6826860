"""The tracker's own steps, each against the truth or against what the estimator does."""

from dataclasses import replace

import numpy as np
import pytest
from held_object import HeldObject, built_in_hand, held_object
from scipy.spatial import KDTree

from inhand.config import HandStateConfig
from inhand.errors import NoAnswer
from inhand.geometry import se3
from inhand.geometry.se3 import moved, rotation_angle, transform
from inhand.packed import PackedPart
from inhand.stages.evidence import gather_evidence
from inhand.stages.hand_visibility import HandVisibility
from inhand.stages.refinement import fit_to_field
from inhand.tracking.config import TrackerConfig
from inhand.tracking.finger_search import find_lost_fingers
from inhand.tracking.gaussian import twist_between
from inhand.tracking.hand_track import follow_hand
from inhand.tracking.object_track import (
    FollowedObject,
    follow_object,
    segment_near,
)
from inhand.tracking.rest import rests
from inhand.tracking.track import Track, predicted

CONFIG = TrackerConfig()
SURE = np.diag([0.002] * 3 + [0.0005] * 3) ** 2
UNSURE = np.diag([0.2] * 3 + [0.02] * 3) ** 2


@pytest.fixture(params=["cuboid", "industrial_part"])
def held(request: pytest.FixtureRequest) -> HeldObject:
    return held_object(request.param)


def track_of(held: HeldObject, covariance: np.ndarray) -> Track:
    """The truth as a track."""
    joints = len(held.hand.hand.rest)
    return Track(
        given=held.hand_state.T_camera_hand,
        T_camera_hand=held.hand_state.T_camera_hand,
        joint_vector=held.hand_state.joint_vector,
        hand_covariance=np.diag([0.01] * 3 + [0.003] * 3 + [0.1] * joints) ** 2,
        certain=np.ones(len(held.hand.hand.links), dtype=bool),
        T_camera_object=held.T_camera_object,
        object_covariance=covariance,
        lasting=np.zeros((6, 6)),
        motion=np.zeros(6),
        motion_covariance=SURE,
        hand_motion=np.zeros(6),
        answer=held.T_camera_object,
        images=10,
        confidence=0.9,
    )


def follow_found(held: HeldObject, track: Track, config: TrackerConfig = CONFIG) -> FollowedObject:
    """The object, followed with the true hand."""
    args = (held.observation, held.hand_state, track, held.hand, held.obj, CONFIG)
    segment = segment_near(*args)
    evidence = gather_evidence(
        held.observation, held.hand_state, segment, held.hand, CONFIG.estimator.evidence
    )
    return follow_object(evidence, held.obj, track, config)


def follow(held: HeldObject, track: Track) -> np.ndarray:
    """Its pose."""
    return follow_found(held, track).T_camera_object


def test_a_pose_that_is_not_known_is_where_the_image_has_it(held: HeldObject) -> None:
    rng = np.random.default_rng(0)
    centre = held.obj.model.centre
    for _ in range(5):
        twist = rng.normal(size=6) * ([0.05] * 3 + [0.003] * 3)
        track = track_of(held, UNSURE)
        track = replace(track, T_camera_object=moved(held.T_camera_object, twist, centre))
        T = follow(held, track)
        place = transform(T, centre[None]) - transform(held.T_camera_object, centre[None])
        assert np.linalg.norm(place) < 0.0015
        assert rotation_angle(T[:3, :3], held.T_camera_object[:3, :3]) < np.radians(3)


def test_a_pose_that_is_well_known_stays(held: HeldObject) -> None:
    centre = held.obj.model.centre
    twist = np.array([0.0, 0.0, 0.0, 0.003, 0.0, 0.0])
    expected = moved(held.T_camera_object, twist, centre)
    track = replace(track_of(held, SURE / 100), T_camera_object=expected)
    assert np.linalg.norm(twist_between(expected, follow(held, track), centre)[3:]) < 0.0005


def test_a_pose_that_slid_unseen_is_found_by_what_should_be_seen() -> None:
    """Faces along which a cuboid slid do not pull it back; that an end sticks out tells."""
    held = held_object("cuboid")
    centre, extents = held.obj.model.centre, np.ptp(held.obj.model.mesh.vertices, axis=0)
    axis = held.T_camera_object[:3, np.argmax(extents)]
    slid = np.concatenate([np.zeros(3), axis])
    expected = moved(held.T_camera_object, 0.008 * slid, centre)
    track = replace(
        track_of(held, SURE + 0.006**2 * np.outer(slid, slid)), T_camera_object=expected
    )

    def distance(config: TrackerConfig) -> float:
        T = follow_found(held, track, config).T_camera_object
        return abs(float(twist_between(held.T_camera_object, T, centre)[3:] @ axis))

    never = replace(CONFIG, object=replace(CONFIG.object, aside_lead=100.0))
    assert distance(never) > 0.005
    assert distance(CONFIG) < 0.0015


def test_the_same_image_again_and_again_does_not_make_sure(held: HeldObject) -> None:
    """Errors that change average out; the others stay, as large as one image's, scaled."""
    track, c = track_of(held, UNSURE), CONFIG.object
    segment = segment_near(held.observation, held.hand_state, track, held.hand, held.obj, CONFIG)
    evidence = gather_evidence(
        held.observation, held.hand_state, segment, held.hand, CONFIG.estimator.evidence
    )
    widths = c.last_width, c.last_width
    _, system, _ = fit_to_field(
        evidence, held.obj, c.image_weight, held.T_camera_object[None], c.points, 1, widths
    )
    of_one = np.linalg.inv(c.point_information * system[0])
    for _ in range(30):
        found = follow_object(evidence, held.obj, track, CONFIG)
        track = found.kept_in(track, 0.9, CONFIG)
    places = np.s_[3:, 3:]
    assert np.trace(track.object_covariance[places]) < 0.1 * np.trace(of_one[places])
    left = np.trace((track.lasting @ track.lasting.T)[places])
    expected = c.lasting**2 * np.trace(of_one[places])
    assert 0.5 * expected < left < 1.5 * expected


def test_what_moves_may_move_where_it_does_not_show(held: HeldObject) -> None:
    still = track_of(held, SURE)
    moves = replace(still, motion=np.array([0, 0, 0, 0.002, 0, 0]))
    hand = held.hand.hand
    after = [predicted(track, still.given, 1 / 30, False, hand, CONFIG) for track in (still, moves)]
    grown = np.diag(after[1].object_covariance - after[0].object_covariance)
    assert (grown > 0).all()
    assert grown[3] > 5 * grown[4:].max()
    np.testing.assert_allclose(grown[:3], grown[4] / CONFIG.object.lever**2)


def test_what_was_not_seen_may_have_moved(held: HeldObject) -> None:
    """By the sd that is configured, in all directions; and its images count from nothing again."""
    track, hand = track_of(held, SURE), held.hand.hand
    seen, hidden = (predicted(track, track.given, 0.25, was, hand, CONFIG) for was in (False, True))
    c = CONFIG.object
    sd = np.sqrt(np.diag(hidden.object_covariance - seen.object_covariance))
    np.testing.assert_allclose(sd, [c.hidden_turn / 2] * 3 + [c.hidden_motion / 2] * 3)
    assert seen.images == track.images
    assert hidden.images == 0


def test_motion_of_a_still_object_is_what_chance_makes_of_it(held: HeldObject) -> None:
    """Innovations drawn from their covariance leave motions that agree with theirs."""
    rng, covariance = np.random.default_rng(0), np.diag([0.02] * 3 + [0.0005] * 3) ** 2
    track, squares = track_of(held, SURE), []
    found = follow_found(held, track)
    for _ in range(400):
        innovation = rng.multivariate_normal(np.zeros(6), covariance)
        found = replace(found, innovation=innovation, innovation_covariance=covariance)
        track = found.kept_in(track, 0.9, CONFIG)
        squares.append(track.motion @ np.linalg.solve(track.motion_covariance, track.motion))
    assert 4.5 < np.mean(squares[20:]) < 7.5


def test_the_segment_is_the_object(held: HeldObject) -> None:
    segment = segment_near(
        held.observation, held.hand_state, track_of(held, SURE), held.hand, held.obj, CONFIG
    )
    surface = transform(held.T_camera_object, held.obj.model.surface.points)
    apart = KDTree(surface).query(segment.points)[0]
    assert np.average(apart < 0.004, weights=segment.weight) > 0.95
    ours, theirs = segment.weight.sum(), held.segment.weight.sum()
    assert ours > 0.8 * theirs


def test_an_object_that_is_elsewhere_is_said_to_be_hidden(held: HeldObject) -> None:
    away = moved(held.T_camera_object, np.array([0, 0, 0, 0.3, 0, 0]), held.obj.model.centre)
    track = replace(track_of(held, SURE), T_camera_object=away)
    with pytest.raises(NoAnswer, match="hidden"):
        segment_near(held.observation, held.hand_state, track, held.hand, held.obj, CONFIG)


def test_the_hand_is_found_from_a_little_off(held: HeldObject) -> None:
    truth = track_of(held, SURE)
    off = np.array([0.01, -0.01, 0.01, 0.002, 0.002, -0.001])
    start = replace(
        truth,
        T_camera_hand=moved(truth.T_camera_hand, off, np.zeros(3)),
        joint_vector=truth.joint_vector + [0.03, -0.03, 0.03, -0.03],
    )
    config = replace(CONFIG, hand=replace(CONFIG.hand, iterations=5))
    found = follow_hand(held.observation, held.hand, start, config)
    twist = twist_between(truth.T_camera_hand, found.state.T_camera_hand, np.zeros(3))
    assert np.linalg.norm(twist[:3]) < np.radians(0.6)
    assert np.linalg.norm(twist[3:]) < 0.001
    sd = np.sqrt(np.diag(found.covariance))
    error = np.concatenate([twist, found.state.joint_vector - truth.joint_vector])
    assert (np.abs(error) < 4 * sd + 1e-3).all()


def test_links_count_as_seen_as_the_estimator_counts_them(held: HeldObject) -> None:
    shared = HandStateConfig(fine_points=10**6)
    config = replace(CONFIG, estimator=replace(CONFIG.estimator, hand_state=shared))
    start = replace(track_of(held, SURE), hand_covariance=np.eye(10) * 1e-14)
    found = follow_hand(held.observation, held.hand, start, config).state
    visibility = HandVisibility(held.observation, held.hand, shared)
    for i in np.flatnonzero(~held.hand.is_palm):
        link = PackedPart(held.hand.hand, [int(i)], "cpu")
        score, seen, _ = visibility.score(
            link, found.joint_vector[None, link.joints], found.T_camera_hand[None]
        )
        supported = score[0] > shared.certain_support * max(seen[0], shared.min_seen)
        assert found.certain[i] == supported


def test_a_lost_finger_is_found_where_the_image_shows_it() -> None:
    held = held_object("cuboid")
    truth = track_of(held, SURE)
    finger = held.hand.fingers[0]
    seen = follow_hand(held.observation, held.hand, truth, CONFIG).state.certain[finger.links]
    assert seen.any(), "the image shows the finger"
    lost = truth.certain.copy()
    lost[finger.links] = False
    q = truth.joint_vector.copy()
    q[finger.joints] = 0.0
    track = replace(truth, certain=lost, joint_vector=q)
    args = (held.observation, held.hand, held.obj, track, CONFIG)
    found = find_lost_fingers(*args, np.random.default_rng(0))
    # Near enough for the fit that follows.
    config = replace(CONFIG, hand=replace(CONFIG.hand, iterations=10, width=0.012))
    after = follow_hand(held.observation, held.hand, found, config).state.joint_vector
    wrong = np.abs(after - truth.joint_vector)[finger.joints]
    assert wrong[0] < np.radians(6)
    kept = held.hand.fingers[1].joints
    np.testing.assert_array_equal(found.joint_vector[kept], truth.joint_vector[kept])


def test_a_camera_that_turns_turns_the_covariance() -> None:
    held = held_object("cuboid")
    unequal = np.diag([0.1, 0.2, 0.3, 0.01, 0.02, 0.03]) ** 2
    track, hand = track_of(held, unequal), built_in_hand().hand
    quarter = se3.exp(np.array([0, 0, np.pi / 2, 0, 0, 0]))
    after = predicted(track, quarter @ track.given, 1e-6, False, hand, CONFIG)
    expected = np.diag([0.2, 0.1, 0.3, 0.02, 0.01, 0.03]) ** 2
    np.testing.assert_allclose(after.object_covariance, expected, atol=1e-8)


def test_prediction_carries_hand_and_object_with_the_wrist() -> None:
    held = held_object("cuboid")
    truth, hand = track_of(held, SURE), built_in_hand().hand
    step = np.eye(4)
    step[:3, :3] = moved(np.eye(4), np.array([0.1, 0.2, -0.1, 0, 0, 0]), np.zeros(3))[:3, :3]
    step[:3, 3] = [0.01, 0.02, 0.0]
    after = predicted(truth, step @ truth.given, 0.1, False, hand, CONFIG)
    np.testing.assert_allclose(after.T_camera_object, step @ truth.T_camera_object)
    np.testing.assert_allclose(after.T_camera_hand, step @ truth.T_camera_hand)
    np.testing.assert_array_equal(after.joint_vector, truth.joint_vector)
    grown = np.linalg.eigvalsh(after.object_covariance) - np.linalg.eigvalsh(SURE)
    assert (grown > 0).all()
    later = predicted(truth, truth.given, 0.4, False, hand, CONFIG)
    sooner = predicted(truth, truth.given, 0.1, False, hand, CONFIG)
    ratio = np.diag(later.hand_covariance - truth.hand_covariance) / np.diag(
        sooner.hand_covariance - truth.hand_covariance
    )
    np.testing.assert_allclose(ratio, 4)


def resting(ways: np.ndarray) -> list[bool]:
    """Whether a hand that goes these ways [m] an image rests; given poses shake by 0.2 mm."""
    held = held_object("cuboid")
    track, hand = track_of(held, SURE), built_in_hand().hand
    start, chance = track.given, np.random.default_rng(0)
    found = []
    for place in np.cumsum(ways):
        given = start.copy()
        given[:3, 3] += [0, place, 0] + chance.normal(scale=0.0002, size=3)
        track = predicted(track, given, 1 / 30, False, hand, CONFIG)
        found.append(rests(track, hand.reach[1], CONFIG))
    return found


def test_a_hand_that_stops_rests_soon_and_one_that_starts_does_not() -> None:
    rest = resting(np.r_[np.zeros(20), np.full(20, 0.01), np.zeros(30), 0.01])
    assert all(rest[5:20])
    assert not any(rest[20:40])
    assert all(rest[46:70])
    assert not rest[70]


def test_a_hand_that_goes_slowly_does_not_rest() -> None:
    """Chance alone does not pull its speed down: it goes by a third more than a hand that rests."""
    way = 1.33 * CONFIG.rest.hand_speed / 30
    assert np.mean(resting(np.full(300, way))[20:]) < 0.05
