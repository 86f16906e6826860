"""The object to be found: its surface, distance field, point pairs and symmetry."""

from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from inhand.cache import Arrays, cached, put_together, taken_apart
from inhand.errors import InputError
from inhand.geometry.distance_field import DistanceField, build_distance_field
from inhand.geometry.mesh import TriangleMesh, from_trimesh, load_mesh
from inhand.geometry.sampling import SurfaceSamples, sample_surface
from inhand.object_symmetry import Symmetry, detect_symmetry
from inhand.pair_table import PairTable, build_pair_table

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}
"""Units of length a mesh may come in, in metres."""
SMALLEST, LARGEST = 0.005, 1.0
"""Diameters [m] between which an object may fit a hand."""
FARTHEST = 10.0
"""From an origin farther away [m], 32-bit positions are no longer good to a micrometre."""
SURFACE_POINTS = 2000
FIELD_MARGIN = 0.02
"""How far the distance field reaches beyond the surface [m]."""
FIELD_STEPS = 90
"""Voxels of the distance field along the diameter ..."""
SMALLEST_VOXEL = 0.001
"""... but none smaller than this [m]."""


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """A rigid object, in the frame of its mesh."""

    mesh: TriangleMesh
    surface: SurfaceSamples
    """Visible surface, `SURFACE_POINTS` samples in progressive order."""
    distance_field: DistanceField
    pairs: PairTable
    """Point pair features of the first surface samples."""
    symmetry: Symmetry
    name: str

    @classmethod
    def from_mesh(
        cls,
        mesh: str | PathLike[str] | TriangleMesh | Any,
        unit: str = "m",
        symmetry: Symmetry | Literal["none"] | None = None,
    ) -> "ObjectModel":
        """Build the model, or read it from the cache.

        Args:
            mesh: a mesh file of any format trimesh reads, a `TriangleMesh`, or a trimesh object.
            unit: length unit of the mesh: "m", "cm", "mm" or "inch".
            symmetry: the rotations that leave the object as it is; "none" if there are none; by
                default they are detected from the shape.

        Raises:
            InputError: unreadable or empty mesh, unknown unit, or a size that no hand holds.
        """
        if not isinstance(unit, str) or unit not in UNITS:
            raise InputError(f'unknown unit "{unit}"; known: {", ".join(UNITS)}')
        named = isinstance(symmetry, str) and symmetry == "none"
        if not (symmetry is None or named or isinstance(symmetry, Symmetry)):
            raise InputError(f'symmetry must be None, "none" or a Symmetry, got {symmetry!r:.80}')
        scale = UNITS[unit]
        name = "object"
        if isinstance(mesh, TriangleMesh):
            mesh = TriangleMesh(mesh.vertices * scale, mesh.faces)
        elif isinstance(mesh, str | PathLike):
            name = Path(mesh).stem
            mesh = load_mesh(mesh, scale)
        else:
            mesh = from_trimesh(mesh, scale)
        _check_size(mesh.diameter, unit)
        _check_place(mesh)
        settings = (SURFACE_POINTS, FIELD_MARGIN, FIELD_STEPS, SMALLEST_VOXEL)
        arrays = cached(["object", mesh.content_key, *settings], lambda: _derive(mesh))
        detected = put_together(Symmetry, "symmetry", arrays)
        if symmetry is None:
            symmetry = detected
        elif not isinstance(symmetry, Symmetry):  # "none"
            symmetry = Symmetry.none(detected.centre)
        return cls(
            mesh,
            put_together(SurfaceSamples, "surface", arrays),
            put_together(DistanceField, "field", arrays),
            put_together(PairTable, "pairs", arrays),
            symmetry,
            name,
        )

    @property
    def diameter(self) -> float:
        """Largest distance between two points of the object [m]."""
        return self.mesh.diameter

    @cached_property
    def centre(self) -> NDArray[np.float64]:
        """Centre of a small sphere around the object [m], shape (3,)."""
        return bounding_centre(self.mesh.hull_vertices)

    @cached_property
    def surface_form(self) -> NDArray[np.float64]:
        """Quadratic form, shape (6, 6), of what a twist does to the surface.

        `twist @ surface_form @ twist` is the mean square [m^2] of how far the surface moves along
        its normals; the twist is about `centre`, in the object's frame. What moves a surface in
        itself, such as the turn of a can about its axis, counts as nothing.
        """
        points, normals = self.surface.points - self.centre, self.surface.normals
        J = np.concatenate([np.cross(points, normals), normals], axis=1)
        return np.asarray(J.T @ J / len(J), dtype=np.float64)


def bounding_centre(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Centre of a nearly smallest sphere around `points`, (n, 3), by stepping to the farthest one.

    After k steps the radius is within a factor 1 + 1/sqrt(k) of the best (Badoiu and Clarkson,
    "Smaller core-sets for balls", 2003).
    """
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    for k in range(1, 500):
        farthest = points[np.argmax(((points - centre) ** 2).sum(axis=1))]
        centre = centre + (farthest - centre) / (k + 1)
    return centre


def _check_size(diameter: float, unit: str) -> None:
    """Raise InputError for an object that no hand holds, naming the likely unit."""
    if SMALLEST <= diameter <= LARGEST:
        return
    number = diameter / UNITS[unit]
    likely = [u for u, metres in UNITS.items() if 0.02 <= number * metres <= 0.4 and u != unit]
    tries = " or ".join(f'unit="{u}"' for u in likely)
    hint = f"; is the mesh in another unit? Try {tries}" if likely else ""
    raise InputError(
        f'the object\'s diameter is {diameter:.4g} m (unit "{unit}"), expected between '
        f"{SMALLEST} m and {LARGEST:g} m{hint}"
    )


def _check_place(mesh: TriangleMesh) -> None:
    """Raise InputError for an object so far from its mesh's origin that kernels would round it."""
    distance = np.abs(mesh.bounds).max()
    if distance > FARTHEST:
        raise InputError(
            f"the object lies {distance:.4g} m away from the origin of its mesh, expected at most "
            f"{FARTHEST:g} m; move the mesh to its origin"
        )


def _derive(mesh: TriangleMesh) -> Arrays:
    """Everything computed from the mesh, as arrays for the cache."""
    surface = sample_surface(mesh, SURFACE_POINTS)
    voxel = max(SMALLEST_VOXEL, mesh.diameter / FIELD_STEPS)
    field = build_distance_field(mesh, voxel, FIELD_MARGIN)
    pairs = build_pair_table(surface, mesh.diameter)
    symmetry = detect_symmetry(mesh, surface)
    return taken_apart(surface=surface, field=field, pairs=pairs, symmetry=symmetry)
