"""Poses that a search could hardly tell from its answer.

They are followed as well, until the images have told them apart.
"""

import math
from dataclasses import dataclass

import numpy as np

from inhand.estimate import PoseEstimate
from inhand.geometry import se3
from inhand.packed import PackedObject
from inhand.stages.clustering import surface_distances_to
from inhand.tracking.config import RivalConfig
from inhand.tracking.gaussian import Array


@dataclass(frozen=True, eq=False)
class Rival:
    """Another pose of the object."""

    T_object_rival: Array
    """Where it is from the pose that is followed, shape (4, 4)."""
    lead: float
    """By how much its score of the estimator's selection was better of late, below 0 if worse."""


def rivals_of(estimate: PoseEstimate, obj: PackedObject, config: RivalConfig) -> tuple[Rival, ...]:
    """The other poses that scored nearly as well as a search's answer, each surface but once.

    Args:
        estimate: the answer, found.
        obj: the object.
        config: parameters.
    """
    poses = np.array([c.T_camera_object for c in estimate.candidates], dtype=np.float32)
    scores = [c.scores["score"] for c in estimate.candidates]
    chosen = [0]
    rivals: list[Rival] = []
    for i in range(1, len(poses)):
        lead = scores[i] - scores[0]
        near = surface_distances_to(poses[chosen], poses[i], obj, 2 * config.apart)
        if lead > -config.most_behind and near.min() > config.apart and len(rivals) < config.most:
            chosen.append(i)
            back = se3.inverse(estimate.candidates[0].T_camera_object)
            rivals.append(Rival(back @ estimate.candidates[i].T_camera_object, lead))
    return tuple(rivals)


def share_of_answer(rivals: tuple[Rival, ...], config: RivalConfig) -> float:
    """Probability that the followed pose is right, if it or one of its rivals is."""
    return 1 / (1 + sum(math.exp(rival.lead / config.tells) for rival in rivals))


def told_apart(
    rivals: tuple[Rival, ...], T: Array, fitted: Array, leads: Array, config: RivalConfig
) -> tuple[Rival, ...]:
    """The rivals after an image, without those that it leaves too far behind.

    Args:
        rivals: the rivals before it.
        T: the pose that is followed in it, camera frame, shape (4, 4).
        fitted: the rivals' poses in it, camera frame, shape (r, 4, 4).
        leads: by how much each of them scores better, shape (r,).
        config: parameters.
    """
    back = se3.inverse(T)
    keep = config.memory
    known = (
        Rival(back @ there, keep * rival.lead + (1 - keep) * float(lead))
        for rival, there, lead in zip(rivals, fitted, leads, strict=True)
    )
    return tuple(rival for rival in known if rival.lead > -config.most_behind)
