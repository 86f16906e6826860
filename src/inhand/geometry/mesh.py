"""Triangle meshes: loading, primitives, and turning the faces outward."""

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, lru_cache
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import cdist

from inhand.errors import InputError
from inhand.kernels import mesh_queries

# Random surface points that vote on which way a mesh's faces look, besides one on every patch.
ORIENTATION_VOTES = 4_000


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """A triangle mesh; neither watertight nor consistently wound by assumption.

    Raises:
        InputError: wrong shapes, no faces, numbers that are not finite, or faces that name
            vertices that do not exist.
    """

    vertices: NDArray[np.float64]
    """Vertex positions [m], shape (n, 3)."""
    faces: NDArray[np.int32]
    """Vertex indices of the triangles, shape (m, 3)."""

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices, dtype=np.float64)
        faces = np.ascontiguousarray(self.faces, dtype=np.int32)
        for name, shape in (("vertices", vertices.shape), ("faces", faces.shape)):
            if len(shape) != 2 or shape[1] != 3:
                raise InputError(f"mesh {name} must have shape (n, 3), got {shape}")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)
        if len(self.faces) == 0:
            raise InputError("the mesh has no faces; a point cloud must be meshed first")
        if not np.isfinite(self.vertices).all():
            raise InputError("the mesh has vertices that are NaN or infinite")
        if self.faces.min() < 0 or self.faces.max() >= len(self.vertices):
            raise InputError(
                f"the mesh has {len(self.vertices)} vertices but a face names vertex "
                f"{self.faces.max() if self.faces.min() >= 0 else self.faces.min()}"
            )

    @cached_property
    def bounds(self) -> NDArray[np.float64]:
        """Lower and upper corner of the axis-aligned box around the mesh [m], shape (2, 3)."""
        used = self.vertices[np.unique(self.faces)]
        return np.stack([used.min(axis=0), used.max(axis=0)])

    @cached_property
    def bounding_sphere(self) -> tuple[NDArray[np.float64], float]:
        """Centre [m], shape (3,), and radius [m] of a sphere that holds every vertex."""
        centre = (self.vertices.min(axis=0) + self.vertices.max(axis=0)) / 2
        return centre, float(np.linalg.norm(self.vertices - centre, axis=1).max())

    @cached_property
    def hull_vertices(self) -> NDArray[np.float64]:
        """Vertices of the convex hull [m], shape (k, 3); of a flat mesh, every vertex."""
        points = self.vertices[np.unique(self.faces)]
        with suppress(QhullError):  # flat
            points = points[ConvexHull(points).vertices]
        return points

    @cached_property
    def diameter(self) -> float:
        """Largest distance between two vertices [m]."""
        points = self.hull_vertices
        chunks = (points[i : i + 500] for i in range(0, len(points), 500))
        return float(max(cdist(chunk, points).max() for chunk in chunks))

    @cached_property
    def content_key(self) -> str:
        """SHA-256 of vertices and faces, in hex: equal for equal meshes."""
        return hashlib.sha256(self.vertices.tobytes() + self.faces.tobytes()).hexdigest()

    @cached_property
    def triangles(self) -> NDArray[np.float64]:
        """Corner positions of the faces [m], shape (m, 3, 3)."""
        return self.vertices[self.faces]

    @cached_property
    def face_normals(self) -> NDArray[np.float64]:
        """Unit normals of the faces by their winding, shape (m, 3)."""
        length = np.linalg.norm(self._edge_products, axis=1, keepdims=True)
        return np.asarray(self._edge_products / np.maximum(length, np.finfo(float).tiny))

    @cached_property
    def face_areas(self) -> NDArray[np.float64]:
        """Areas of the faces [m^2], shape (m,)."""
        return np.asarray(np.linalg.norm(self._edge_products, axis=1) / 2)

    @cached_property
    def _edge_products(self) -> NDArray[np.float64]:
        """Cross products of two edges of every face, shape (m, 3)."""
        a, b, c = self.triangles.swapaxes(0, 1)
        return np.asarray(np.cross(b - a, c - a))


