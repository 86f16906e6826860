"""How far an estimate is from the truth.

MSSD, MSPD and their thresholds: Hodan et al., "BOP Challenge 2020 on 6D object localization",
section 2.2.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from inhand.camera import Camera
from inhand.evaluation import visible_surface
from inhand.evaluation.symmetric_poses import nearest_symmetric, symmetric_poses
from inhand.geometry.mesh import TriangleMesh, points_on_faces
from inhand.geometry.se3 import inverse, rotation_angle, transform
from inhand.kernels.depth import DepthRenderer
from inhand.object_model import ObjectModel

MODEL_POINTS = 5000
"""Points of the object model that ADI and ADD are averaged over."""

MSSD_THRESHOLDS = np.arange(1, 11) * 0.05
"""BOP's thresholds of MSSD, in diameters of the object."""
MSPD_THRESHOLDS = np.arange(1, 11) * 5.0
"""BOP's thresholds of MSPD [pixel], for an image that is `MSPD_WIDTH` pixels wide."""
MSPD_WIDTH = 640

# Screening of many poses: rounds of (model points looked up, poses that go on to the next round).
_SCREENING = ((40, 400), (400, 5))
# Vertices that bound the largest distance of a pose from below.
_FEW_POINTS = 40
# Poses looked up in one go, to bound the memory.
_CHUNK = 2000

Array = NDArray[np.float64]


class PoseError(NamedTuple):
    """Difference of two poses of one rigid body."""

    translation: float
    """[m]."""
    rotation: float
    """[rad], 0 to pi."""


