"""Depth images that owe nothing to the project's renderer: closed forms, and Open3D."""

from collections.abc import Sequence

import numpy as np
import pytest

from inhand.camera import Camera
from inhand.geometry.mesh import TriangleMesh
from inhand.geometry.se3 import transform


def rays(camera: Camera) -> np.ndarray:
    """Points of the pixels' rays at depth 1, shape (H, W, 3)."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return np.stack(
        [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1
    )


def plane_depth(camera: Camera, normal: np.ndarray, distance: float) -> np.ndarray:
    """Depth [m] of the plane normal . x = distance, shape (H, W), 0 where it is not seen."""
    along = rays(camera) @ normal
    with np.errstate(divide="ignore"):
        z = distance / along
    return np.where(np.isfinite(z) & (z > 0), z, 0.0)


def sphere_depth(camera: Camera, centre: np.ndarray, radius: float) -> np.ndarray:
    """Depth [m] of a sphere, shape (H, W), 0 where it is not seen."""
    ray = rays(camera)
    squared, half = (ray**2).sum(axis=-1), ray @ centre
    discriminant = half**2 - squared * (centre @ centre - radius**2)
    z = (half - np.sqrt(np.maximum(discriminant, 0))) / squared
    return np.where((discriminant > 0) & (z > 0), z, 0.0)


def open3d_depth(
    meshes: Sequence[TriangleMesh], poses: np.ndarray, camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """Depth [m] of posed meshes, infinite where nothing is, and their indices there; (H, W)."""
    o3d = pytest.importorskip("open3d", exc_type=ImportError)
    scene = o3d.t.geometry.RaycastingScene()
    for mesh, T in zip(meshes, poses, strict=True):
        vertices = transform(T, mesh.vertices).astype(np.float32)
        scene.add_triangles(vertices, mesh.faces.astype(np.uint32))
    ray = rays(camera).astype(np.float32)
    hit = scene.cast_rays(np.concatenate([np.zeros_like(ray), ray], axis=-1))
    depth, index = hit["t_hit"].numpy(), hit["geometry_ids"].numpy().astype(np.int64)
    return depth, np.where(np.isfinite(depth), index, -1)
