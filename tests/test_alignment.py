import numpy as np
import warp as wp

from inhand.geometry.se3 import random_rotation
from inhand.kernels.alignment import align_quadruples
from inhand.kernels.launch import launch


def align(targets: np.ndarray, sources: np.ndarray) -> np.ndarray:
    """`align_quadruples` of point sets of shape (s, 4, 3)."""
    count = len(targets)
    sets = wp.array(np.arange(4 * count).reshape(-1, 4), dtype=wp.vec4i, device="cpu")
    clouds = [wp.array(x.reshape(-1, 3), dtype=wp.vec3, device="cpu") for x in (targets, sources)]
    poses = wp.empty(count, dtype=wp.mat44, device="cpu")
    launch(align_quadruples, count, [clouds[0], sets, clouds[1], sets, poses], "cpu")
    return np.asarray(poses.numpy(), dtype=np.float64)


def kabsch(target: np.ndarray, source: np.ndarray) -> np.ndarray:
    """The least-squares motion by numpy's SVD, in double precision."""
    target_mean, source_mean = target.mean(axis=0), source.mean(axis=0)
    u, _, vt = np.linalg.svd((target - target_mean).T @ (source - source_mean))
    R = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, target_mean - R @ source_mean
    return T


def quadruples(rng: np.random.Generator, count: int, height: float) -> np.ndarray:
    """Well spread quadruples of some centimetres, at most `height` [m] off a plane."""
    square = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]]) * 0.03
    flat = square + rng.uniform(-0.01, 0.01, (count, 4, 3)) * [1, 1, 0]
    flat[:, :, 2] = rng.uniform(-height, height, (count, 4))
    return flat @ random_rotation(rng).T + [0.1, -0.2, 0.5]


def test_noisy_sets_align_as_by_numpy() -> None:
    rng = np.random.default_rng(0)
    for height in (0.0, 0.02):
        sources = quadruples(rng, 200, height)
        R = np.stack([random_rotation(rng) for _ in sources])
        targets = np.einsum("nij,nkj->nki", R, sources) + [0.0, 0.1, 0.4]
        targets += rng.normal(0, 0.002, targets.shape)
        expected = np.stack([kabsch(t, s) for t, s in zip(targets, sources, strict=True)])
        np.testing.assert_allclose(align(targets, sources), expected, atol=2e-4)


def test_a_mirror_image_is_aligned_by_a_rotation_not_a_reflection() -> None:
    sources = quadruples(np.random.default_rng(1), 100, 0.02)
    poses = align(sources * [1, 1, -1], sources)
    np.testing.assert_allclose(np.linalg.det(poses[:, :3, :3]), 1, atol=1e-4)
