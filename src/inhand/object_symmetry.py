"""Rotations that map an object's surface onto itself: what they are, and finding them.

Two poses that differ by such a rotation show the same depth image, so hypotheses are compared
through the symmetry. Real objects are never exactly symmetric, and both errors cost: calling an
object less symmetric than it is fills the hypotheses with copies of one pose, calling it more
symmetric merges poses that a good image tells apart. A rotation has to pass two tests, relative to
the diameter. On average the moved surface lies within 0.6 % of the surface: the ADI error that
merging can cause, below the noise of depth cameras for objects of a hand's size. And no sample
lies farther than 4.5 % away: a spout, a handle or a deep keyway on an otherwise round part breaks
the symmetry, while a scanned can's dents and pull tab (measured: 4.1 %), a cylinder's facets and
embossed text do not. (The BOP benchmark's rule is 10 % or 15 mm.) Where an object's symmetry is
broken by less than that, or by colour alone, and this matters, the user overrides it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from inhand.errors import InputError
from inhand.geometry import se3
from inhand.geometry.mesh import TriangleMesh
from inhand.geometry.sampling import SurfaceSamples
from inhand.geometry.se3 import Array
from inhand.kernels import mesh_queries

MEAN_TOLERANCE = 0.006
"""Largest mean distance of the rotated samples from the surface, relative to the diameter."""
MAX_TOLERANCE = 0.045
"""Largest distance of any rotated sample from the surface, relative to the diameter."""
SEARCH_TOLERANCE = 0.05
"""Mean distance, relative to the diameter, from which the fine alignment converges."""
SEARCH_DIRECTIONS = 1000
"""Axes tried over the half sphere: no axis is farther than about 4 degrees from one of them."""
PRIME_ORDERS = (2, 3, 5, 7)
"""Every rotation axis of finite order up to 10 carries a rotation of one of these orders."""
LARGEST_ORDER = 10
SAME_ELEMENT = np.radians(15)
"""Rotations closer than this are the same group element: half of what the largest order needs."""
CONTINUOUS_TEST_ANGLES = np.pi * (3 - 5**0.5) * np.arange(1, 9)
"""Multiples of the golden angle: no finite order comes close to all of them."""
SPHERE_AXES = 60
"""Axis directions that stand for all orientations of a sphere, about 24 degrees apart."""


@dataclass(frozen=True, eq=False)
class Symmetry:
    """The rotations that map an object to itself.

    Raises:
        InputError: wrong shapes, transforms that are not rigid, or no identity in front.
    """

    centre: Array
    """Point that every rotation leaves in place [m], shape (3,)."""
    axis: Array | None
    """Unit axis of continuous symmetry, shape (3,), or None if there is none."""
    rotations: Array
    """Discrete transforms T_object_object, identity first, shape (k, 4, 4). With a continuous axis:
    the identity and, if it exists, one flip of the axis. A sphere has the axis z and transforms
    that turn it to `SPHERE_AXES` even directions."""

    def __post_init__(self) -> None:
        centre = np.asarray(self.centre, dtype=np.float64)
        if centre.shape != (3,) or not np.isfinite(centre).all():
            raise InputError(f"a symmetry's centre must be three numbers [m], got {self.centre!r}")
        rotations = np.asarray(self.rotations, dtype=np.float64)
        if rotations.ndim != 3 or len(rotations) == 0:
            raise InputError(
                "a symmetry's rotations must be 4x4 transforms, shape (k, 4, 4), beginning with "
                f"the identity; got shape {rotations.shape}"
            )
        rotations = np.stack([se3.check_rigid(T, "a symmetry's rotation") for T in rotations])
        if not np.allclose(rotations[0], np.eye(4)):
            raise InputError("the first of a symmetry's rotations must be the identity")
        object.__setattr__(self, "centre", centre)
        object.__setattr__(self, "rotations", rotations)
        if self.axis is not None:
            axis = np.asarray(self.axis, dtype=np.float64)
            length = np.linalg.norm(axis)
            if axis.shape != (3,) or not (np.isfinite(length) and length > 0):
                raise InputError(f"a symmetry's axis must be a direction (3,), got {self.axis!r}")
            object.__setattr__(self, "axis", axis / length)

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
    return _about(centre, se3.exp_so3(angles[:, None] * axis))


def detect_symmetry(mesh: TriangleMesh, surface: SurfaceSamples) -> Symmetry:
    """Find the rotations that map the mesh's visible surface onto itself.

    Rotations of prime order about axes all over the half sphere are tried on a few samples, the
    promising ones aligned to the surface, and the ones that fit within the tolerances span the
    group.

    Args:
        mesh: the object.
        surface: its visible surface samples.
    """
    matcher = _SelfMatcher(mesh, surface)
    centre = matcher.centre
    rng = np.random.default_rng(0)
    if matcher.fits(_about(centre, np.stack([se3.random_rotation(rng) for _ in range(12)]))).all():
        return _sphere(centre)
    found = matcher.align(matcher.promising_rotations())
    turned = se3.rotation_angle(found[:, :3, :3], np.eye(3)) > np.pi / LARGEST_ORDER
    found = found[turned & matcher.fits(found)]
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
        """Which of the transforms (k, 4, 4) are symmetries within the tolerances."""
        limit = MAX_TOLERANCE * self.diameter
        fits = self.distances(T, 100, 2 * limit).max(axis=1) <= limit
        distance = self.distances(T[fits], len(self.points), 2 * limit)
        mean, worst = distance.mean(axis=1), distance.max(axis=1)
        fits[fits] = (mean <= MEAN_TOLERANCE * self.diameter) & (worst <= limit)
        return np.asarray(fits)

    def is_continuous(self, centre: Array, axis: Array) -> bool:
        """Whether every rotation about the axis is a symmetry."""
        return bool(self.fits(rotations_about(centre, axis, CONTINUOUS_TEST_ANGLES)).all())

    def promising_rotations(self) -> Array:
        """Rotations of prime order about the centre that roughly map the surface to itself, at
        most 60, best first and clearly different from each other, shape (k, 4, 4)."""
        axes = even_directions(2 * SEARCH_DIRECTIONS)[:SEARCH_DIRECTIONS]
        T = np.concatenate(
            [
                rotations_about(self.centre, axis, 2 * np.pi / np.array(PRIME_ORDERS))
                for axis in axes
            ]
        )
        reach = 3 * SEARCH_TOLERANCE * self.diameter
        mean = self.distances(T, 60, reach).mean(axis=1)
        T = T[np.argsort(mean, kind="stable")[: np.sum(mean <= SEARCH_TOLERANCE * self.diameter)]]
        return _distinct(T, np.radians(12), 60)

    def align(self, T: Array) -> Array:
        """The transforms (k, 4, 4) after robust point-to-plane alignment of the moved samples.

        The scale of the robust weights shrinks, so that a dent or a tab does not pull the rest off.
        """
        reach = 2 * SEARCH_TOLERANCE * self.diameter
        for scale in np.geomspace(reach, MEAN_TOLERANCE * self.diameter, 15):
            moved = _apply(T, self.points[:300])
            closest, normals = mesh_queries.closest_points(self.mesh, moved, reach)
            error = np.nan_to_num(np.einsum("kni,kni->kn", normals, moved - closest))
            J = np.nan_to_num(np.concatenate([np.cross(moved - self.centre, normals), normals], -1))
            weighted = J / (1 + (error[..., None] / scale) ** 2) ** 2
            H = np.einsum("kni,knj->kij", weighted, J)
            # Weak damping: a continuous symmetry leaves a direction free.
            H += np.diag([1e-3 * self.diameter**2] * 3 + [1e-3] * 3)
            step = -np.linalg.solve(H, np.einsum("kni,kn->ki", weighted, error)[..., None])
            motion = _about(self.centre, se3.exp_so3(step[:, :3, 0]))
            motion[:, :3, 3] += step[:, 3:, 0]
            T = motion @ T
        return T


def _apply(T: Array, points: Array) -> Array:
    """Points (n, 3) moved by each of the transforms (k, 4, 4), shape (k, n, 3)."""
    return np.asarray(points @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3])


def _about(centre: Array, rotations: Array) -> Array:
    """Transforms (k, 4, 4) of rotations (k, 3, 3) about `centre`."""
    T = np.tile(np.eye(4), (len(rotations), 1, 1))
    T[:, :3, :3] = rotations
    T[:, :3, 3] = centre - T[:, :3, :3] @ centre
    return T


def _axis_of(T: Array) -> Array:
    """Unit rotation axis of a transform, with its largest component positive, shape (3,)."""
    vector = Rotation.from_matrix(T[:3, :3]).as_rotvec()
    axis = vector / np.linalg.norm(vector)
    return np.asarray(axis * np.sign(axis[np.argmax(np.abs(axis))]))


def _distinct(T: Array, angle: float, limit: int) -> Array:
    """The first of the transforms whose rotations differ by more than `angle` [rad], greedily."""
    kept = T[:0]
    while len(T) and len(kept) < limit:
        kept = np.concatenate([kept, T[:1]])
        T = T[se3.rotation_angle(T[:, :3, :3], T[0, :3, :3]) > angle]
    return kept


def _common_centre(T: Array, guess: Array) -> Array:
    """The point that all transforms leave in place, as near to `guess` as they allow."""
    A = (np.eye(3) - T[:, :3, :3]).reshape(-1, 3)
    b = T[:, :3, 3].reshape(-1) - A @ guess
    return np.asarray(guess + np.linalg.lstsq(A, b, rcond=0.05)[0])


def _sphere(centre: Array) -> Symmetry:
    z = np.array([0.0, 0.0, 1.0])
    turns = np.stack([se3.rotation_between(z, d) for d in even_directions(SPHERE_AXES)])
    return Symmetry(centre, z, _about(centre, turns))


def _axial(matcher: _SelfMatcher, centre: Array, axis: Array) -> Symmetry:
    """Continuous symmetry, with the flip of the axis if it is one too, in every direction."""
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    T = rotations_about(centre, across / np.linalg.norm(across), [0, np.pi])
    flips = rotations_about(centre, axis, CONTINUOUS_TEST_ANGLES) @ T[1]
    return Symmetry(centre, axis, T if matcher.fits(flips).all() else T[:1])


def _finite(matcher: _SelfMatcher, centre: Array, axes: Array) -> Symmetry:
    """The largest finite group found whose every element is a symmetry."""
    group = np.eye(4)[None]
    for axis in axes:
        turns = rotations_about(centre, axis, 2 * np.pi / np.arange(LARGEST_ORDER, 1, -1))
        for turn in turns[matcher.fits(turns)]:
            if _contains(group, turn):
                break
            larger = _closure(group, turn)
            if matcher.fits(larger).all():
                group = larger
                break
    return Symmetry(centre, None, group)


def _contains(group: Array, T: Array) -> bool:
    return bool((se3.rotation_angle(group[:, :3, :3], T[:3, :3]) < SAME_ELEMENT).any())


def _closure(group: Array, generator: Array) -> Array:
    """The group spanned by a group and one more transform, identity first."""
    size = 0
    while len(group) > size:
        size = len(group)
        products = (np.append(group, generator[None], axis=0)[:, None] @ group).reshape(-1, 4, 4)
        group = _distinct(np.concatenate([group, products]), SAME_ELEMENT, 2 * SPHERE_AXES)
    return group


def even_directions(count: int) -> Array:
    """Unit vectors spread evenly over the sphere from +z to -z, shape (count, 3)."""
    z = np.linspace(1, -1, count)
    turn = np.pi * (1 + 5**0.5) * np.arange(count)
    ring = np.sqrt(1 - z**2)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)
