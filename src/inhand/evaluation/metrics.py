"""How far an estimate is from the truth, and how sure a share or a confidence is."""

from collections.abc import Mapping
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from inhand.errors import InputError
from inhand.geometry.mesh import TriangleMesh, points_on_faces
from inhand.geometry.se3 import inverse, rotation_angle, skew, transform
from inhand.object_model import ObjectModel
from inhand.object_symmetry import rotations_about

MODEL_POINTS = 5000
"""Points of the object model that ADI and ADD are averaged over."""

# Screening of many poses: rounds of (model points looked up, poses that go on to the next round).
_SCREENING = ((40, 400), (400, 5))
# Poses looked up in one go, to bound the memory.
_CHUNK = 2000

Array = NDArray[np.float64]


class PoseError(NamedTuple):
    """Difference of two poses of one rigid body."""

    translation: float
    """[m]."""
    rotation: float
    """[rad], 0 to pi."""


def sample_model(mesh: TriangleMesh, count: int = MODEL_POINTS, seed: int = 0) -> Array:
    """Points uniformly random over the mesh's area [m], mesh frame, shape (count, 3)."""
    rng = np.random.default_rng(seed)
    face = rng.choice(len(mesh.faces), size=count, p=mesh.face_areas / mesh.face_areas.sum())
    return points_on_faces(mesh, face, rng)


def add(points: Array, T_estimate: Array, T_truth: Array) -> float:
    """Mean distance [m] of model points [m], shape (n, 3), at two poses, point by point."""
    difference = T_estimate - T_truth
    return float(np.linalg.norm(points @ difference[:3, :3].T + difference[:3, 3], axis=1).mean())


def adi(tree: KDTree, T_estimate: Array, T_truth: Array) -> float:
    """ADI [m]: mean distance of the estimate's model points to the nearest point of the truth's.

    Paper, section V-A. Blind to symmetries of the object, and to errors far below the spacing of
    the points.

    Args:
        tree: the model points, model frame.
        T_estimate: estimated pose, shape (4, 4).
        T_truth: true pose, shape (4, 4).
    """
    moved = transform(inverse(T_truth) @ T_estimate, np.asarray(tree.data))
    return float(tree.query(moved)[0].mean())


class ObjectMetric:
    """Errors of poses of one object.

    Args:
        model: the object.
    """

    def __init__(self, model: ObjectModel) -> None:
        self.model = model

    @cached_property
    def points(self) -> Array:
        """Model points [m], object frame, shape (MODEL_POINTS, 3)."""
        return sample_model(self.model.mesh)

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.points)

    def adi(self, T_estimate: Array, T_truth: Array) -> float:
        """ADI [m] of an estimated pose, shape (4, 4)."""
        return adi(self._tree, np.asarray(T_estimate, np.float64), T_truth)

    def best_adi(self, T_estimates: NDArray[np.floating], T_truth: Array) -> float | None:
        """The smallest ADI [m] among poses of shape (m, 4, 4); None when there are none.

        Fast for thousands of poses: the distance field of the object at its true pose gives the
        mean distance of a few moved model points to the true surface, and only the poses that come
        out best get the exact measure.
        """
        T_error = inverse(T_truth) @ np.asarray(T_estimates, dtype=np.float64).reshape(-1, 4, 4)
        for points, kept in _SCREENING:
            if len(T_error) > kept:
                rough = self._surface_distance(T_error, points)
                T_error = T_error[np.argsort(rough, kind="stable")[:kept]]
        return min((adi(self._tree, T, np.eye(4)) for T in T_error), default=None)

    def _surface_distance(self, T_error: Array, count: int) -> Array:
        """Mean distance [m] to the surface of model points moved by (m, 4, 4), shape (m,)."""
        points = self.points[:count]
        means = []
        for start in range(0, len(T_error), _CHUNK):
            T = T_error[start : start + _CHUNK]
            moved = points @ T[:, :3, :3].swapaxes(1, 2) + T[:, None, :3, 3]
            distance = self.model.distance_field.distance(moved.reshape(-1, 3))
            means.append(np.abs(distance).reshape(len(T), count).mean(axis=1))
        return np.concatenate(means)

    def add(self, T_estimate: Array, T_truth: Array) -> float:
        """ADD [m] to the nearest of the symmetric poses of the truth."""
        symmetric = self._nearest_symmetric(T_estimate, T_truth)
        return add(self.points, np.asarray(T_estimate, np.float64), symmetric)

    def pose_error(self, T_estimate: Array, T_truth: Array) -> PoseError:
        """Error up to the object's symmetries.

        The translation is that of the symmetry centre, which no symmetry moves: the origin of a
        mesh may lie far from the object, where a small rotation is a large motion.
        """
        centre = np.asarray(self.model.symmetry.centre, dtype=np.float64)[None]
        moved = transform(T_estimate, centre) - transform(T_truth, centre)
        symmetric = self._nearest_symmetric(T_estimate, T_truth)
        angle = rotation_angle(T_estimate[:3, :3], symmetric[:3, :3])
        return PoseError(float(np.linalg.norm(moved)), float(angle))

    def _nearest_symmetric(self, T_estimate: Array, T_truth: Array) -> Array:
        """The pose, among those that look like the truth, whose rotation is nearest."""
        symmetry = self.model.symmetry
        alike = T_truth @ symmetry.rotations
        if symmetry.axis is not None:
            angles = _nearest_spin((inverse(alike) @ T_estimate)[:, :3, :3], symmetry.axis)
            alike = alike @ rotations_about(symmetry.centre, symmetry.axis, angles)
        if symmetry.axis is not None and len(symmetry.rotations) > 2:  # a sphere
            alike = _turned_to(T_estimate, T_truth, symmetry.centre)[None]
        differences = rotation_angle(alike[:, :3, :3], T_estimate[None, :3, :3])
        return np.asarray(alike[np.argmin(differences)])