@dataclass(frozen=True)
class PoseScores:
    """Every error of an estimated object pose. Lengths [m]."""

    adi: float
    """ADI of the paper: from the estimate's points to the truth's."""
    adi_from_truth: float
    """ADI of the BOP toolkit: from the truth's points to the estimate's."""
    add: float
    """ADD to the symmetric pose of the truth that is turned least from the estimate."""
    mssd: float
    """Maximum symmetry-aware surface distance."""
    mspd: float | None
    """Maximum symmetry-aware projection distance [pixel]; None behind the camera."""
    translation_error: float
    """Displacement of the object's symmetry centre."""
    rotation_error: float
    """Rotation to the nearest symmetric pose [rad]."""
    mssd_share: float
    """Share of BOP's MSSD thresholds that the pose stays below."""
    mspd_share: float
    """Share of BOP's MSPD thresholds that the pose stays below."""
    vsd_share: float
    """Share of BOP's VSD tolerances and thresholds that the pose stays below."""


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
    the points. The BOP toolkit measures from the truth's points to the estimate's: swap the poses.

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
        device: Warp device of the rendering for VSD.
    """

    def __init__(self, model: ObjectModel, device: str = "cpu") -> None:
        self.model = model
        self._device = device

    @cached_property
    def points(self) -> Array:
        """Model points [m], object frame, shape (MODEL_POINTS, 3)."""
        return sample_model(self.model.mesh)

    @cached_property
    def _renderer(self) -> DepthRenderer:
        return DepthRenderer([self.model.mesh], self._device)

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.points)

    def adi(self, T_estimate: Array, T_truth: Array) -> float:
        """ADI [m] of an estimated pose, shape (4, 4)."""
        return adi(self._tree, np.asarray(T_estimate, np.float64), T_truth)

    def scores(
        self, T_estimate: Array, T_truth: Array, depth: NDArray[np.floating], camera: Camera
    ) -> PoseScores:
        """Every error of an estimated pose.

        Args:
            T_estimate: estimated pose, shape (4, 4).
            T_truth: true pose, shape (4, 4).
            depth: the depth image [m], shape (H, W), 0 where there is no reading.
            camera: its camera.
        """
        T_estimate = np.asarray(T_estimate, dtype=np.float64)
        pose = self.pose_error(T_estimate, T_truth)
        mssd = self.mssd(T_estimate, T_truth)
        mspd = self.mspd(T_estimate, T_truth, camera)
        vsd = self.vsd(T_estimate, T_truth, depth, camera)
        return PoseScores(
            adi=self.adi(T_estimate, T_truth),
            adi_from_truth=self.adi(T_truth, T_estimate),
            add=self.add(T_estimate, T_truth),
            mssd=mssd,
            mspd=mspd if np.isfinite(mspd) else None,
            translation_error=pose.translation,
            rotation_error=pose.rotation,
            mssd_share=float((mssd < MSSD_THRESHOLDS * self.model.mesh.diameter).mean()),
            mspd_share=float((mspd < MSPD_THRESHOLDS * camera.width / MSPD_WIDTH).mean()),
            vsd_share=float((vsd[:, None] < visible_surface.THRESHOLDS).mean()),
        )

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
        symmetric = nearest_symmetric(self.model.symmetry, T_estimate, T_truth)
        return add(self.points, np.asarray(T_estimate, np.float64), symmetric)

    def mssd(self, T_estimate: Array, T_truth: Array) -> float:
        """MSSD [m]: the largest distance of a vertex from its place in the truth.

        Of the poses that look like the truth, the one that makes it smallest counts. No vertex
        moves farther than the farthest one of the convex hull.
        """

        def distances(T: Array, points: Array) -> Array:
            difference = T_estimate - T
            moved = points @ difference[:, :3, :3].swapaxes(1, 2) + difference[:, None, :3, 3]
            return np.asarray(np.linalg.norm(moved, axis=2))

        alike = symmetric_poses(self.model.symmetry, T_estimate, T_truth)
        return _smallest_maximum(distances, alike, self.model.mesh.hull_vertices)

    def mspd(self, T_estimate: Array, T_truth: Array, camera: Camera) -> float:
        """MSPD [pixel]: as MSSD, between the vertices' projections; infinite behind the camera."""

        def distances(T: Array, points: Array) -> Array:
            estimate, truth = _project(T_estimate[None], points), _project(T, points)
            focal = np.array([camera.fx, camera.fy])
            return np.asarray(np.linalg.norm(focal * (estimate - truth), axis=2))

        alike = symmetric_poses(self.model.symmetry, T_estimate, T_truth)
        mesh = self.model.mesh
        vertices = mesh.vertices[np.unique(mesh.faces)]
        if transform(T_estimate, vertices)[:, 2].min() <= 0:
            return float("inf")
        return _smallest_maximum(distances, alike, vertices)

    def vsd(
        self, T_estimate: Array, T_truth: Array, depth: NDArray[np.floating], camera: Camera
    ) -> Array:
        """VSD for each of BOP's tolerances, shape (10,); see `scores` for the arguments."""
        truth, estimate = (self._renderer.render(camera, T[None])[0] for T in (T_truth, T_estimate))
        return visible_surface.vsd(depth, truth, estimate, camera, self.model.mesh.diameter)

    def pose_error(self, T_estimate: Array, T_truth: Array) -> PoseError:
        """Error up to the object's symmetries.

        The translation is that of the symmetry centre, which no symmetry moves: the origin of a
        mesh may lie far from the object, where a small rotation is a large motion.
        """
        centre = np.asarray(self.model.symmetry.centre, dtype=np.float64)[None]
        moved = transform(T_estimate, centre) - transform(T_truth, centre)
        symmetric = nearest_symmetric(self.model.symmetry, T_estimate, T_truth)
        angle = rotation_angle(T_estimate[:3, :3], symmetric[:3, :3])
        return PoseError(float(np.linalg.norm(moved)), float(angle))


def _smallest_maximum(
    distances: Callable[[Array, Array], Array], poses: Array, points: Array
) -> float:
    """Over the poses, the smallest of their largest distances over the points.

    A few points bound every pose's largest distance from below, so the poses are gone through in
    the order of this bound, and most need not be looked at with all points.
    """
    few = points[:: -(-len(points) // _FEW_POINTS)]
    bound = distances(poses, few).max(axis=1)
    best = float("inf")
    for i in np.argsort(bound, kind="stable"):
        if bound[i] >= best:
            break
        best = min(best, float(distances(poses[i : i + 1], points).max()))
    return best


def _project(T: Array, points: Array) -> Array:
    """Points (n, 3) moved by poses (k, 4, 4) and projected at focal length 1, shape (k, n, 2)."""
    moved = points @ T[:, :3, :3].swapaxes(1, 2) + T[:, None, :3, 3]
    return np.asarray(moved[..., :2] / moved[..., 2:])
