import numpy as np
import pytest
from scipy.spatial import cKDTree

from inhand.errors import InputError
from inhand.geometry import se3
from inhand.geometry.mesh import TriangleMesh, box, concatenate, cylinder, sphere, transformed
from inhand.geometry.sampling import sample_surface


def test_samples_lie_on_the_surface_with_outward_unit_normals() -> None:
    s = sample_surface(sphere(0.03), 500, 0)
    assert s.points.dtype == s.normals.dtype == np.float32
    assert s.points.shape == s.normals.shape == (500, 3)
    radius = np.linalg.norm(s.points, axis=1)
    assert 0.0298 < radius.min() <= radius.max() < 0.03001
    np.testing.assert_allclose(np.linalg.norm(s.normals, axis=1), 1, atol=1e-6)
    assert np.einsum("ij,ij->i", s.normals, s.points / radius[:, None]).min() > 0.99


@pytest.mark.parametrize("prefix", [30, 100, 400])
def test_every_prefix_is_even(prefix: int) -> None:
    mesh = cylinder(0.02, 0.08)
    everywhere = sample_surface(mesh, 3000, 1).points
    points = sample_surface(mesh, 400, 0).points[:prefix]
    tree = cKDTree(points)
    spacing = tree.query(points, k=2)[0][:, 1].min()
    largest_gap = tree.query(everywhere)[0].max()
    # Farthest-point order: no two samples are closer than the largest hole that is left,
    # up to the gaps between the candidates.
    assert largest_gap < 1.25 * spacing


def test_prefixes_do_not_depend_on_the_count() -> None:
    mesh = box([0.03, 0.04, 0.05])
    few, many = sample_surface(mesh, 50, 7), sample_surface(mesh, 100, 7)
    np.testing.assert_array_equal(few.points, many.points[:50])


def test_same_seed_same_samples() -> None:
    mesh = box([0.03, 0.04, 0.05])
    first, again, other = (sample_surface(mesh, 200, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.points, again.points)
    np.testing.assert_array_equal(first.normals, again.normals)
    assert not np.array_equal(first.points, other.points)


def test_hidden_body_and_overlap_are_left_out() -> None:
    shifted = transformed(box([0.05, 0.05, 0.05]), se3.exp(np.array([0, 0, 0, 0.03, 0, 0])))
    inner = transformed(sphere(0.01), se3.exp(np.array([0, 0, 0, -0.01, 0, 0])))
    s = sample_surface(concatenate([box([0.05] * 3), inner, shifted]), 600, 0)
    beyond = np.maximum(np.abs(s.points), np.abs(s.points - [0.03, 0, 0])) - 0.025
    outline = np.minimum(np.abs(s.points), np.abs(s.points - [0.03, 0, 0])).max(axis=1)
    assert outline.min() > 0.025 - 1e-5
    assert beyond.max() < 0.0301


def test_inner_walls_of_a_closed_housing_are_left_out() -> None:
    wall = box([0.046] * 3)
    cavity = TriangleMesh(wall.vertices, wall.faces[:, ::-1])
    s = sample_surface(concatenate([box([0.05] * 3), cavity]), 300, 0)
    np.testing.assert_allclose(np.abs(s.points).max(axis=1), 0.025, atol=1e-6)


def test_normals_look_outward_on_mixed_winding() -> None:
    mesh = cylinder(0.02, 0.06)
    flip = np.random.default_rng(4).random(len(mesh.faces)) < 0.5
    mixed = TriangleMesh(mesh.vertices, np.where(flip[:, None], mesh.faces[:, ::-1], mesh.faces))
    s = sample_surface(mixed, 400, 0)
    assert np.einsum("ij,ij->i", s.points, s.normals).min() > 0.015


def test_nothing_to_sample_is_an_input_error() -> None:
    with pytest.raises(InputError, match="positive"):
        sample_surface(box([1, 1, 1]), 0, 0)
