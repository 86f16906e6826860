from dataclasses import replace

import numpy as np
import warp as wp
from hand_made import view
from hypothesis import given, settings
from hypothesis import strategies as st
from reference_depth import plane_depth, rays, sphere_depth
from scipy.ndimage import correlate

from inhand.camera import Camera
from inhand.kernels.depth_image import RowSums, fit_planes, missing_in_rows, missing_share, sum_rows
from inhand.kernels.launch import computed, launch

CAMERA = Camera(fx=420, fy=380, cx=50.3, cy=20.8, width=83, height=57)
WINDOW, GATE = 0.005, 2.0


def fitted(
    depth: np.ndarray, window: float = WINDOW, gate: float = GATE, far: float = 100.0
) -> tuple[np.ndarray, np.ndarray]:
    """Smoothed depth (H, W) and normals (H, W, 3)."""
    seen = view(CAMERA, depth)
    sums = wp.empty(depth.size, dtype=RowSums, device="cpu")
    inputs = [seen, window, gate, far, sums]
    launch(sum_rows, depth.size, inputs, "cpu")
    smooth = computed(fit_planes, depth.shape, float, inputs, "cpu", work_per_item=25)
    return smooth, seen.normals.numpy().reshape(*depth.shape, 3)


def angles(normals: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Angles [degrees] between unit vectors (..., 3)."""
    return np.degrees(np.arccos(np.clip((normals * expected).sum(axis=-1), -1, 1)))


slopes = st.floats(-0.7, 0.7)


@given(slopes, slopes, st.floats(0.2, 1.5))
@settings(max_examples=30, deadline=None)
def test_planes_are_found_exactly_up_to_the_border(x: float, y: float, distance: float) -> None:
    normal = np.array([x, y, 1.0]) / np.linalg.norm([x, y, 1.0])
    depth = plane_depth(CAMERA, normal, distance)
    smooth, normals = fitted(depth, window=0.02, gate=5)
    np.testing.assert_allclose(smooth, depth, rtol=1e-5)
    assert angles(normals, -normal).max() < 0.5
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, atol=1e-5)


def test_normals_and_depth_of_a_noisy_plane_with_holes() -> None:
    rng = np.random.default_rng(0)
    normal = np.array([0.3, -0.4, np.sqrt(0.75)])
    true = plane_depth(CAMERA, normal, 0.4)
    noisy = true + rng.normal(0, 0.0005, true.shape)
    holes = rng.random(true.shape) < 0.2
    noisy[holes] = 0
    smooth, normals = fitted(noisy)
    assert (smooth[holes] == 0).all()
    assert (normals[holes] == 0).all()
    known = ~holes & (normals[..., 2] != 0)
    assert known.sum() > 0.99 * (~holes).sum()
    assert np.median(angles(normals, -normal)[known]) < 4
    assert np.std((smooth - true)[known]) < 0.5 * np.std((noisy - true)[known])
    assert abs(np.mean((smooth - true)[known])) < 5e-5


def test_normals_and_depth_of_a_sphere() -> None:
    rng = np.random.default_rng(0)
    centre, radius = np.array([-0.01, 0.01, 0.4]), 0.03
    true = sphere_depth(CAMERA, centre, radius)
    outward = (rays(CAMERA) * true[..., None] - centre) / radius
    facing = -(outward * rays(CAMERA)).sum(axis=-1) / np.linalg.norm(rays(CAMERA), axis=-1)
    front = (true > 0) & (facing > 0.75)
    assert front.sum() > 1000
    smooth, normals = fitted(true)
    # A plane through a bent patch lies behind the middle of it, by the square of the patch's size.
    inward = (smooth - true)[front]
    assert -1e-6 < inward.min() < inward.max() < 0.0015
    assert (fitted(true, window=WINDOW / 2)[0] - true)[front].mean() < 0.5 * inward.mean()
    assert angles(normals, outward)[front].max() < 5
    noisy = np.where(true > 0, true + rng.normal(0, 0.0003, true.shape), 0)
    _, normals = fitted(noisy)
    assert np.median(angles(normals, outward)[front]) < 4


def test_surfaces_do_not_blend_over_a_depth_edge() -> None:
    near_normal, far_normal = np.array([0, 0, 1.0]), np.array([0.5, 0, np.sqrt(0.75)])
    near, far = plane_depth(CAMERA, near_normal, 0.3), plane_depth(CAMERA, far_normal, 0.5)
    left = np.arange(CAMERA.width) < 40
    smooth, normals = fitted(np.where(left, near, far))
    np.testing.assert_allclose(smooth, np.where(left, near, far), rtol=1e-5)
    assert angles(normals, -np.where(left[:, None], near_normal, far_normal)).max() < 0.5


def test_every_reading_of_the_window_counts_and_no_other() -> None:
    """Two noisy walls with holes, one before the other, that end along a diagonal."""
    rng = np.random.default_rng(0)
    u, v = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    near = u + v < 65
    depth = np.where(near, 0.3, 0.5) + rng.normal(0, 0.001, near.shape)
    depth[rng.random(near.shape) < 0.3] = 0
    smooth, normals = fitted(depth)
    w = 1 / np.where(depth > 0, depth, 1)
    checked = [i for i in rng.permutation(near.size) if depth.flat[i] > 0][:400]
    for v0, u0 in np.column_stack(np.unravel_index(checked, near.shape)):
        radius = 6 if near[v0, u0] else 4
        part = (abs(u - u0) <= radius) & (abs(v - v0) <= radius)
        part &= (depth > 0) & (near == near[v0, u0])
        x, y = u[part] - u0, v[part] - v0
        a, b, c = np.linalg.lstsq(np.column_stack([x, y, np.ones(len(x))]), w[part])[0]
        at_axis = c + a * (CAMERA.cx - u0) + b * (CAMERA.cy - v0)
        normal = -np.array([a * CAMERA.fx, b * CAMERA.fy, at_axis])
        assert abs(smooth[v0, u0] - 1 / c) < 1e-5
        assert angles(normals[v0, u0], normal / np.linalg.norm(normal)) < 0.2


def test_too_few_neighbours_are_no_surface() -> None:
    depth = np.zeros((CAMERA.height, CAMERA.width))
    depth[10, 10] = 0.4  # alone
    depth[30, 20:60] = 0.5  # a line
    smooth, normals = fitted(depth)
    assert (normals == 0).all()
    np.testing.assert_allclose(smooth, depth, rtol=1e-6)


def test_what_is_too_far_away_is_left_alone() -> None:
    near, far = (plane_depth(CAMERA, np.array([0, 0, 1.0]), z) for z in (0.3, 0.5))
    depth = np.where(np.arange(CAMERA.width) < 40, near, far)
    smooth, normals = fitted(depth, far=0.4)
    np.testing.assert_allclose(smooth, depth, rtol=1e-5)
    np.testing.assert_array_equal((normals != 0).any(axis=-1), depth < 0.4)


def test_an_empty_image_has_no_surface() -> None:
    smooth, normals = fitted(np.zeros((CAMERA.height, CAMERA.width)))
    assert (smooth == 0).all()
    assert (normals == 0).all()


# Missing readings


def shares(missing: np.ndarray, radius: int, usual: float = 0.0) -> np.ndarray:
    height, width = missing.shape
    camera = replace(CAMERA, width=width, height=height)
    seen = view(camera, np.where(missing, 0.0, 0.5))
    in_rows = wp.empty(missing.size, dtype=int, device="cpu")
    launch(missing_in_rows, height, [seen, radius, in_rows], "cpu")
    launch(missing_share, width, [seen, radius, in_rows, usual], "cpu")
    return np.asarray(seen.missing.numpy().reshape(missing.shape))


def expected_shares(missing: np.ndarray, radius: int) -> np.ndarray:
    """Over all pixels of the window that lie in the image."""
    window = np.ones((2 * radius + 1, 2 * radius + 1))
    count = correlate(missing.astype(float), window, mode="constant")
    total = correlate(np.ones(missing.shape), window, mode="constant")
    return np.where(missing, count / total, 0)


@given(
    st.integers(1, 30),
    st.integers(1, 30),
    st.integers(1, 40),
    st.floats(0, 1),
    st.integers(0, 1000),
)
@settings(max_examples=60, deadline=None)
def test_windows_count_every_pixel(
    height: int, width: int, radius: int, share: float, seed: int
) -> None:
    missing = np.random.default_rng(seed).random((height, width)) < share
    np.testing.assert_allclose(shares(missing, radius), expected_shares(missing, radius), atol=1e-6)


def test_small_holes_count_less_than_empty_areas() -> None:
    missing = np.zeros((60, 60), dtype=bool)
    missing[10, 10] = True
    missing[20:, 20:] = True
    share = shares(missing, 9)
    assert share[10, 10] < 0.1
    assert share[40, 40] == 1
    assert (share[~missing] == 0).all()


def test_shares_count_from_the_usual_one() -> None:
    missing = np.random.default_rng(0).random((50, 60)) < 0.6
    found, plain = shares(missing, 5, usual=0.6), expected_shares(missing, 5)
    np.testing.assert_allclose(found, np.maximum(plain - 0.6, 0) / 0.4, atol=1e-5)
    assert (shares(np.ones((50, 60), dtype=bool), 5, usual=0.6) == 1).all()
