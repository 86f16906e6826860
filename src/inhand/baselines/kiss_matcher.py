"""KISS-Matcher (Lim et al., "KISS-Matcher: Fast and Robust Point Cloud Registration Revisited",
2025): Faster-PFH, pruning by a graph of consistent matches, and a robust solver."""

import numpy as np
from numpy.typing import NDArray

from inhand.baselines.method import View, need
from inhand.baselines.registration import Registration
from inhand.errors import NoAnswer
from inhand.packed import PackedObject
from inhand.stages.observation import Cloud

VOXELS = 30
"""Voxels along the object's diameter."""
SCALE = float(__import__("os").environ.get("KS", "1"))


class KissMatcher(Registration):
    """The matcher for one object."""

    def __init__(self, obj: PackedObject, seed: int) -> None:
        self.library = need("kiss_matcher", "kiss-matcher")
        self.model = obj.model.surface.points * SCALE
        import os

        self.matcher = self.library.KISSMatcher(
            self.library.KISSMatcherConfig(
                voxel_size=SCALE * obj.model.diameter / float(os.environ.get("KV", "30")),
                use_voxel_sampling=True,
            )
        )

    def align(self, cloud: Cloud, view: View) -> NDArray[np.float64]:
        """The pose that the matcher finds, shape (1, 4, 4)."""
        solution = self.matcher.estimate(list(self.model), list(cloud.points * SCALE))
        if not solution.valid:
            raise NoAnswer("no part of the cloud looks like a part of the object")
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = solution.rotation, np.ravel(solution.translation) / SCALE
        return T[None]
