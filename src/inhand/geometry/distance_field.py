"""Signed distance to a mesh, sampled on a voxel grid with its gradient."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.geometry.mesh import TriangleMesh, oriented_outward
from inhand.kernels import mesh_queries


@dataclass(frozen=True, eq=False)
class DistanceField:
    """Signed distance and gradient at voxel centres."""

    origin: NDArray[np.float32]
    """Centre of voxel (0, 0, 0) [m], shape (3,)."""
    voxel: float
    """Edge length of a voxel [m]."""
    values: NDArray[np.float32]
    """Signed distance [m], negative inside, and its unit gradient, shape (nx, ny, nz, 4)."""

    def distance(self, points: NDArray[Any]) -> NDArray[np.float64]:
        """Signed distance [m], shape (n,), of points [m], shape (n, 3), in the mesh's frame.

        First-order from the nearest voxel's centre; outside the grid, the value at the nearest
        point of the grid plus the distance to it.
        """
        points = np.asarray(points, dtype=np.float64)
        top = np.array(self.values.shape[:3]) - 1
        inside = np.clip(points, self.origin, self.origin + self.voxel * top)
        cell = np.clip(np.rint((inside - self.origin) / self.voxel).astype(int), 0, top)
        value = self.values[cell[:, 0], cell[:, 1], cell[:, 2]]
        offset = inside - (self.origin + self.voxel * cell)
        near = value[:, 0] + np.einsum("ij,ij->i", value[:, 1:], offset)
        return np.asarray(near + np.linalg.norm(points - inside, axis=1))


def build_distance_field(mesh: TriangleMesh, voxel: float, margin: float) -> DistanceField:
    """Distance field of a mesh, over its bounding box and a margin.

    The sign comes from the generalised winding number (Jacobson et al., "Robust Inside-Outside
    Segmentation using Generalized Winding Numbers", 2013) of the outward-oriented mesh, so it is
    right on meshes with gaps, overlapping bodies and inconsistent winding; an open sheet has no
    inside. Exactly on the surface the gradient is the face normal.

    Args:
        mesh: the surface.
        voxel: edge length of a voxel [m].
        margin: how far the grid reaches beyond the mesh [m].
    """
    mesh = oriented_outward(mesh)
    lower, upper = mesh.bounds[0] - margin, mesh.bounds[1] + margin
    shape = np.ceil((upper - lower) / voxel).astype(int) + 1
    origin = ((lower + upper) / 2 - voxel * (shape - 1) / 2).astype(np.float32)
    handle = mesh_queries.device_mesh(mesh.vertices, mesh.faces, winding=True)
    nx, ny, nz = (int(n) for n in shape)
    reach = 2 * (mesh.diameter + 2 * margin)
    values = mesh_queries.signed_distance_grid(
        handle, mesh.bounds, origin, voxel, (nx, ny, nz), reach
    )
    return DistanceField(origin, voxel, values)
