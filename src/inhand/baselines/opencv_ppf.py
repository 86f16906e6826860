"""Point pair features with OpenCV's surface_matching (Drost et al., "Model Globally, Match
Locally", 2010)."""

import numpy as np
from numpy.typing import NDArray

from inhand.baselines.method import View
from inhand.baselines.registration import Registration
from inhand.errors import NoAnswer
from inhand.packed import PackedObject
from inhand.stages.observation import Cloud

SAMPLING = 0.08
"""Distance between sampled points, and step of the pair distance, in diameters of the model.
Training slows down with a high power of it: 0.08 takes seconds, 0.07 half a minute."""
SCENE_SHARE = 1 / 5
"""Share of the scene's sampled points that vote."""
POSES = 10
"""Poses with the most votes that go on to ICP."""


class OpenCVPpf(Registration):
    """The detector, trained on the object."""

    def __init__(self, obj: PackedObject, seed: int) -> None:
        from cv2 import ppf_match_3d

        surface = obj.model.surface
        self.detector = ppf_match_3d.PPF3DDetector(SAMPLING, SAMPLING)
        self.detector.trainModel(np.hstack([surface.points, surface.normals]))

    def align(self, cloud: Cloud, view: View) -> NDArray[np.float64]:
        """The poses with the most votes, shape (m, 4, 4)."""
        scene = np.hstack([cloud.points, cloud.normals])
        found = self.detector.match(scene, SCENE_SHARE, SAMPLING)
        if not found:
            raise NoAnswer("no pairs of the cloud's points are like pairs of the object's")
        return np.stack([pose.pose for pose in found[:POSES]])
