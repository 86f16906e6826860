"""Registration by local features with Open3D: FPFH with RANSAC, and fast global registration."""

from abc import abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.baselines.method import View, need
from inhand.baselines.registration import Registration
from inhand.errors import NoAnswer
from inhand.geometry.se3 import inverse
from inhand.packed import PackedObject
from inhand.stages.observation import Cloud

VOXELS = 30
"""Voxels along the object's diameter in the clouds that features are made of."""
FEATURE_RADIUS = 5.0
"""Radius of a feature's neighbourhood, in voxels."""
MATCH_DISTANCE = 1.5
"""A match is an inlier within this, in voxels."""
RANSAC_ITERATIONS = 100_000
CONFIDENCE = 0.999
EDGE_SIMILARITY = 0.9
"""Smallest ratio of the lengths of corresponding edges among the three drawn matches."""


class Open3DFeatures(Registration):
    """What both methods share: clouds of voxels, and their FPFH (Rusu et al., 2009).

    The cloud is the source: it is a part of the model, and the model no part of it.
    """

    name = "features"

    def __init__(self, obj: PackedObject, seed: int) -> None:
        self.open3d = need("open3d", self.name)
        self.registration = self.open3d.pipelines.registration
        self.seed = seed
        self.voxel = obj.model.diameter / VOXELS
        surface = obj.model.surface
        self.model, self.model_features = self._features(surface.points, surface.normals)

    def align(self, cloud: Cloud, view: View) -> NDArray[np.float64]:
        """The pose that Open3D finds, shape (1, 4, 4)."""
        self.open3d.utility.random.seed(self.seed)
        scene, features = self._features(cloud.points, cloud.normals)
        result = self._register(scene, features)
        if not len(result.correspondence_set):
            raise NoAnswer("no part of the cloud looks like a part of the object")
        return inverse(np.array(result.transformation))[None]

    @abstractmethod
    def _register(self, scene: Any, features: Any) -> Any:
        """Open3D's result for the transform from the scene to the model."""

    def _features(
        self, points: NDArray[np.float32], normals: NDArray[np.float32]
    ) -> tuple[Any, Any]:
        geometry = self.open3d.geometry
        cloud = geometry.PointCloud(self.open3d.utility.Vector3dVector(points.astype(np.float64)))
        cloud.normals = self.open3d.utility.Vector3dVector(normals.astype(np.float64))
        cloud = cloud.voxel_down_sample(self.voxel)
        cloud.normalize_normals()
        around = geometry.KDTreeSearchParamHybrid(FEATURE_RADIUS * self.voxel, 100)
        return cloud, self.registration.compute_fpfh_feature(cloud, around)


class FpfhRansac(Open3DFeatures):
    """RANSAC over matched features (Holz et al., "Registration with the Point Cloud Library",
    2015, is the recipe)."""

    name = "fpfh-ransac"

    def _register(self, scene: Any, features: Any) -> Any:
        r, distance = self.registration, MATCH_DISTANCE * self.voxel
        return r.registration_ransac_based_on_feature_matching(
            scene, self.model, features, self.model_features, False, distance,
            r.TransformationEstimationPointToPoint(False), 3,
            [
                r.CorrespondenceCheckerBasedOnEdgeLength(EDGE_SIMILARITY),
                r.CorrespondenceCheckerBasedOnDistance(distance),
            ],
            r.RANSACConvergenceCriteria(RANSAC_ITERATIONS, CONFIDENCE),
        )  # fmt: skip


class FastGlobalRegistration(Open3DFeatures):
    """Zhou, Park and Koltun, "Fast Global Registration" (2016)."""

    name = "fgr"

    def _register(self, scene: Any, features: Any) -> Any:
        r = self.registration
        option = (
            r.FastGlobalRegistrationOption(
                maximum_correspondence_distance=MATCH_DISTANCE * self.voxel,
                use_absolute_scale=True,
                seed=self.seed,
            )
            if False
            else r.FastGlobalRegistrationOption(
                maximum_correspondence_distance=MATCH_DISTANCE * self.voxel
            )
        )
        return r.registration_fgr_based_on_feature_matching(
            scene, self.model, features, self.model_features, option
        )
