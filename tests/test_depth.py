import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference_depth import open3d_depth, plane_depth, sphere_depth

from inhand.camera import Camera
from inhand.geometry.mesh import TriangleMesh, box, cylinder, sphere
from inhand.geometry.se3 import exp, random_rotation, rotation_between
from inhand.kernels.depth import DepthRenderer, bounding_sphere

CAMERA = Camera(fx=150, fy=120, cx=70.3, cy=31.8, width=131, height=77)
MESHES = [box([0.1, 0.06, 0.08]), sphere(0.05), cylinder(0.02, 0.15), box([0.3, 0.002, 0.2])]


def at(x: float, y: float, z: float) -> np.ndarray:
    return exp(np.array([0, 0, 0, x, y, z]))


@given(
    st.lists(st.integers(0, len(MESHES) - 1), min_size=1, max_size=6),
    st.sampled_from([(0.3, 0.8), (-0.15, 0.15)]),
    st.integers(0, 10_000),
)
@settings(max_examples=30, deadline=None)
def test_random_scenes_look_as_in_open3d(
    chosen: list[int], range_z: tuple[float, float], seed: int
) -> None:
    """Several meshes that overlap in the image and in space; some around the camera itself."""
    rng = np.random.default_rng(seed)
    meshes = [MESHES[i] for i in chosen]
    poses = np.tile(np.eye(4), (len(meshes), 1, 1))
    poses[:, :3, :3] = [random_rotation(rng) for _ in meshes]
    poses[:, :3, 3] = rng.uniform(
        [-0.15, -0.1, range_z[0]], [0.15, 0.1, range_z[1]], (len(poses), 3)
    )
    depth, index = DepthRenderer(meshes).render(CAMERA, poses)
    expected, expected_index = open3d_depth(meshes, poses, CAMERA)
    assert depth.shape == index.shape == (77, 131)
    np.testing.assert_array_equal(depth > 0, index >= 0)
    # A ray along a silhouette may go either way.
    same = index == expected_index
    assert same.mean() > 0.99
    both = same & (index >= 0)
    np.testing.assert_allclose(depth[both], expected[both], rtol=1e-3, atol=1e-5)
    assert not both.any() or np.median(np.abs(depth - expected)[both]) < 1e-6


@given(st.floats(-0.7, 0.7), st.floats(-0.7, 0.7), st.floats(0.2, 1.5))
@settings(max_examples=20, deadline=None)
def test_planes_in_closed_form(x: float, y: float, distance: float) -> None:
    normal = np.array([x, y, 1.0]) / np.linalg.norm([x, y, 1.0])
    slab = exp(np.zeros(6))
    slab[:3, :3] = rotation_between(np.array([0, 0, 1.0]), normal)
    slab[:3, 3] = (distance + 0.05) * normal
    depth, _ = DepthRenderer([box([20, 20, 0.1])]).render(CAMERA, slab[None])
    expected = plane_depth(CAMERA, normal, distance)
    near = (expected > 0) & (expected < 5)
    assert near.any()
    np.testing.assert_allclose(depth[near], expected[near], rtol=1e-5)


def test_a_sphere_in_closed_form() -> None:
    centre, radius = np.array([0.02, -0.015, 0.4]), 0.06
    depth, _ = DepthRenderer([sphere(radius)]).render(CAMERA, at(*centre)[None])
    expected = sphere_depth(CAMERA, centre, radius)
    assert ((depth > 0) != (expected > 0)).mean() < 0.005
    both = (depth > 0) & (expected > 0)
    # The facets lie up to 0.1 mm inside, which counts more where rays graze.
    assert np.abs(depth - expected)[both].max() < 0.003
    assert np.median(np.abs(depth - expected)[both]) < 1e-4


def test_the_nearest_mesh_wins_whatever_the_order() -> None:
    meshes = [sphere(0.03), box([0.2, 0.2, 0.01]), cylinder(0.02, 0.1)]
    poses = np.stack([at(0, 0, 0.3), at(0, 0, 0.5), at(0.04, 0, 0.4)])
    depth, index = DepthRenderer(meshes).render(CAMERA, poses)
    assert set(np.unique(index)) == {-1, 0, 1, 2}
    assert index[32, 70] == 0
    for order in ([2, 1, 0], [1, 2, 0], [2, 0, 1]):
        again, again_index = DepthRenderer([meshes[i] for i in order]).render(CAMERA, poses[order])
        np.testing.assert_array_equal(again, depth)
        hit = again_index >= 0
        np.testing.assert_array_equal(np.array(order)[again_index[hit]], index[hit])


def test_what_is_behind_the_camera_is_not_seen() -> None:
    meshes = [sphere(0.05), box([0.1, 0.1, 0.1])]
    renderer = DepthRenderer(meshes)
    depth, index = renderer.render(CAMERA, np.stack([at(0, 0, -0.3), at(0.1, 0, -0.06)]))
    assert (depth == 0).all()
    assert (index == -1).all()
    # It does not hide what is in front either.
    _, index = renderer.render(CAMERA, np.stack([at(0, 0, 0.4), at(0, 0, -0.4)]))
    assert set(np.unique(index)) == {-1, 0}


def test_from_inside_the_far_walls_are_seen() -> None:
    depth, index = DepthRenderer([box([8, 8, 2])]).render(CAMERA, np.eye(4)[None])
    assert (index == 0).all()
    np.testing.assert_allclose(depth, 1.0, rtol=1e-6)


def test_a_renderer_can_be_used_again_at_other_poses() -> None:
    renderer = DepthRenderer([sphere(0.05)])
    first, _ = renderer.render(CAMERA, at(0, 0, 0.4)[None])
    moved, _ = renderer.render(CAMERA, at(0.02, 0, 0.4)[None])
    again, _ = renderer.render(CAMERA, at(0, 0, 0.4)[None])
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, moved)


@given(st.integers(3, 30), st.integers(0, 1000))
@settings(deadline=None)
def test_bounding_spheres_hold_every_vertex(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    vertices = rng.normal(rng.uniform(-1, 1, 3), 0.1, (count, 3))
    mesh = TriangleMesh(vertices, rng.integers(0, count, (5, 3)).astype(np.int32))
    *centre, radius = bounding_sphere(mesh)
    assert np.linalg.norm(vertices - centre, axis=1).max() <= radius
    assert radius <= np.linalg.norm(np.ptp(vertices, axis=0)) / 2 + 1e-3


def test_the_bounding_sphere_of_a_sphere() -> None:
    assert bounding_sphere(sphere(0.05)) == pytest.approx([0, 0, 0, 0.05], abs=1e-4)
