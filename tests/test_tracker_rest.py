"""What is answered while nothing moves: a pose that stays until the estimate says it is wrong."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from inhand.geometry import se3
from inhand.geometry.se3 import moved
from inhand.tracking.config import TrackerConfig
from inhand.tracking.gaussian import twist_between
from inhand.tracking.rest import rests, with_answer
from inhand.tracking.track import Track

CONFIG = TrackerConfig()
CENTRE = np.array([0.01, 0.0, 0.02])
REACH = 0.2
T = se3.exp(np.array([0.2, -0.4, 0.3, 0.05, 0.1, 0.5]))
SD = np.array([0.1, 0.005, 0.005, 0.0003, 0.0003, 0.0003])
"""The first turn is hardly known, all else well."""
TRACK = Track(
    given=np.eye(4),
    T_camera_hand=np.eye(4),
    joint_vector=np.zeros(1),
    hand_covariance=np.eye(7),
    certain=np.ones(1, dtype=bool),
    T_camera_object=T,
    object_covariance=np.diag(SD**2),
    lasting=np.zeros((6, 6)),
    motion=np.zeros(6),
    motion_covariance=np.diag(SD**2) / 9,
    hand_motion=np.zeros(6),
    answer=T,
    images=20,
    confidence=0.9,
)


def off(*twist: float) -> np.ndarray:
    """How far the answer is from the estimate, which it was this twist away from."""
    track = replace(TRACK, answer=moved(T, np.array(twist), CENTRE))
    return twist_between(T, with_answer(track, CENTRE, REACH, CONFIG).answer, CENTRE)


def test_where_the_image_says_little_the_answer_stays() -> None:
    np.testing.assert_allclose(off(0.05, 0, 0, 0, 0, 0), [0.05, 0, 0, 0, 0, 0], atol=1e-9)


def test_where_the_image_says_more_it_is_the_estimate() -> None:
    np.testing.assert_allclose(off(0, 0.01, 0, 0, 0.001, 0), np.zeros(6), atol=1e-9)


def test_it_is_drawn_along_when_the_estimate_goes_too_far() -> None:
    most = CONFIG.rest.doubt * (0.1 - CONFIG.rest.least_doubt / CONFIG.object.lever)
    np.testing.assert_allclose(off(-0.3, 0, 0, 0, 0, 0), [-most, 0, 0, 0, 0, 0], atol=1e-9)


@given(st.tuples(*[st.floats(-0.2, 0.2)] * 6).map(np.array))
def test_it_never_goes_farther_from_the_estimate(twist: np.ndarray) -> None:
    scale = np.array([CONFIG.object.lever] * 3 + [1.0] * 3)
    assert np.linalg.norm(scale * off(*twist)) <= np.linalg.norm(scale * twist) + 1e-9


def test_motion_of_the_object_or_of_the_hand_brings_it_to_the_estimate() -> None:
    away = replace(TRACK, answer=moved(T, np.array([0.05, 0, 0, 0, 0, 0]), CENTRE))
    moves = replace(away, motion=np.array([0, 0, 0, 0, 0.002, 0]))
    carried = replace(away, hand_motion=np.array([0, 0, 0, 0.05, 0, 0]))
    turned = replace(away, hand_motion=np.array([0, 0.2, 0, 0, 0, 0]))
    for track in (moves, carried, turned):
        assert not rests(track, REACH, CONFIG)
        left = twist_between(T, with_answer(track, CENTRE, REACH, CONFIG).answer, CENTRE)
        np.testing.assert_allclose(left[0], 0.05 * CONFIG.rest.closing)


def test_after_a_search_it_is_the_estimate() -> None:
    there = moved(T, np.array([0.05, 0, 0, 0, 0, 0]), CENTRE)
    track = replace(TRACK, answer=there, images=CONFIG.rest.settling)
    np.testing.assert_array_equal(with_answer(track, CENTRE, REACH, CONFIG).answer, T)
