"""The object in the next image, from where it is expected."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp

from inhand.errors import NoAnswer
from inhand.geometry import se3
from inhand.geometry.se3 import moved
from inhand.kernels.launch import launch, on_device
from inhand.object_model import ObjectModel
from inhand.packed import PackedHand, PackedObject, device_poses
from inhand.stages.evidence import Evidence, agreement, contact_penalty
from inhand.stages.observation import Observation
from inhand.stages.precision import loosest_twists
from inhand.stages.refinement import fit_to_field
from inhand.stages.results import HandState, Segment
from inhand.tracking.config import ObjectTrackConfig, TrackerConfig
from inhand.tracking.gaussian import Array, twist_between
from inhand.tracking.kernels import object_weights
from inhand.tracking.rivals import Rival, told_apart
from inhand.tracking.track import Track, start_covariance


@dataclass(frozen=True, eq=False)
class FollowedObject:
    """The object in an image."""

    T_camera_object: Array
    """Its pose, shape (4, 4)."""
    covariance: Array
    """Of its twist about the centre by errors that change from image to image, shape (6, 6)."""
    lasting: Array
    """Its twist by each unit of the errors that do not, shape (6, 6); see `Track.lasting`."""
    innovation: Array
    """Twist from where it was expected to where the image alone has it, shape (6,)."""
    innovation_covariance: Array
    """Its covariance if nothing moved, shape (6, 6)."""
    score: float
    """Score of the pose, as in the estimator's selection."""
    rivals: tuple[Rival, ...]
    """What else it may be, as of this image."""

    def kept_in(self, track: Track, confidence: float, config: TrackerConfig) -> Track:
        """The track with the object here, right with this probability."""
        keep = config.object.memory
        return replace(
            track,
            T_camera_object=self.T_camera_object,
            object_covariance=self.covariance,
            lasting=self.lasting,
            motion=keep * track.motion + (1 - keep) * self.innovation,
            motion_covariance=keep**2 * track.motion_covariance
            + (1 - keep) ** 2 * self.innovation_covariance,
            images=track.images + 1,
            confidence=confidence,
            rivals=self.rivals,
        )


def segment_near(
    observation: Observation,
    state: HandState,
    track: Track,
    hand: PackedHand,
    obj: PackedObject,
    config: TrackerConfig,
) -> Segment:
    """The object segment: scene points near where the object is expected that are not the hand's.

    Raises:
        NoAnswer: there are too few.
    """
    c, near, device = config.estimator.segmentation, config.object, obj.device
    weight = wp.empty(len(observation.points), dtype=float, device=device)
    launch(
        object_weights,
        len(weight),
        [observation.cloud_on_device[0], hand.fields]
        + [device_poses(state.T_camera_link, device)]
        + [
            on_device(links.astype(np.int32), int, device)
            for links in (state.certain, ~state.certain)
        ]
        + [obj.fields, _mat44(track.T_camera_object), near.near]
        + [c.hand_distance, c.certain_distance, c.uncertain_weight, weight],
        device,
        work_per_item=10,
    )
    weights = weight.numpy()
    keep = np.flatnonzero(weights > 0)
    if weights.sum() < near.min_points:
        raise NoAnswer(
            f"only {len(keep)} depth readings show the object where it is expected: it is hidden, "
            "or has left that place"
        )
    # How far the points are from the hand matters only to those who draw pairs of them.
    unused = np.zeros(len(keep), dtype=np.float32)
    return Segment(observation.points[keep], observation.normals[keep], unused, weights[keep])


