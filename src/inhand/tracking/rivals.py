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

SPINS = 36
"""Turns about a continuous axis of symmetry that are looked through."""


@dataclass(frozen=True, eq=False)
class Rival:
    """Another pose of the object."""

    T_object_rival: Array
    """Where it is from the pose that is followed, shape (4, 4)."""
    lead: float
    """By how much its score was better of late, below 0 if worse; see `RivalConfig.visible`."""
    apart: float = math.inf
    """Mean distance [m] of its surface from that of the pose that is followed; twice
    `RivalConfig.apart` where the centres lie farther from each other than that."""


def rivals_of(
    estimate: PoseEstimate,
    T: Array,
    obj: PackedObject,
    config: RivalConfig,
    known: tuple[Rival, ...] = (),
) -> tuple[Rival, ...]:
    """The rivals of a pose: those known, then others that scored nearly as well in a search.

    Each surface counts once. Leads are over the search's candidate that is the pose; if none is,
    over its best.

    Args:
        estimate: what the search found.
        T: the pose, camera frame, shape (4, 4).
        obj: the object.
        config: parameters.
        known: the pose's rivals so far.
    """
    if not estimate.candidates:
        return known
    back, rivals = se3.inverse(T), list(known)
    taken = [T, *(T @ rival.T_object_rival for rival in known)]
    found = [c.T_camera_object for c in estimate.candidates]
    score = [c.scores["score"] for c in estimate.candidates]
    from_answer = _apart(found, T, obj, config)
    itself = int(from_answer.argmin()) if from_answer.min() < config.apart else 0
    for there, of_it in zip(found, score, strict=True):
        lead = of_it - score[itself]
        if lead <= -config.most_behind or len(rivals) == config.most:
            continue
        distances = _apart(taken, there, obj, config)
        if distances.min() > config.apart:
            taken.append(there)
            rivals.append(Rival(back @ _turned_to(T, there, obj), lead, float(distances[0])))
    return tuple(rivals)


def _turned_to(T: Array, there: Array, obj: PackedObject) -> Array:
    """Of the poses that look the same as one, the one that is turned the least from `T`."""
    alike = there @ obj.model.symmetry.representatives(SPINS)
    cosines = np.einsum("ij,nij->n", T[:3, :3], alike[:, :3, :3])
    return np.asarray(alike[cosines.argmax()])


def _apart(poses: list[Array], T: Array, obj: PackedObject, config: RivalConfig) -> Array:
    """Mean distances [m], shape (m,), of surfaces at poses from that at `T`; twice `apart` where
    the centres lie farther from each other than that."""
    at, there = np.array(poses, dtype=np.float32), T.astype(np.float32)
    return np.asarray(surface_distances_to(at, there, obj, 2 * config.apart))


def share_of_answer(rivals: tuple[Rival, ...], config: RivalConfig) -> float:
    """Probability that the followed pose is right, if it or one of its rivals is.

    A rival whose surface is hardly elsewhere does not make it wrong.
    """
    elsewhere = (rival for rival in rivals if rival.apart > config.elsewhere)
    return 1 / (1 + sum(math.exp(rival.lead / config.tells) for rival in elsewhere))


def told_apart(
    rivals: tuple[Rival, ...],
    T: Array,
    fitted: Array,
    leads: Array,
    obj: PackedObject,
    config: RivalConfig,
) -> tuple[Rival, ...]:
    """The rivals after an image, without those that it leaves too far behind.

    Nor is one left that has become the pose that is followed.

    Args:
        rivals: the rivals before it.
        T: the pose that is followed in it, camera frame, shape (4, 4).
        fitted: the rivals' poses in it, camera frame, shape (r, 4, 4).
        leads: by how much each of them scores better, shape (r,).
        obj: the object.
        config: parameters.
    """
    if not rivals:
        return ()
    back, keep = se3.inverse(T), config.memory
    distances = _apart(list(fitted), T, obj, config)
    known = (
        Rival(back @ there, keep * rival.lead + (1 - keep) * float(lead), float(distance))
        for rival, there, lead, distance in zip(rivals, fitted, leads, distances, strict=True)
    )
    return tuple(
        rival for rival in known if rival.apart > config.apart and rival.lead > -config.most_behind
    )
