"""Registration by local features with Open3D: FPFH with RANSAC, and fast global registration."""

import importlib
from abc import abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.baselines.method import View
from inhand.baselines.registration import Registration
from inhand.errors import NoAnswer
from inhand.geometry.se3 import inverse
from inhand.packed import PackedObject
from inhand.stages.observation import Cloud

VOXELS = 30
"""Voxels along the object's diameter in the clouds that features are made of."""
FEATURE_RADIUS, NEIGHBOURS = 5.0, 100
"""A feature's neighbourhood: its radius in voxels, and the most points that count."""
MATCH_DISTANCE = 1.5
"""A match is an inlier within this, in voxels."""
MIN_MATCHES = 3
"""Fewer fix no pose."""
ITERATIONS, CONFIDENCE = 100_000, 0.999
"""RANSAC ends after so many iterations, or when it is this sure."""
EDGE_SIMILARITY = 0.9
"""RANSAC: smallest ratio of the lengths of corresponding edges among the three drawn matches."""


class Open3DFeatures(Registration):
    """What both methods share: clouds of voxels and their features (FPFH, Rusu et al., 2009).

    The cloud is the source: it is a part of the model, and the model no part of it.
    """

    def __init__(self, obj: PackedObject, seed: int) -> None:
        open3d: Any = importlib.import_module("open3d")
        open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
        self.open3d, self.seed = open3d, seed
        self.voxel = obj.model.diameter / VOXELS
        surface = obj.model.surface
        self.model, self.model_features = self._features(surface.points, surface.normals)

    def align(self, cloud: Cloud, view: View) -> NDArray[np.float64]:
        """The pose that Open3D finds, shape (1, 4, 4)."""
        self.open3d.utility.random.seed(self.seed)
        scene, features = self._features(cloud.points, cloud.normals)
        result = self._register(scene, features)
        if len(result.correspondence_set) < MIN_MATCHES:
            raise NoAnswer("no part of the cloud looks like a part of the object")
        return inverse(np.array(result.transformation))[None]

    @abstractmethod
    def _register(self, scene: Any, features: Any) -> Any:
        """Open3D's result for the transform from the scene to the model."""

    def _features(
        self, points: NDArray[np.float32], normals: NDArray[np.float32]
    ) -> tuple[Any, Any]:
        geometry, vectors = self.open3d.geometry, self.open3d.utility.Vector3dVector
        cloud = geometry.PointCloud(vectors(points.astype(np.float64)))
        cloud.normals = vectors(normals.astype(np.float64))
        cloud = cloud.voxel_down_sample(self.voxel)
        cloud.normalize_normals()
        around = geometry.KDTreeSearchParamHybrid(FEATURE_RADIUS * self.voxel, NEIGHBOURS)
        return cloud, self.open3d.pipelines.registration.compute_fpfh_feature(cloud, around)


class FpfhRansac(Open3DFeatures):
    """RANSAC over matched features."""

    def _register(self, scene: Any, features: Any) -> Any:
        r, distance = self.open3d.pipelines.registration, MATCH_DISTANCE * self.voxel
        checks = [
            r.CorrespondenceCheckerBasedOnEdgeLength(EDGE_SIMILARITY),
            r.CorrespondenceCheckerBasedOnDistance(distance),
        ]
        return r.registration_ransac_based_on_feature_matching(
            scene,
            self.model,
            features,
            self.model_features,
            mutual_filter=False,
            max_correspondence_distance=distance,
            checkers=checks,
            criteria=r.RANSACConvergenceCriteria(ITERATIONS, CONFIDENCE),
        )


class FastGlobalRegistration(Open3DFeatures):
    """Zhou, Park and Koltun, "Fast Global Registration" (2016)."""

    def _register(self, scene: Any, features: Any) -> Any:
        r = self.open3d.pipelines.registration
        return r.registration_fgr_based_on_feature_matching(
            scene,
            self.model,
            features,
            self.model_features,
            r.FastGlobalRegistrationOption(
                decrease_mu=True, maximum_correspondence_distance=MATCH_DISTANCE * self.voxel
            ),
        )