def follow_object(
    evidence: Evidence, obj: PackedObject, track: Track, config: TrackerConfig
) -> FollowedObject:
    """Refine and score two starts; hold the better to the prediction as firmly as that is known.

    The object starts where it is expected, and where it would be if it went on as of late. Its
    rivals are refined beside it, and poses to either side; one that has become better is followed
    in its place.

    Args:
        evidence: the image.
        obj: the object.
        track: the track as predicted.
        config: parameters.
    """
    c, centre = config.object, obj.model.centre
    expected = track.T_camera_object
    rivals = [expected @ rival.T_object_rival for rival in track.rivals]
    aside = _poses_aside(track, obj.model, c)
    starts = np.stack([expected, moved(expected, track.motion, centre), *rivals, *aside])
    fitted = fit_to_field(
        evidence, obj, c.image_weight, starts, c.points, c.iterations, (c.first_width, c.last_width)
    )[0].astype(np.float64)
    score, merit = _scores(evidence, obj, fitted, config)
    best = int(np.argmax(score[:2] + [c.start_lead, 0.0]))
    T = fitted[best]
    leads, n = merit[2:] - merit[best], len(rivals)
    left = told_apart(track.rivals, T, fitted[2 : 2 + n], leads[:n], obj, config.rivals)
    ahead = [rival for rival in left if rival.lead > config.rivals.overtakes]
    ahead += [
        Rival(se3.inverse(T) @ there, float(lead))
        for there, lead in zip(fitted[2 + n :], leads[n:], strict=True)
        if lead > c.aside_lead
    ]
    if ahead:
        first = max(ahead, key=lambda rival: rival.lead)
        track = _overtaken(track, T, first, left, config)
        return follow_object(evidence, obj, track, config)
    widths = c.last_width, c.last_width
    _, A, b = fit_to_field(evidence, obj, c.image_weight, T[None], c.points, 1, widths)
    seen = c.point_information * A[0].astype(np.float64)
    innovation = twist_between(expected, T, centre)
    prior = np.linalg.inv(track.object_covariance)
    covariance = np.linalg.inv(seen + prior)
    way = twist_between(T, expected, centre)
    step = covariance @ (c.point_information * b[0] + prior @ way)
    # The same error in all images: what the image adds comes on top of what is left of it.
    kept = np.eye(6) - covariance @ seen
    lasting = kept @ track.lasting + c.lasting * covariance @ _root(seen)
    # What no image tells is taken to be known as well as at the start.
    of_image = np.linalg.inv(seen + np.linalg.inv(start_covariance(config)))
    return FollowedObject(
        T_camera_object=moved(T, step, centre),
        covariance=covariance,
        lasting=lasting,
        innovation=innovation,
        innovation_covariance=track.object_covariance + of_image,
        score=float(score[best]),
        rivals=left,
    )


def _poses_aside(track: Track, obj: ObjectModel, config: ObjectTrackConfig) -> list[Array]:
    """Poses to either side of the expected one, where the track lets its surface move the most.

    An image that hardly determines a direction does not pull the pose back along it either, but
    its score tells: it counts what the camera would see if the object were there.
    """
    information = np.asarray(np.linalg.inv(track.whole_covariance), dtype=np.float64)
    twists, sds = loosest_twists(information, obj, track.T_camera_object)
    if sds[0] < config.least_aside:
        return []
    way = config.aside * sds[0] * twists[0]
    return [moved(track.T_camera_object, twist, obj.centre) for twist in (way, -way)]


def _scores(
    evidence: Evidence, obj: PackedObject, T: Array, config: TrackerConfig
) -> tuple[Array, Array]:
    """Scores, shape (m,), of poses (m, 4, 4): the estimator's, and what tells rivals apart."""
    samples, poses = config.estimator.selection, device_poses(T, obj.device)
    visible, explained = agreement(evidence, obj, poses, samples).astype(np.float64).T
    rest = explained - contact_penalty(evidence, obj, poses, samples.contact_points)
    return visible + rest, config.rivals.visible * visible + rest


def _overtaken(
    track: Track, T: Array, ahead: Rival, rivals: tuple[Rival, ...], config: TrackerConfig
) -> Track:
    """The track with a rival in the place of the pose T, which is a rival from now on."""
    there = se3.inverse(ahead.T_object_rival)
    before = Rival(np.eye(4), 0.0, ahead.apart)
    behind = [before, *(rival for rival in rivals if rival is not ahead)]
    start = start_covariance(config)
    return replace(
        track,
        T_camera_object=T @ ahead.T_object_rival,
        object_covariance=start,
        lasting=config.start.lasting * np.sqrt(start),
        motion=np.zeros(6),
        rivals=tuple(
            replace(r, T_object_rival=there @ r.T_object_rival, lead=r.lead - ahead.lead)
            for r in behind
        ),
    )


def _root(A: Array) -> Array:
    """Symmetric root of a positive semidefinite matrix."""
    values, vectors = np.linalg.eigh(A)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0)) @ vectors.T)


def _mat44(T: Array) -> Any:
    """A pose (4, 4) as a kernel argument."""
    return wp.mat44(*T.reshape(-1).tolist())
