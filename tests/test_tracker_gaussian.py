"""Poses with a Gaussian error: twists against SciPy and finite differences, beliefs over images."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from inhand.geometry import se3
from inhand.geometry.se3 import moved
from inhand.tracking.config import LossConfig
from inhand.tracking.gaussian import (
    about_origin,
    carried,
    fused,
    rotation_vector,
    twist_between,
)
from inhand.tracking.loss import expected_confidence, seen_confidence

vectors = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array)
twists = st.tuples(*[st.floats(-1.7, 1.7)] * 6).map(np.array)


@given(vectors, st.floats(0, np.pi))
def test_rotation_vectors_are_scipys(axis: np.ndarray, angle: float) -> None:
    R = Rotation.from_rotvec(axis / max(np.linalg.norm(axis), 1e-9) * angle).as_matrix()
    back = Rotation.from_rotvec(rotation_vector(R)).as_matrix()
    np.testing.assert_allclose(back, R, atol=1e-7)


@given(twists, twists, vectors)
def test_the_twist_between_two_poses_moves_one_to_the_other(
    at: np.ndarray, twist: np.ndarray, pivot: np.ndarray
) -> None:
    T = se3.exp(at)
    to = moved(T, twist, pivot)
    np.testing.assert_allclose(moved(T, twist_between(T, to, pivot), pivot), to, atol=1e-7)
    way = se3.transform(to, pivot[None]) - se3.transform(T, pivot[None])
    np.testing.assert_allclose(way[0], twist[3:], atol=1e-9)


@given(twists, twists, vectors)
def test_a_covariance_about_the_origin_is_that_of_the_moved_origin(
    at: np.ndarray, scale: np.ndarray, pivot: np.ndarray
) -> None:
    T, sd = se3.exp(at), 1e-5 * (1 + np.abs(scale))
    samples = np.random.default_rng(0).normal(size=(4000, 6)) * sd
    origin = np.zeros(3)
    seen = np.stack([twist_between(T, moved(T, twist, pivot), origin) for twist in samples])
    expected = about_origin(np.diag(sd**2), T, pivot)
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert (np.abs(np.cov(seen.T) - expected) / size).max() < 0.15


@given(twists, twists, vectors)
def test_what_two_poses_say_together(at: np.ndarray, values: np.ndarray, pivot: np.ndarray) -> None:
    """Informations add up, and the pose between them is weighed by them."""
    A = np.random.default_rng(2).normal(size=(6, 6))
    one, other = A @ A.T + np.eye(6), np.diag(1 + np.abs(values))
    T = se3.exp(at)
    there = moved(T, 1e-4 * values, pivot)
    between, covariance = fused((T, one), (there, other), pivot)
    information = np.linalg.inv(one) + np.linalg.inv(other)
    np.testing.assert_allclose(covariance @ information, np.eye(6), atol=1e-7)
    step = covariance @ np.linalg.solve(other, 1e-4 * values)
    np.testing.assert_allclose(twist_between(T, between, pivot), step, atol=1e-7)


@given(twists, vectors)
def test_a_carried_covariance_keeps_its_size_and_what_is_not_a_pose(
    values: np.ndarray, turn: np.ndarray
) -> None:
    A = np.random.default_rng(1).normal(size=(8, 8)) + np.diag(np.append(values, [2, 3]))
    covariance = A @ A.T
    R = se3.exp_so3(turn)
    out = carried(covariance, R)
    np.testing.assert_allclose(np.linalg.eigvalsh(out), np.linalg.eigvalsh(covariance))
    np.testing.assert_allclose(out[6:, 6:], covariance[6:, 6:])
    np.testing.assert_allclose(out[:3, :3], R @ covariance[:3, :3] @ R.T)


@given(st.floats(0.01, 0.99), st.floats(-1, 3), st.floats(0.01, 1))
def test_a_better_score_makes_surer(expected: float, score: float, more: float) -> None:
    config = LossConfig()
    assert seen_confidence(expected, score + more, config) > seen_confidence(
        expected, score, config
    )


def test_a_pose_that_explains_nothing_is_given_up_within_three_images() -> None:
    config, confidence = LossConfig(), 1.0
    for _ in range(3):
        confidence = seen_confidence(expected_confidence(confidence, config), 0.0, config)
    assert confidence < config.lost


def test_one_bad_image_does_not_end_a_good_track() -> None:
    config = LossConfig()
    confidence = seen_confidence(expected_confidence(0.99, config), 0.5, config)
    assert confidence > config.lost
    again = seen_confidence(expected_confidence(confidence, config), 1.8, config)
    assert again > 0.9