def _nearest_spin(R: Array, axis: Array) -> Array:
    """Angles [rad] of the rotations about `axis` that are nearest to R, shape (k, 3, 3).

    S(a) = cos a I + sin a K + (1 - cos a) axis axis' maximises trace(S(a)' R) at
    a = atan2(<K, R>, trace R - axis' R axis).
    """
    along = np.einsum("i,kij,j->k", axis, R, axis)
    return np.arctan2(np.einsum("ij,kij->k", skew(axis), R), np.trace(R, axis1=1, axis2=2) - along)


def _turned_to(T_estimate: Array, T_truth: Array, centre: Array) -> Array:
    """The truth, turned about the object's centre to the estimate's rotation."""
    turned = np.array(T_estimate)
    turned[:3, 3] += transform(T_truth, centre[None])[0] - transform(T_estimate, centre[None])[0]
    return turned


def wrist_error(T_estimate: Array, T_truth: Array) -> PoseError:
    """Error of a wrist pose, measured at the origin of the hand frame."""
    return PoseError(
        float(np.linalg.norm(T_estimate[:3, 3] - T_truth[:3, 3])),
        float(rotation_angle(T_estimate[:3, :3], T_truth[:3, :3])),
    )


def angle_errors(estimate: Mapping[str, float], truth: Mapping[str, float]) -> dict[str, float]:
    """Absolute error [rad], 0 to pi, of the joints that both name; whole turns do not count."""
    return {
        name: abs((estimate[name] - truth[name] + np.pi) % (2 * np.pi) - np.pi)
        for name in truth
        if name in estimate
    }


def wilson_interval(successes: int, trials: int, z: float = 1.96) -> tuple[float, float]:
    """Confidence interval of a share by Wilson's score method (95 % at z = 1.96); (0, 1) of none.

    Raises:
        InputError: `successes` is not between 0 and `trials`.
    """
    if not 0 <= successes <= trials:
        raise InputError(f"{successes} successes of {trials} trials is not a share")
    if trials == 0:
        return 0.0, 1.0
    share = successes / trials
    scale = 1 + z * z / trials
    middle = (share + z * z / (2 * trials)) / scale
    half = z / scale * np.sqrt(share * (1 - share) / trials + (z / (2 * trials)) ** 2)
    return max(0.0, float(middle - half)), min(1.0, float(middle + half))


def auroc(scores: ArrayLike, correct: ArrayLike) -> float | None:
    """Chance that a correct answer has a higher score than a wrong one, ties counted half.

    The area under the receiver operating characteristic. None without both kinds of answers.

    Args:
        scores: confidences, shape (n,).
        correct: whether each answer is right, shape (n,).
    """
    values, right = np.asarray(scores, dtype=np.float64), np.asarray(correct, dtype=bool)
    wrong_scores = np.sort(values[~right])
    if not right.any() or right.all():
        return None
    below = np.searchsorted(wrong_scores, values[right], side="left")
    not_above = np.searchsorted(wrong_scores, values[right], side="right")
    return float((below + not_above).mean() / 2 / len(wrong_scores))
