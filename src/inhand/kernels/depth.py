"""Depth images of posed meshes by ray casting."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.geometry.mesh import TriangleMesh
from inhand.kernels.launch import launch, pack
from inhand.kernels.mesh_queries import device_mesh
from inhand.kernels.transforms import to_local


@wp.struct
class Pinhole:
    """Intrinsics [pixel] and image size of a camera, for kernels."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int


@lru_cache(32)
def pinhole(camera: Camera) -> Any:
    """`camera` as a kernel argument."""
    return pack(Pinhole, "cpu", **vars(camera))


@wp.kernel
def cast_rays(
    camera: Pinhole,
    mesh_ids: wp.array(dtype=wp.uint64),
    spheres: wp.array(dtype=wp.vec4),
    T_camera_mesh: wp.array(dtype=wp.mat44),
    depth: wp.array(dtype=float),
    mesh_index: wp.array(dtype=int),
    first: int,
):
    """One work item a pixel: nearest mesh along its ray; depth is z [m], 0 where nothing is hit.

    `spheres`: bounding sphere of every mesh, mesh frame (centre, radius) [m].
    """
    i = first + wp.tid()
    u = float(i % camera.width)
    v = float(i // camera.width)
    ray = wp.vec3((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0)
    ray_squared = wp.dot(ray, ray)
    nearest = float(1.0e6)
    winner = int(-1)
    for m in range(mesh_ids.shape[0]):
        T = T_camera_mesh[m]
        s = spheres[m]
        centre = wp.transform_point(T, s[:3])
        along = wp.dot(centre, ray) / ray_squared
        miss = centre - along * ray
        if wp.dot(miss, miss) > s[3] * s[3] or along - s[3] > nearest:
            continue
        direction = wp.transform_vector(wp.transpose(T), ray)
        origin = to_local(T, wp.vec3())
        # The ray has unit z, so the parameter of the hit is its depth. The direction must be
        # normalised for the query.
        length = wp.sqrt(ray_squared)
        hit = wp.mesh_query_ray(mesh_ids[m], origin, direction / length, nearest * length)
        if hit.result:
            nearest = hit.t / length
            winner = m
    depth[i] = wp.where(winner >= 0, nearest, 0.0)
    mesh_index[i] = winner


class DepthRenderer:
    """Renders depth images of a fixed list of meshes at changing poses.

    Args:
        meshes: the meshes, each in its own frame [m].
        device: Warp device name.
    """

    def __init__(self, meshes: Sequence[TriangleMesh], device: str = "cpu") -> None:
        self.device = device
        self._meshes = [device_mesh(mesh.vertices, mesh.faces, device) for mesh in meshes]
        self.mesh_ids = wp.array([m.id for m in self._meshes], dtype=wp.uint64, device=device)
        spheres = [bounding_sphere(mesh) for mesh in meshes]
        self.spheres = wp.array(spheres, dtype=wp.vec4, device=device)

    def render(
        self, camera: Camera, T_camera_mesh: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """Depth image of the meshes.

        Args:
            camera: the camera.
            T_camera_mesh: poses of the meshes, shape (m, 4, 4).

        Returns:
            depth [m], shape (H, W), 0 where nothing is hit, and the index of the mesh that each
            pixel shows, shape (H, W), -1 where nothing is hit.
        """
        depth, index = self.render_on_device(camera, T_camera_mesh)
        size = (camera.height, camera.width)
        return depth.numpy().reshape(size), index.numpy().reshape(size)

    def render_on_device(
        self, camera: Camera, T_camera_mesh: NDArray[np.float64]
    ) -> tuple[Any, Any]:
        """As `render`, as Warp arrays of shape (H * W,) that stay on the device."""
        poses = wp.array(T_camera_mesh, dtype=wp.mat44, device=self.device)
        n = camera.width * camera.height
        depth = wp.empty(n, dtype=float, device=self.device)
        index = wp.empty(n, dtype=int, device=self.device)
        inputs = [pinhole(camera), self.mesh_ids, self.spheres, poses, depth, index]
        launch(cast_rays, n, inputs, self.device, work_per_item=20)
        return depth, index


def bounding_sphere(mesh: TriangleMesh) -> list[float]:
    """A sphere (centre, radius) [m] in the mesh's frame that holds the mesh in 32-bit numbers."""
    centre, radius = mesh.bounding_sphere
    return [*centre.tolist(), radius * 1.0001 + 1e-6]
