import numpy as np
import warp as wp
from scipy.spatial import cKDTree

from inhand.geometry import mesh as meshes
from inhand.geometry.distance_field import build_distance_field
from inhand.geometry.se3 import exp, inverse, transform
from inhand.kernels.fields import pack_fields
from inhand.kernels.launch import launch
from inhand.kernels.lcp import SceneCloud, match_finger_points, pose_lcp

RADIUS = 0.02


def sphere_surface(count: int) -> np.ndarray:
    """Even directions on the unit sphere, shape (count, 3)."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - z**2)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)


def test_pose_lcp_counts_as_a_kd_tree_of_the_surface() -> None:
    rng = np.random.default_rng(0)
    mesh = meshes.sphere(RADIUS)
    field = build_distance_field(mesh, 0.001, 0.01)
    fields = pack_fields([field], [mesh], "cpu")
    surface = sphere_surface(100_000)
    tree = cKDTree(RADIUS * surface)
    # Points around the surface whose normals are off by up to a right angle.
    outward = sphere_surface(400)
    points = outward * RADIUS + rng.normal(0, 0.003, (400, 3))
    normals = outward + rng.uniform(-1, 1, (400, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    motions = exp(rng.normal(0, 0.002, (20, 6)) * [100, 100, 100, 1, 1, 1])
    poses = motions.copy()

    expected = []
    for T in poses:
        local = inverse(T)
        distance, nearest = tree.query(transform(local, points))
        cosine = np.einsum("ij,ij->i", normals @ local[:3, :3].T, surface[nearest])
        expected.append(np.mean((distance < 0.003) & (cosine > np.cos(0.5))))
    found = pose_lcp(
        poses, points.astype(np.float32), normals.astype(np.float32), fields, 0.003, 0.5, "cpu"
    )
    assert 0.05 < np.mean(expected) < 0.6
    np.testing.assert_allclose(found, expected, atol=0.02)  # the mesh has facets


def test_finger_points_match_as_with_a_kd_tree() -> None:
    """Nearest neighbour first, then distance and normal: a farther one that agrees is no match."""
    rng = np.random.default_rng(1)
    scene = rng.uniform(0, 0.1, (3000, 3))
    finger = rng.uniform(0, 0.1, (500, 3))
    scene_normals, finger_normals = (sphere_surface(len(x)) for x in (scene, finger))
    rng.shuffle(scene_normals)
    rng.shuffle(finger_normals)
    T = exp(np.array([[0.1, -0.2, 0.3, 0.01, 0.0, -0.01], [0, 0, 0, 0, 0, 0.0]]))

    match, clearance = match_finger(scene, scene_normals, finger, finger_normals, T)

    for k in range(2):
        distance, nearest = cKDTree(scene).query(transform(T[k], finger))
        turned = finger_normals @ T[k, :3, :3].T
        cosine = np.einsum("ij,ij->i", turned, scene_normals[nearest])
        np.testing.assert_array_equal(match[k], (distance < 0.006) & (cosine > 0.3))
        # The obstacle is the sphere around the world's origin.
        depth = np.minimum(np.linalg.norm(transform(T[k], finger), axis=1) - RADIUS, 0)
        np.testing.assert_allclose(clearance[k], depth, atol=2e-4)


def match_finger(
    scene: np.ndarray,
    scene_normals: np.ndarray,
    finger: np.ndarray,
    finger_normals: np.ndarray,
    T: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Matches and clearances, shape (c, n), of finger points moved by `T` (c, 4, 4) in the presence
    of a sphere."""

    def vectors(x: np.ndarray) -> wp.array:
        return wp.array(x, dtype=wp.vec3, device="cpu")

    def ints(x: np.ndarray) -> wp.array:
        return wp.array(x, dtype=int, device="cpu")

    cloud = SceneCloud()
    cloud.points, cloud.normals = vectors(scene), vectors(scene_normals)
    cloud.distance, cloud.cosine = 0.006, 0.3
    grid = wp.HashGrid(16, 16, 16, device="cpu")
    grid.build(cloud.points, cloud.distance)
    cloud.grid = grid.id
    # Link 0 is the finger, link 1 the sphere.
    poses = np.stack([T, np.broadcast_to(np.eye(4), T.shape)], axis=1).reshape(-1, 4, 4)
    mesh = meshes.sphere(RADIUS)
    field = build_distance_field(mesh, 0.001, 0.01)
    n = len(finger)
    match = wp.empty(len(T) * n, dtype=int, device="cpu")
    clearance = wp.empty(len(T) * n, dtype=float, device="cpu")
    inputs = [
        cloud,
        wp.array(poses.astype(np.float32), dtype=wp.mat44, device="cpu"),
        vectors(finger),
        vectors(finger_normals),
        ints(np.zeros(n)),
        ints(np.arange(n)),
        pack_fields([field, field], [mesh, mesh], "cpu"),
        ints(np.array([0, 1, 0, 0])),
        match,
        clearance,
    ]
    launch(match_finger_points, len(T) * n, inputs, "cpu")
    return match.numpy().reshape(len(T), n), clearance.numpy().reshape(len(T), n)
