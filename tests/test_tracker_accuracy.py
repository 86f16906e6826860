"""How well a pose is known: against samples of poses, and of objects with symmetries."""

import numpy as np
import pytest
from scipy.special import erf

from inhand.geometry.se3 import moved, transform
from inhand.synth.demo import builtin_object
from inhand.tracking.accuracy import sensor_covariance, surface_within

SMALL = np.diag([0.02] * 3 + [0.001] * 3) ** 2


@pytest.mark.parametrize("scale", [1.0, 3.0, 10.0])
def test_it_is_the_share_of_samples(scale: float) -> None:
    form, covariance = builtin_object("cuboid").surface_form, scale**2 * SMALL
    twists = np.random.default_rng(0).multivariate_normal(np.zeros(6), covariance, 20_000)
    square = np.einsum("ni,ij,nj->n", twists, form, twists)
    for distance in (0.001, 0.005, 0.02):
        share = np.mean(square < distance**2)
        assert abs(surface_within(covariance, form, distance) - share) < 0.05


def test_the_form_is_how_far_the_surface_moves() -> None:
    obj = builtin_object("industrial_part")
    twist = np.array([0.01, -0.005, 0.008, 0.0004, 0.0002, -0.0003])
    points, normals = obj.surface.points, obj.surface.normals
    way = transform(moved(np.eye(4), twist, obj.centre), points) - points
    along = np.einsum("ni,ni->n", way, normals)
    expected = np.mean(along**2)
    assert twist @ obj.surface_form @ twist == pytest.approx(expected, rel=0.02)


def test_what_a_symmetry_does_not_change_may_be_unknown() -> None:
    obj = builtin_object("cylinder")
    form, axis = obj.surface_form, np.asarray(obj.symmetry.axis)
    turned = SMALL / 100
    turned[:3, :3] += np.outer(axis, axis)
    assert surface_within(turned, form, 0.005) > 0.99
    across = np.cross(axis, [0.3, -0.5, 0.8])
    turned[:3, :3] += np.outer(across, across)
    # One direction alone, whose sd is known: the surface is off by a normal distribution.
    sd = np.sqrt(across @ form[:3, :3] @ across)
    assert surface_within(turned, form, 0.005) == pytest.approx(erf(0.005 / sd / 2**0.5), abs=0.01)


def test_the_less_is_known_the_less_likely() -> None:
    form = builtin_object("bottle").surface_form
    chances = [surface_within(scale**2 * SMALL, form, 0.005) for scale in (0.1, 1, 3, 10, 100)]
    assert chances == sorted(chances, reverse=True)
    assert chances[0] > 0.999
    assert chances[-1] < 0.01


def test_a_sensor_is_off_along_the_line_of_sight_and_across_it() -> None:
    T, centre = np.eye(4), np.array([0.1, -0.2, 0.3])
    T[:3, 3] = [0.2, 0.2, 0.1]
    covariance = sensor_covariance(T, centre, 0.003, 0.001)
    sight = np.array([0.3, 0.0, 0.4]) / 0.5
    assert sight @ covariance[3:, 3:] @ sight == pytest.approx(0.003**2)
    for across in ([0.0, 1.0, 0.0], [0.8, 0.0, -0.6]):
        np.testing.assert_allclose(covariance[3:, 3:] @ across, 0.001**2 * np.array(across))
    assert not covariance[:3].any()
    assert not covariance[:, :3].any()
