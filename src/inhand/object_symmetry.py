"""Rotations that map an object's surface onto itself: what they are, and finding them.

Two poses that differ by such a rotation show the same depth image, so hypotheses are compared
through the symmetry. Calling an object more symmetric than it is merges poses that the image tells
apart, the worse mistake of the two; so a rotation counts only if *every* surface sample lands
within 1 % of the diameter of the surface. That ignores a scan's dents, a cylinder's facets and
embossed text, and still sees a spout, a handle or a keyway on an otherwise round part. An object
whose symmetry is broken by less than that, or by colour alone, needs the user's override.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.geometry import se3
from inhand.geometry.mesh import TriangleMesh
from inhand.geometry.sampling import SurfaceSamples
from inhand.kernels import mesh_queries

Array = NDArray[np.float64]

TOLERANCE = 0.01
"""Largest distance of a rotated surface sample from the surface, relative to the diameter."""
SEARCH_TOLERANCE = 0.05
"""Mean distance, relative to the diameter, from which the fine alignment converges."""
SEARCH_DIRECTIONS = 1000
"""Axes tried over the half sphere: no axis is farther than about 4 degrees from one of them."""
PRIME_ORDERS = (2, 3, 5, 7)
"""Every rotation axis of finite order up to 10 carries a rotation of one of these orders."""
LARGEST_ORDER = 10
CONTINUOUS_TEST_ANGLES = np.pi * (3 - 5**0.5) * np.arange(1, 9)
"""Multiples of the golden angle: no finite order comes close to all of them."""
SPHERE_AXES = 60
"""Axis directions that stand for all orientations of a sphere, about 20 degrees apart."""


@dataclass(frozen=True, eq=False)
class Symmetry:
    """The rotations that map an object to itself."""

    centre: Array
    """Point that every rotation leaves in place [m], shape (3,)."""
    axis: Array | None
    """Unit axis of continuous symmetry, shape (3,), or None if there is none."""
    rotations: Array
    """Discrete transforms T_object_object, identity first, shape (k, 4, 4). With a continuous axis:
    the identity and, if it exists, one flip of the axis. A sphere has the axis z and transforms
    that turn it to `SPHERE_AXES` even directions."""

    @classmethod
    def none(cls, centre: Array) -> "Symmetry":
        """No symmetry: the identity alone."""
        return cls(np.asarray(centre, dtype=np.float64), None, np.eye(4)[None])

    def representatives(self, steps: int) -> Array:
        """Transforms that stand for the whole group, identity first, shape (m, 4, 4).

        The discrete transforms, each followed by `steps` even rotations about the continuous axis,
        if there is one.
        """
        if self.axis is None:
            return self.rotations
        angles = 2 * np.pi * np.arange(steps) / steps
        turns = rotations_about(self.centre, self.axis, angles)
        return np.asarray((turns[:, None] @ self.rotations[None]).reshape(-1, 4, 4))


def rotations_about(centre: Array, axis: Array, angles: Any) -> Array:
    """Transforms that rotate by `angles` [rad] about an axis through `centre`, shape (k, 4, 4)."""
    angles = np.atleast_1d(np.asarray(angles, dtype=np.float64))
    out = np.tile(np.eye(4), (len(angles), 1, 1))
    out[:, :3, :3] = se3.exp_so3(angles[:, None] * axis)
    out[:, :3, 3] = centre - out[:, :3, :3] @ centre
    return out


def detect_symmetry(mesh: TriangleMesh, surface: SurfaceSamples) -> Symmetry:
    """Find the rotations that map the mesh's visible surface onto itself.

    Rotations of prime order about axes all over the half sphere are tried on a few samples, the
    promising ones aligned to the surface, and the ones that fit to `TOLERANCE` span the group.

    Args:
        mesh: the object.
        surface: its visible surface samples.
    """
    matcher = _SelfMatcher(mesh, surface)
    centre = matcher.centre
    if matcher.fits(_random_rotations_about(centre, 12)).all():
        return _sphere(centre)
    found = matcher.align(matcher.promising_rotations())
    found = found[matcher.fits(found)]
    if len(found) == 0:
        return Symmetry.none(centre)
    axes = np.array([_axis_of(T) for T in found])
    centre = _common_centre(found, centre)
    continuous = np.array([matcher.is_continuous(centre, axis) for axis in axes])
    if continuous.any():
        return _axial(matcher, centre, axes[continuous][0])
    return _finite(matcher, centre, axes)


class _SelfMatcher:
    """Measures how well transforms map an object's surface onto itself."""

    def __init__(self, mesh: TriangleMesh, surface: SurfaceSamples) -> None:
        self.mesh = mesh_queries.device_mesh(mesh.vertices, mesh.faces)
        self.diameter = mesh.diameter
        self.points = surface.points.astype(np.float64)
        self.centre = self.points.mean(axis=0)

    def distances(self, T: Array, count: int, reach: float) -> Array:
        """Distances [m] of the first `count` samples, moved by each of `T` (k, 4, 4), from the
        surface, shape (k, count); at most `reach` [m]."""
        moved = _apply(T, self.points[:count])
        closest, _ = mesh_queries.closest_points(self.mesh, moved, reach)
        return np.nan_to_num(np.linalg.norm(moved - closest, axis=-1), nan=reach)

    def fits(self, T: Array) -> NDArray[np.bool_]:
        """Which of the transforms (k, 4, 4) are symmetries to within `TOLERANCE`."""
        limit = TOLERANCE * self.diameter
        fits = self.distances(T, 100, 2 * limit).max(axis=1, initial=0) <= limit
        worst = self.distances(T[fits], len(self.points), 2 * limit).max(axis=1, initial=0)
        fits[fits] = worst <= limit
        return np.asarray(fits)

    def is_continuous(self, centre: Array, axis: Array) -> bool:
        """Whether every rotation about the axis is a symmetry."""
        return bool(self.fits(rotations_about(centre, axis, CONTINUOUS_TEST_ANGLES)).all())
