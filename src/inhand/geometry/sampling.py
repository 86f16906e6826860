"""Even samples of a mesh's visible surface."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inhand.errors import InputError
from inhand.geometry.mesh import TriangleMesh, oriented_outward, points_on_faces
from inhand.kernels import mesh_queries

# Random candidates for every sample kept: enough for even spacing, cheap enough to sort.
CANDIDATES_PER_SAMPLE = 10
# A point counts as visible when at least this many of its 32 rays leave the mesh. A single ray is
# what walls inside a hollow housing see through an assembly hole; no camera sees those walls.
OPEN_RAYS = 2


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Points on a surface, in progressive order: every prefix is spread evenly by itself."""

    points: NDArray[np.float32]
    """Positions [m], shape (n, 3)."""
    normals: NDArray[np.float32]
    """Unit normals that look out of the solid, shape (n, 3)."""


def sample_surface(mesh: TriangleMesh, count: int, seed: int = 0) -> SurfaceSamples:
    """Farthest-point samples of the surface that can be seen from outside.

    A point from whose outer side every ray ends on the mesh lies inside (screws in a housing, the
    overlap of two bodies) and is left out. Normals look outward on inconsistently wound and on
    open meshes too.

    Args:
        mesh: the surface.
        count: number of samples.
        seed: makes the samples repeatable.

    Raises:
        InputError: no part of the mesh is visible from outside, or `count` is not positive.
    """
    if count < 1:
        raise InputError(f"the number of surface samples must be positive, got {count}")
    mesh = oriented_outward(mesh)
    rng = np.random.default_rng(seed)
    share = mesh.face_areas / mesh.face_areas.sum()
    face = rng.choice(len(share), size=max(2000, CANDIDATES_PER_SAMPLE * count), p=share)
    points, normals = points_on_faces(mesh, face, rng), mesh.face_normals[face]
    handle = mesh_queries.device_mesh(mesh.vertices, mesh.faces)
    rays = mesh_queries.open_directions(handle, points, normals, mesh.diameter)
    visible = rays >= OPEN_RAYS
    points, normals = points[visible], normals[visible]
    if len(points) < count:
        raise InputError(
            f"only {len(points)} of {len(visible)} surface points are visible from outside; "
            "is the mesh enclosed by another surface?"
        )
    start = int(np.argmin(np.linalg.norm(points - points.mean(axis=0), axis=1)))
    chosen = mesh_queries.farthest_point_order(points, count, start)
    return SurfaceSamples(points[chosen].astype(np.float32), normals[chosen].astype(np.float32))
