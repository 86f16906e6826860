"""When a tracker that is lost believes the estimator, and what it makes of two who agree.

What one image shows in part, something else may look like. That it does so where the track expects
the object, or twice at one place in a hand that moves, is rare.
"""

from dataclasses import dataclass, replace

import numpy as np

from inhand.errors import NoAnswer
from inhand.estimate import PoseEstimate
from inhand.geometry import se3
from inhand.packed import PackedHand, PackedObject
from inhand.stages.clustering import surface_distances_to
from inhand.stages.evidence import gather_evidence, score_with_contact
from inhand.stages.observation import Observation
from inhand.stages.results import HandState
from inhand.tracking.config import TrackerConfig
from inhand.tracking.gaussian import Array, fused, twist_between
from inhand.tracking.loss import seen_confidence
from inhand.tracking.object_track import segment_near
from inhand.tracking.track import Track, begun

SPINS = 36
"""Turns about a continuous axis of symmetry that are looked through."""
FARTHEST = 12.6
"""Poses farther apart than this, squared and in units of their covariances, are two: 95 % of those
that are one lie below (chi squared, six degrees of freedom)."""


@dataclass(frozen=True, eq=False)
class Sighting:
    """A sure answer of the estimator."""

    T_camera_hand: Array
    """Wrist pose, shape (4, 4)."""
    T_camera_object: Array
    """Pose of the object, shape (4, 4)."""

    @classmethod
    def of(cls, estimate: PoseEstimate) -> "Sighting":
        """What an answer of the estimator says, which is found."""
        assert estimate.T_camera_hand is not None
        assert estimate.T_camera_object is not None
        return cls(estimate.T_camera_hand, estimate.T_camera_object)

    def agrees_with(self, other: "Sighting", obj: PackedObject, config: TrackerConfig) -> bool:
        """Whether another has the object's surface at the same place in the hand."""
        there = self.T_camera_hand @ se3.inverse(other.T_camera_hand) @ other.T_camera_object
        return same_place(self.T_camera_object, there, obj, config)


def stands_beside_the_hand(
    estimate: PoseEstimate,
    track: Track,
    observation: Observation,
    hand: PackedHand,
    obj: PackedObject,
    config: TrackerConfig,
) -> bool:
    """Whether the image shows an answer's object beside the hand that is followed.

    If not, what it takes for the object is a part of that hand, or fits it by chance.

    Args:
        estimate: the answer, found.
        track: the track, with its hand as this image shows it.
        observation: the image.
        hand, obj: the models.
        config: parameters.
    """
    c, T, q = config.loss, Sighting.of(estimate).T_camera_object, track.joint_vector
    links = hand.link_poses(q[None], track.T_camera_hand[None])[0]
    state = HandState(q, track.T_camera_hand, links, track.certain)
    there = replace(track, T_camera_object=T)
    try:
        segment = segment_near(observation, state, there, hand, obj, config)
    except NoAnswer:
        return False
    evidence = gather_evidence(observation, state, segment, hand, config.estimator.evidence)
    one, selection = T[None].astype(np.float32), config.estimator.selection
    score = float(score_with_contact(evidence, obj, one, selection)[0])
    return seen_confidence(c.again, score, c) >= c.lost


def same_place(T: Array, other: Array, obj: PackedObject, config: TrackerConfig) -> bool:
    """Whether the object's surface is at the same place at two poses, both of shape (4, 4)."""
    distance = config.loss.same
    one, two = T.astype(np.float32), other.astype(np.float32)
    return bool(surface_distances_to(one[None], two, obj, 2 * distance)[0] < distance)


def resumed(
    track: Track,
    estimate: PoseEstimate,
    given: Array,
    hand: PackedHand,
    obj: PackedObject,
    config: TrackerConfig,
) -> Track:
    """The track that goes on from an answer of the estimator.

    If it is where the track expected the object, both count, weighed by how well they are known.

    Args:
        track: the track as predicted.
        estimate: the answer, found.
        given: the wrist pose that came with the image, shape (4, 4).
        hand, obj: the models.
        config: parameters.
    """
    anew = begun(estimate, given, hand.hand, config)
    expected, centre = track.T_camera_object, obj.model.centre
    variance = track.whole_covariance + anew.whole_covariance

    def apart(T: Array) -> float:
        twist = twist_between(expected, T, centre)
        return float(twist @ np.linalg.solve(variance, twist))

    alike = anew.T_camera_object @ obj.model.symmetry.representatives(SPINS)
    nearest = min(alike, key=apart)
    if apart(nearest) > FARTHEST:
        return anew
    T, covariance = fused(
        (expected, track.whole_covariance), (nearest, anew.whole_covariance), centre
    )
    none = np.zeros_like(covariance)
    return replace(anew, T_camera_object=T, answer=T, object_covariance=covariance, lasting=none)
