from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from inhand.geometry import se3
from inhand.geometry.distance_field import DistanceField, build_distance_field
from inhand.geometry.mesh import (
    TriangleMesh,
    box,
    concatenate,
    cylinder,
    load_mesh,
    sphere,
    transformed,
)

Array = NDArray[Any]

VOXEL, MARGIN = 0.002, 0.012


def voxel_centres(field: DistanceField) -> Array:
    index = np.stack(np.meshgrid(*map(np.arange, field.values.shape[:3]), indexing="ij"), axis=-1)
    return (field.origin + field.voxel * index).reshape(-1, 3)


def box_distance(points: Array, extents: Array) -> Array:
    q = np.abs(points) - extents / 2
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)


def test_sphere() -> None:
    field = build_distance_field(sphere(0.03), VOXEL, MARGIN)
    points = voxel_centres(field)
    radius = np.linalg.norm(points, axis=1)
    values = field.values.reshape(-1, 4)
    np.testing.assert_allclose(values[:, 0], radius - 0.03, atol=2e-4)
    # Near the centre every direction is a gradient.
    off = radius > 0.004
    cosine = np.einsum("ij,ij->i", values[off, 1:], points[off] / radius[off, None])
    assert cosine.min() > 0.98


@settings(max_examples=10, deadline=None)
@given(
    extents=st.tuples(*[st.floats(0.01, 0.06)] * 3),
    twist=st.tuples(*[st.floats(-3, 3)] * 3, *[st.floats(-0.2, 0.2)] * 3),
    seed=st.integers(0, 1000),
)
def test_any_box_anywhere(extents: tuple[float, ...], twist: tuple[float, ...], seed: int) -> None:
    T = se3.exp(np.array(twist))
    size = np.array(extents)
    field = build_distance_field(transformed(box(size), T), VOXEL, MARGIN)
    centres = voxel_centres(field)
    exact = box_distance(se3.transform(se3.inverse(T), centres), size)
    np.testing.assert_allclose(field.values[..., 0].reshape(-1), exact, atol=2e-6)
    np.testing.assert_allclose(np.linalg.norm(field.values[..., 1:], axis=-1), 1, atol=1e-4)

    # Between the voxel centres, first order: off only where the nearest face changes.
    rng = np.random.default_rng(seed)
    within = rng.uniform(centres.min(axis=0), centres.max(axis=0), (500, 3))
    error = np.abs(
        field.distance(within) - box_distance(se3.transform(se3.inverse(T), within), size)
    )
    assert error.max() < 3**0.5 * VOXEL
    assert error.mean() < 0.1 * VOXEL
    # Beyond the grid: never less than the truth.
    far = rng.uniform(-0.3, 0.3, (100, 3))
    assert (field.distance(se3.transform(T, far)) > box_distance(far, size) - VOXEL).all()


def test_gradient_points_uphill() -> None:
    field = build_distance_field(cylinder(0.02, 0.05), VOXEL, MARGIN)
    distance = field.values[..., 0].astype(float)
    slope = np.stack(np.gradient(distance, VOXEL), axis=-1)
    smooth = np.linalg.norm(slope, axis=-1) > 0.98
    cosine = np.einsum("...i,...i->...", slope, field.values[..., 1:])
    assert smooth.mean() > 0.7
    assert np.quantile(cosine[smooth], 0.01) > 0.95


def test_gradient_on_the_surface_is_the_outward_normal() -> None:
    # Voxel centres fall exactly on the faces at +-0.02.
    inverted = TriangleMesh(box([0.04] * 3).vertices, box([0.04] * 3).faces[:, ::-1])
    for mesh in (box([0.04] * 3), inverted):
        field = build_distance_field(mesh, 0.0025, 0.01)
        middle = field.values.shape[1] // 2
        column = field.values[:, middle, middle]
        on_surface = np.flatnonzero(np.abs(column[:, 0]) < 1e-6)
        assert len(on_surface) == 2
        np.testing.assert_allclose(column[on_surface, 1:], [[-1, 0, 0], [1, 0, 0]], atol=1e-5)


