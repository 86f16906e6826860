"""Errors of the hand's state, against what they are by construction."""

import numpy as np
import pytest

from inhand.evaluation.hand_errors import angle_errors, wrist_error
from inhand.geometry.se3 import exp


def test_wrist_error_is_rotation_and_translation_of_the_hand_frame() -> None:
    rng = np.random.default_rng(0)
    T = exp(rng.normal(size=6))
    off = T @ exp(np.array([0, 0.05, 0, 0, 0, 0]))
    off[:3, 3] += 0.002 * T[:3, 2]
    assert wrist_error(off, T) == pytest.approx((0.002, 0.05))


def test_whole_turns_of_a_joint_do_not_count() -> None:
    errors = angle_errors(
        {"a": 0.5, "b": 3.1, "c": 0.1 + 2 * np.pi, "mimic": 1.0}, {"a": 0.2, "b": -3.1, "c": 0.0}
    )
    assert errors == pytest.approx({"a": 0.3, "b": 2 * np.pi - 6.2, "c": 0.1})
