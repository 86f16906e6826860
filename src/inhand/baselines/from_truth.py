"""A start near the answer: the true pose, perturbed."""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inhand.baselines.method import View
from inhand.baselines.registration import Registration
from inhand.errors import InputError
from inhand.geometry import se3
from inhand.packed import PackedObject
from inhand.stages.observation import Cloud


@dataclass(frozen=True)
class FromTruth(Registration):
    """The object's true pose, moved and turned by fixed amounts in random directions.

    ICP from there is the setting of Choi et al., "Using vision for pre- and post-grasping object
    localization for soft hands" (2016), as the paper evaluates it.
    """

    obj: PackedObject
    seed: int
    perturbation: Mapping[str, float]
    """Length of the displacement of the object's centre, `translation` [m], and angle of the turn
    about it, `rotation` [rad]; 0 where it is left out."""

    def align(self, cloud: Cloud, view: View) -> NDArray[np.float64]:
        """The perturbed pose; the image decides the directions, so that each frame has its own."""
        if view.true_T_camera_object is None:
            raise InputError("the method needs the object's true pose, which this frame lacks")
        rng = np.random.default_rng([self.seed, zlib.crc32(view.depth.tobytes())])
        along, about = rng.normal(size=(2, 3))
        centre, motion = np.eye(4), np.zeros(6)
        centre[:3, 3] = self.obj.model.centre
        motion[:3] = self.perturbation.get("rotation", 0.0) * about / np.linalg.norm(about)
        motion[3:] = self.perturbation.get("translation", 0.0) * along / np.linalg.norm(along)
        moved = view.true_T_camera_object @ centre @ se3.exp(motion) @ se3.inverse(centre)
        return np.asarray(moved)[None]