def test_agrees_with_open3d() -> None:
    o3d = pytest.importorskip("open3d", exc_type=ImportError)
    T = se3.exp(np.array([0.4, -0.8, 0.3, 0.01, 0.0, 0.02]))
    mesh = concatenate([cylinder(0.02, 0.06), transformed(sphere(0.01), T)])
    mesh = concatenate([mesh, transformed(box([0.01, 0.02, 0.03]), se3.exp(np.eye(6)[4] * 0.05))])
    field = build_distance_field(mesh, VOXEL, MARGIN)
    points = voxel_centres(field).astype(np.float32)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    unsigned = scene.compute_distance(points).numpy()
    ours = field.values[..., 0].reshape(-1)
    np.testing.assert_allclose(np.abs(ours), unsigned, atol=1e-6)
    # Open3D counts crossings, so it sees a hole where two bodies overlap: compare outside only.
    outside = scene.compute_signed_distance(points, nsamples=11).numpy() > 1e-6
    assert (ours[outside] > 0).mean() > 0.99
    assert (ours[~outside] < 1e-6).all()


def test_box_with_a_missing_face_still_has_an_inside() -> None:
    # Finely tessellated, and one small square of a side is missing.
    size, n = 0.04, 8
    solid = box([size] * 3)
    grid = np.linspace(-size / 2, size / 2, n + 1)
    u, v = np.meshgrid(grid, grid, indexing="ij")
    corner = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    quads = np.stack([a, b, c, d], axis=-1).reshape(-1, 4)
    lid = np.delete(quads, 3 * n + 4, axis=0)
    faces = np.concatenate([lid[:, [0, 1, 2]], lid[:, [0, 2, 3]]]).astype(np.int32)
    top = TriangleMesh(np.stack([u.ravel(), v.ravel(), np.full(u.size, size / 2)], axis=-1), faces)
    rest = TriangleMesh(solid.vertices, solid.faces[solid.face_normals[:, 2] < 0.5])
    field = build_distance_field(concatenate([rest, top]), 0.001, MARGIN)
    points = voxel_centres(field)
    exact = box_distance(points, np.full(3, size))
    sign_matters = np.abs(exact) > 0.002
    wrong = np.sign(field.values[..., 0].reshape(-1)) != np.sign(exact)
    assert not (wrong & sign_matters).any()


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_winding_of_the_input_does_not_matter(share: float) -> None:
    mesh = cylinder(0.02, 0.05)
    flip = np.random.default_rng(1).random(len(mesh.faces)) < share
    mixed = TriangleMesh(mesh.vertices, np.where(flip[:, None], mesh.faces[:, ::-1], mesh.faces))
    ours = build_distance_field(mixed, VOXEL, MARGIN).values[..., 0]
    np.testing.assert_allclose(ours, build_distance_field(mesh, VOXEL, MARGIN).values[..., 0])


def test_overlapping_bodies_are_inside() -> None:
    shifted = transformed(box([0.04] * 3), se3.exp(np.array([0, 0, 0, 0.02, 0, 0])))
    field = build_distance_field(concatenate([box([0.04] * 3), shifted]), VOXEL, MARGIN)
    assert (
        field.distance(np.array([[0.01, 0.001, 0.001], [-0.015, 0, 0], [0.035, 0, 0]])) < 0
    ).all()


def test_open_sheet_has_no_inside() -> None:
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]]) * 0.03
    bend = np.array([[0, 0, 0.01]]) * (square[:, :1] > 0)
    sheet = TriangleMesh(square + bend, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32))
    field = build_distance_field(sheet, VOXEL, MARGIN)
    values = field.values[..., 0]
    assert (values[np.abs(values) > 0.001] > 0).all()


def test_grid_covers_mesh_and_margin() -> None:
    mesh = transformed(box([0.03, 0.05, 0.02]), se3.exp(np.array([0, 0, 0, 1.0, -2.0, 0.5])))
    field = build_distance_field(mesh, VOXEL, MARGIN)
    top = field.origin + field.voxel * (np.array(field.values.shape[:3]) - 1)
    assert (field.origin <= mesh.bounds[0] - MARGIN + 1e-6).all()
    assert (top >= mesh.bounds[1] + MARGIN - 1e-6).all()


def test_non_watertight_hand_link(shared_data: Path) -> None:
    o3d = pytest.importorskip("open3d", exc_type=ImportError)
    mesh = load_mesh(shared_data / "hands" / "t42" / "meshes" / "baseOl.STL", 0.001)
    field = build_distance_field(mesh, 0.004, 0.02)
    points = voxel_centres(field).astype(np.float32)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    ours = field.values[..., 0].reshape(-1)
    np.testing.assert_allclose(np.abs(ours), scene.compute_distance(points).numpy(), atol=1e-6)
    # A thin shell around a hollow that opens to the outside: nothing is deeper than its wall.
    assert ours.min() > -0.006
    assert (ours < 0).any()