def load_mesh(path: str | PathLike[str], scale: ArrayLike = 1.0) -> TriangleMesh:
    """Read a mesh file of any format trimesh reads.

    Scenes are concatenated with their transforms, duplicate vertices merged, degenerate faces
    dropped.

    Args:
        path: the file.
        scale: factor to metres, one number or one per axis (negative mirrors).

    Raises:
        InputError: the file is missing, unreadable, or holds no usable triangle.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"mesh file {path} does not exist")
    try:
        loaded = trimesh.load_mesh(path, process=False)
    except Exception as error:
        raise InputError(f"cannot read mesh file {path}: {error}") from error
    try:
        return from_trimesh(loaded, scale)
    except InputError as error:
        raise InputError(f"mesh file {path}: {error}") from error


def from_trimesh(loaded: Any, scale: ArrayLike = 1.0) -> TriangleMesh:
    """Our mesh of a trimesh `Trimesh` or `Scene`, cleaned as by `load_mesh`.

    Raises:
        InputError: it holds no usable triangle, or is something else.
    """
    factor = np.asarray(scale, dtype=np.float64)
    if factor.shape not in ((), (3,)) or not np.isfinite(factor).all() or (factor == 0).any():
        raise InputError(f"mesh scale must be one or three non-zero numbers, got {scale!r}")
    if isinstance(loaded, trimesh.Scene):
        loaded = loaded.to_mesh() if loaded.geometry else trimesh.Trimesh()
    if not isinstance(loaded, trimesh.Trimesh):
        raise InputError(f"expected a triangle mesh, got a {type(loaded).__name__} without faces")
    faces = np.asarray(loaded.faces, dtype=np.int32).reshape(-1, 3)
    if np.prod(np.broadcast_to(factor, 3)) < 0:
        faces = faces[:, ::-1]
    vertices = np.asarray(loaded.vertices, dtype=np.float64)
    if vertices.size and vertices.shape[1:] != (3,):
        raise InputError(f"vertices must have 3 coordinates, got an array of {vertices.shape}")
    return _clean(vertices.reshape(-1, 3) * factor, faces)


def _clean(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> TriangleMesh:
    """Merge equal vertices; drop degenerate faces and unused vertices."""
    mesh = TriangleMesh(vertices, faces)
    unique, index = np.unique(mesh.vertices, axis=0, return_inverse=True)
    merged = TriangleMesh(unique, index.reshape(-1)[mesh.faces].astype(np.int32))
    sound = merged.faces[merged.face_areas > 1e-12 * np.ptp(merged.bounds, axis=0).max() ** 2]
    used, kept = np.unique(sound, return_inverse=True)
    if len(used) == 0:
        raise InputError("every face of the mesh has zero area")
    return TriangleMesh(unique[used], kept.reshape(-1, 3).astype(np.int32))


def box(extents: ArrayLike) -> TriangleMesh:
    """A box centred at the origin with edge lengths `extents` [m], shape (3,)."""
    solid = trimesh.creation.box(extents=np.asarray(extents, dtype=np.float64))
    return TriangleMesh(solid.vertices, solid.faces)


def cylinder(radius: float, length: float) -> TriangleMesh:
    """A cylinder along z centred at the origin; radius and length in metres."""
    solid = trimesh.creation.cylinder(radius=radius, height=length, sections=64)
    return TriangleMesh(solid.vertices, solid.faces)


def sphere(radius: float) -> TriangleMesh:
    """A sphere centred at the origin; radius in metres."""
    solid = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    return TriangleMesh(solid.vertices, solid.faces)


def concatenate(meshes: Sequence[TriangleMesh]) -> TriangleMesh:
    """All meshes as one."""
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes[:-1])])
    return TriangleMesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.faces + start for m, start in zip(meshes, starts, strict=True)]),
    )


def transformed(mesh: TriangleMesh, T: NDArray[np.float64]) -> TriangleMesh:
    """The mesh in another frame; `T`: 4x4 rigid transform from the mesh's frame to the new one."""
    return TriangleMesh(mesh.vertices @ T[:3, :3].T + T[:3, 3], mesh.faces)


@lru_cache(maxsize=4)
def oriented_outward(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh with every face wound so that its normal looks out of the solid.

    Faces that are joined by consistently wound edges are turned together, by a vote of rays: the
    outside is the side from which more rays leave the mesh (after Takayama et al., "A simple
    method for correcting facet orientations in polygon meshes based on ray casting", 2014). Faces
    seen from both sides alike (an open sheet) or from none keep their winding.
    """
    patch = _consistent_patches(mesh.faces)
    rng = np.random.default_rng(0)
    share = mesh.face_areas / mesh.face_areas.sum()
    one_of_each = np.unique(patch, return_index=True)[1]
    face = np.append(rng.choice(len(share), size=ORIENTATION_VOTES, p=share), one_of_each)
    points, normals = points_on_faces(mesh, face, rng), mesh.face_normals[face]
    handle = mesh_queries.device_mesh(mesh.vertices, mesh.faces)
    front = mesh_queries.open_directions(handle, points, normals, mesh.diameter)
    back = mesh_queries.open_directions(handle, points, -normals, mesh.diameter)
    flip = np.bincount(patch[face], weights=front - back)[patch] < 0
    if not flip.any():
        return mesh
    return TriangleMesh(mesh.vertices, np.where(flip[:, None], mesh.faces[:, ::-1], mesh.faces))


def points_on_faces(
    mesh: TriangleMesh, face: NDArray[np.int64], rng: np.random.Generator
) -> NDArray[np.float64]:
    """One uniformly random point [m] on each of the given faces, shape (n, 3)."""
    a, b = rng.random((2, len(face), 1))
    root = np.sqrt(a)
    corner = mesh.triangles[face]
    return np.asarray(
        (1 - root) * corner[:, 0] + root * (1 - b) * corner[:, 1] + root * b * corner[:, 2]
    )


def _consistent_patches(faces: NDArray[np.int32]) -> NDArray[np.int32]:
    """Label of each face's patch, shape (m,): faces joined over edges that exactly two faces share
    and run along in opposite directions."""
    edges, owner = trimesh.geometry.faces_to_edges(faces, return_index=True)
    pairs = trimesh.grouping.group_rows(np.sort(edges, axis=1), require_count=2)
    one, other = pairs[edges[pairs[:, 0], 0] != edges[pairs[:, 1], 0]].T
    joined = owner[one], owner[other]
    graph = coo_array((np.ones(len(one)), joined), shape=(len(faces), len(faces)))
    return np.asarray(connected_components(graph, directed=False)[1])
