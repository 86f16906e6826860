"""Wrist and fingers in the next image, from where they are expected."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from inhand.geometry import se3
from inhand.geometry.se3 import moved
from inhand.packed import PackedHand
from inhand.stages.articulated_fit import ArticulatedFit, PreparedFit, WristPrior
from inhand.stages.hand_visibility import hand_support
from inhand.stages.observation import Observation
from inhand.stages.results import HandState
from inhand.tracking.config import TrackerConfig
from inhand.tracking.gaussian import Array, twist_between
from inhand.tracking.track import Track

ORIGIN = np.zeros(3)
"""The wrist turns about its own origin."""


@dataclass(frozen=True, eq=False)
class FollowedHand:
    """The hand in an image."""

    state: HandState
    """Where it is."""
    covariance: Array
    """Of the wrist's twist and the joints, shape (6 + n, 6 + n)."""

    def kept_in(self, track: Track) -> Track:
        """The track with this hand, and the object carried along with it."""
        correction = self.state.T_camera_hand @ se3.inverse(track.T_camera_hand)
        return replace(
            track,
            T_camera_hand=self.state.T_camera_hand,
            T_camera_object=correction @ track.T_camera_object,
            answer=correction @ track.answer,
            joint_vector=self.state.joint_vector,
            hand_covariance=self.covariance,
            certain=self.state.certain,
        )


def follow_hand(
    observation: Observation, hand: PackedHand, track: Track, config: TrackerConfig
) -> FollowedHand:
    """Gauss-Newton over wrist and joints, held to the prediction as firmly as that is known.

    A hand that the image does not show stays where it is expected.

    Args:
        observation: the image.
        hand: the hand.
        track: the track as predicted.
        config: parameters.
    """
    c, wrist = config.hand, config.estimator.wrist
    fit = _fit_from(observation, hand, track, config)
    prior = np.linalg.inv(track.hand_covariance)
    anchor = np.zeros_like(prior)
    sd = np.array([wrist.prior_sd_rotation] * 3 + [wrist.prior_sd_translation] * 3)
    anchor[range(6), range(6)] = sd**-2.0 / c.anchor
    T, q = track.T_camera_hand, track.joint_vector
    information = c.stride * c.point_information
    for _ in range(c.iterations):
        H, g = fit.system(q, T)
        H = information * H + prior + anchor
        g = information * g + prior @ _way(T, q, track.T_camera_hand, track.joint_vector)
        g += anchor @ _way(T, q, track.given, q)
        step = np.asarray(np.linalg.solve(H, g), dtype=np.float64)
        T = moved(T, step[:6], ORIGIN)
        q = np.clip(q + step[6:], hand.hand.lower, hand.hand.upper)
    T_camera_link = hand.link_poses(q[None], T[None])[0]
    certain = _certain_links(observation, hand, T_camera_link, config)
    if certain is None:
        return _hidden(hand, track)
    covariance = np.asarray(np.linalg.inv(H), dtype=np.float64)
    return FollowedHand(HandState(q, T, T_camera_link, certain), covariance)


def _fit_from(
    observation: Observation, hand: PackedHand, track: Track, config: TrackerConfig
) -> PreparedFit:
    """The estimator's refinement of wrist and joints, begun at the prediction."""
    c, wrist = config.hand, config.estimator.wrist
    fit = ArticulatedFit(
        observation,
        hand,
        used=np.ones(len(hand.hand.links), dtype=bool),
        free=np.ones(len(hand.hand.joint_names), dtype=bool),
        prior=WristPrior(track.given, wrist.prior_sd_rotation, wrist.prior_sd_translation),
        point_information=c.point_information,
        joint_damping=1.0,
    )
    return fit.begin(track.joint_vector[None], track.T_camera_hand[None], c.width, c.stride)


def _hidden(hand: PackedHand, track: Track) -> FollowedHand:
    """The hand where it was expected, no link of which is relied on."""
    q, T = track.joint_vector, track.T_camera_hand
    none = np.zeros(len(hand.hand.links), dtype=bool)
    state = HandState(q, T, hand.link_poses(q[None], T[None])[0], none)
    return FollowedHand(state, track.hand_covariance)


def _way(T_from: Array, q_from: Array, T_to: Array, q_to: Array) -> Array:
    """Twist of the wrist and change of the joints from one hand to another, (6 + n,)."""
    return np.concatenate([twist_between(T_from, T_to, ORIGIN), q_to - q_from])


def _certain_links(
    observation: Observation, hand: PackedHand, T_camera_link: Array, config: TrackerConfig
) -> NDArray[np.bool_] | None:
    """Whether the image supports each link, (L,); the palm's always count.

    None if it does not support the hand as a whole.
    """
    c = config.estimator.hand_state
    support = hand_support(observation, hand, T_camera_link, c)
    if support.whole < c.min_hand_support:
        return None
    return np.asarray((support.links > c.certain_support) | hand.is_palm)
