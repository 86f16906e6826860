from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from probe_kernels import look_up

from inhand.geometry.distance_field import DistanceField, build_distance_field
from inhand.geometry.mesh import box, sphere
from inhand.kernels.fields import pack_fields
from inhand.kernels.launch import launch

RADIUS, HALF = 0.02, np.array([0.01, 0.02, 0.015])
VOXELS = (0.001, 0.0013, 0.002)
MARGIN = 0.01
SHAPES = (sphere(RADIUS), box(2 * HALF), box(4 * HALF))


@pytest.fixture(scope="module")
def bodies() -> list[DistanceField]:
    """A sphere, a box and a finer box, of different grids, in the precision of kernels."""
    fields = [build_distance_field(m, v, MARGIN) for m, v in zip(SHAPES, VOXELS, strict=True)]
    return [replace(f, values=f.values.astype(np.float16).astype(np.float32)) for f in fields]


def values(fields: list[DistanceField], body: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance and gradient of points (n, 3) by the kernel, shape (n, 4)."""
    out = wp.empty(len(points), dtype=wp.vec4, device="cpu")
    arguments = [wp.array(body, dtype=int), wp.array(points, dtype=wp.vec3), out]
    launch(look_up, len(points), [pack_fields(fields, SHAPES, "cpu"), *arguments], "cpu")
    return np.asarray(out.numpy())


@given(st.integers(0, 10_000), st.sampled_from([0.03, 0.06, 0.5]))
@settings(max_examples=25, deadline=None)
def test_kernel_and_numpy_look_up_the_same(
    bodies: list[DistanceField], seed: int, reach: float
) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-reach, reach, (200, 3)).astype(np.float32)
    body = rng.integers(0, 3, len(points))
    found = values(bodies, body, points)
    expected = np.array([bodies[b].distance(p[None])[0] for b, p in zip(body, points, strict=True)])
    # Between two voxels rounding decides which one is nearest.
    origin = np.stack([f.origin for f in bodies])[body]
    voxel = np.array(VOXELS)[body][:, None]
    shape = np.array([f.values.shape[:3] for f in bodies])[body]
    place = np.clip((points - origin) / voxel, 0, shape - 1)
    clear = (np.abs(place % 1 - 0.5) > 1e-3).all(axis=1)
    assert clear.mean() > 0.9
    np.testing.assert_allclose(found[clear, 0], expected[clear], atol=2e-7, rtol=1e-6)


def test_distance_and_gradient_of_a_sphere(bodies: list[DistanceField]) -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.025, 0.025, (2000, 3))
    radius = np.linalg.norm(points, axis=1)
    points, radius = points[radius > 0.005], radius[radius > 0.005]
    found = values(bodies, np.zeros(len(points), int), points)
    np.testing.assert_allclose(found[:, 0], radius - RADIUS, atol=2e-4)
    np.testing.assert_allclose(np.linalg.norm(found[:, 1:], axis=1), 1, atol=5e-4)
    outward = points / radius[:, None]
    assert np.einsum("ij,ij->i", found[:, 1:], outward).min() > 0.95


def test_distance_of_a_box(bodies: list[DistanceField]) -> None:
    points = np.random.default_rng(1).uniform(-1, 1, (2000, 3)) * (HALF + 0.8 * MARGIN)
    outside = np.abs(points) - HALF
    expected = np.linalg.norm(np.maximum(outside, 0), axis=1) + np.minimum(outside.max(axis=1), 0)
    found = values(bodies, np.ones(len(points), int), points)[:, 0]
    # Where two faces are equally near, the nearest voxel may look at the other one.
    np.testing.assert_allclose(found, expected, atol=VOXELS[1])
    assert np.median(np.abs(found - expected)) < 1e-6


def test_far_outside_the_grid_the_distance_is_never_too_small(bodies: list[DistanceField]) -> None:
    points = np.random.default_rng(2).uniform(-1, 1, (2000, 3))
    true = np.linalg.norm(points, axis=1) - RADIUS
    found = values(bodies, np.zeros(len(points), int), points)[:, 0]
    assert (found > true - 2e-4).all()
    assert (found < true + 0.03).all()
    along_axis = values(bodies, np.array([0]), np.array([[0.0, 0.9, 0.0]]))[0, 0]
    assert along_axis == pytest.approx(0.88, abs=1e-4)


@pytest.mark.parametrize("body", range(3))
def test_the_box_around_a_surface_is_tight(bodies: list[DistanceField], body: int) -> None:
    extent = [np.full(3, RADIUS), HALF, 2 * HALF][body]
    packed = pack_fields(bodies, SHAPES, "cpu")
    low, high = packed.low.numpy()[body], packed.high.numpy()[body]
    assert (low <= -extent + 1e-6).all()
    assert (high >= extent - 1e-6).all()
    assert np.abs([low + extent, high - extent]).max() < 3 * VOXELS[body]
