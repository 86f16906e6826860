"""What the tracker knows from one image to the next."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from inhand.estimate import PoseEstimate
from inhand.geometry import se3
from inhand.hand import Hand
from inhand.kinematics import PRISMATIC
from inhand.tracking.config import TrackerConfig
from inhand.tracking.gaussian import Array, carried, twist_between
from inhand.tracking.loss import expected_confidence
from inhand.tracking.rivals import Rival


@dataclass(frozen=True, eq=False)
class Track:
    """State of hand and object, with what is uncertain about it."""

    given: Array
    """The wrist pose that was given with the last image, shape (4, 4)."""
    T_camera_hand: Array
    """Estimated wrist pose, shape (4, 4)."""
    joint_vector: Array
    """Independent joint positions [rad, m], shape (n,)."""
    hand_covariance: Array
    """Of the wrist's twist about its origin and the joints, shape (6 + n, 6 + n)."""
    certain: NDArray[np.bool_]
    """Whether the last image supported each link where it was, shape (L,)."""
    T_camera_object: Array
    """Estimated pose of the object, shape (4, 4)."""
    object_covariance: Array
    """Of its twist about the object's centre by errors that change from image to image, (6, 6)."""
    lasting: Array
    """Its twist by each unit of the errors that are the same in all images, shape (6, 6): of the
    sensor's noise near edges, of the models, of the hand. More images do not lessen these."""
    motion: Array
    """Recent twist per image beyond what was predicted, shape (6,)."""
    motion_covariance: Array
    """Covariance of what `motion` is if nothing moves, shape (6, 6)."""
    hand_motion: Array
    """Recent velocity of the given wrist, about its origin, [rad/s, m/s], shape (6,)."""
    answer: Array
    """The object's pose that is answered, shape (4, 4): this one may stay while nothing moves."""
    images: int
    """In how many images the object was followed without a break."""
    confidence: float
    """Probability that the object's pose is not another altogether."""
    rivals: tuple[Rival, ...] = ()
    """Other poses that the images have not told from this one yet."""
    searched: bool = True
    """Whether a search has looked for rivals since the object was last hidden."""

    @property
    def whole_covariance(self) -> Array:
        """Covariance of the object's twist by errors of both kinds, shape (6, 6)."""
        return np.asarray(self.object_covariance + self.lasting @ self.lasting.T)


def begun(estimate: PoseEstimate, given: Array, hand: Hand, config: TrackerConfig) -> Track:
    """The track that begins with an answer of the estimator.

    Args:
        estimate: the answer, found.
        given: the wrist pose that came with the image, shape (4, 4).
        hand: the hand.
        config: parameters.
    """
    assert estimate.T_camera_hand is not None
    assert estimate.T_camera_object is not None
    c = config.start
    wrist = [c.wrist_turn] * 3 + [c.wrist_shift] * 3
    return Track(
        given=given,
        T_camera_hand=estimate.T_camera_hand,
        joint_vector=hand.joint_vector(estimate.joint_positions),
        hand_covariance=np.diag(np.concatenate([wrist, c.joint * joint_scale(hand, config)]) ** 2),
        certain=np.zeros(len(hand.links), dtype=bool),
        T_camera_object=estimate.T_camera_object,
        object_covariance=start_covariance(config),
        lasting=c.lasting * np.sqrt(start_covariance(config)),
        motion=np.zeros(6),
        motion_covariance=start_covariance(config),
        hand_motion=np.zeros(6),
        answer=estimate.T_camera_object,
        images=0,
        confidence=estimate.confidence,
    )


def start_covariance(config: TrackerConfig) -> Array:
    """Covariance of an object's pose that the estimator found, shape (6, 6)."""
    return np.diag([config.start.object_turn**2] * 3 + [config.start.object_shift**2] * 3)


def predicted(
    track: Track, given: Array, seconds: float, hidden: bool, hand: Hand, config: TrackerConfig
) -> Track:
    """The track at the next image, before looking at it.

    Hand and object are carried along by the motion that forward kinematics tells, whose constant
    error cancels in it. What else may have happened widens the covariances.

    Args:
        track: the track at the last image.
        given: the wrist pose that comes with the next one, shape (4, 4).
        seconds: time between the two [s].
        hidden: whether the last image did not show the object: it may have moved unseen.
        hand: the hand.
        config: parameters.
    """
    step = given @ se3.inverse(track.given)
    c, o = config.hand, config.object
    wrist = [c.wrist_turn] * 3 + [c.wrist_motion] * 3
    drift = np.concatenate([wrist, c.joint_motion * joint_scale(hand, config)]) ** 2 * seconds
    still = np.array([o.still_turn] * 3 + [o.still_motion] * 3) ** 2 * seconds
    lever = np.array([o.lever] * 3 + [1.0] * 3)
    anywhere = (o.unseen_agility / lever) ** 2 * np.mean((lever * track.motion) ** 2)
    unseen = np.array([o.hidden_turn] * 3 + [o.hidden_motion] * 3) ** 2 * seconds * hidden
    noise = np.diag(still + (o.agility * track.motion) ** 2 + anywhere + unseen)
    R, velocity = step[:3, :3], twist_between(track.given, given, np.zeros(3)) / seconds
    reach, stopping = hand.reach[1], config.rest.stopping
    slows = hand_speed(velocity, reach) < stopping * hand_speed(track.hand_motion, reach)
    keep = stopping if slows else o.memory
    return replace(
        track,
        given=given,
        T_camera_hand=step @ track.T_camera_hand,
        hand_covariance=carried(track.hand_covariance, R) + np.diag(drift),
        T_camera_object=step @ track.T_camera_object,
        object_covariance=carried(track.object_covariance, R) + noise,
        lasting=np.concatenate([R @ track.lasting[:3], R @ track.lasting[3:]]),
        motion=np.concatenate([R @ track.motion[:3], R @ track.motion[3:]]),
        motion_covariance=carried(track.motion_covariance, R),
        hand_motion=keep * track.hand_motion + (1 - keep) * velocity,
        answer=step @ track.answer,
        images=0 if hidden else track.images,
        searched=track.searched and not hidden,
        confidence=expected_confidence(track.confidence, config.loss),
    )


def hand_speed(motion: Array, reach: float) -> float:
    """Speed [m/s] that stands for a velocity of the wrist, [rad/s, m/s], shape (6,): a turn counts
    as what moves at the hand's reach [m] does."""
    return float(np.linalg.norm(np.append(reach * motion[:3], motion[3:])))


def joint_scale(hand: Hand, config: TrackerConfig) -> Array:
    """What counts as one radian of every independent joint [rad, m], shape (n,)."""
    scale = np.ones(len(hand.rest))
    scale[hand.chain.source[hand.chain.kind == PRISMATIC]] = config.estimator.hand_state.slide_scale
    return scale
