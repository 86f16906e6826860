"""Rotations as angles that a user types, against turns made one after the other."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from inhand.annotation.angles import angles_of, rotation_of
from inhand.geometry.se3 import exp_so3

angle = st.floats(-180, 180)


@given(angle, angle, angle)
def test_first_about_x_then_y_then_z_of_the_camera(x: float, y: float, z: float) -> None:
    turns = [exp_so3(np.radians(a) * axis) for a, axis in zip((x, y, z), np.eye(3), strict=True)]
    expected = turns[2] @ turns[1] @ turns[0]
    np.testing.assert_allclose(rotation_of(np.array([x, y, z])), expected, atol=1e-12)


@given(angle, st.one_of(angle, st.sampled_from([-90.0, 90.0])), angle)
def test_the_angles_of_a_rotation_give_it_again(x: float, y: float, z: float) -> None:
    rotation = rotation_of(np.array([x, y, z]))
    angles = angles_of(rotation)
    assert abs(angles[1]) <= 90
    np.testing.assert_allclose(rotation_of(angles), rotation, atol=3e-6)


@given(st.floats(-179, 179), st.floats(-89, 89), st.floats(-179, 179))
def test_angles_in_range_stay_as_they_are(x: float, y: float, z: float) -> None:
    angles = np.array([x, y, z])
    assert angles_of(rotation_of(angles)) == pytest.approx(angles, abs=1e-6)
