"""Removal of the hand from the scene cloud; what remains is the object segment P_O."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from inhand.config import SegmentationConfig
from inhand.errors import NoAnswer
from inhand.packed import PackedHand, device_poses
from inhand.stages.background import Background
from inhand.stages.observation import Cloud, Observation
from inhand.stages.results import HandState, Segment

FAR = 0.03
"""Distances to the hand are cut off here [m]: farther away, nothing depends on them."""


def segment_object(
    observation: Observation,
    hand_state: HandState,
    hand: PackedHand,
    object_diameter: float,
    config: SegmentationConfig,
) -> Segment:
    """Keep the scene points that the hand does not explain.

    The paper drops every point nearer than 3 mm to the hand (SDF(p, x_H) < epsilon); `none` keeps
    the whole scene cloud. By default points near the hand keep a weight that grows with their
    distance, so that the contact zone still counts, surfaces that are too large for the object are
    dropped, and a small segment takes every pixel. Points too far from all fingers to be on an
    object they hold are dropped.

    Raises:
        NoAnswer: too few points are left.
    """
    cloud, soft = Cloud(observation.points, observation.normals), config.method == "soft"
    links, near = np.ones(len(hand.hand.links), dtype=bool), config.certain_distance
    poses = device_poses(hand_state.T_camera_link, hand.device)
    distance = hand.distances(cloud.points, poses, links, near)[0]
    if soft:
        is_hand = distance < config.hand_distance
        background = Background(observation, is_hand, object_diameter, config)
        cloud = background.removed_from(cloud)
    segment = _segment(cloud, hand_state, hand, object_diameter, config)
    if soft and 0 < len(segment.points) < config.dense_below:
        share = len(segment.points) / config.dense_points
        step = max(1, round(observation.step * math.sqrt(share)))
        cloud = background.removed_from(observation.cloud(step, segment.points))
        segment = _segment(cloud, hand_state, hand, object_diameter, config)
    if segment.weight.sum() < config.min_points:
        raise NoAnswer(
            f"only {len(segment.points)} depth readings near the hand do not belong to it: the "
            "object is hidden, is not in the hand, or gives no depth readings"
        )
    off = np.abs(distance[np.abs(distance) < near])
    return replace(segment, hand_misfit=float(off.sum() / max(len(off), 1)))


def _segment(
    cloud: Cloud,
    hand_state: HandState,
    hand: PackedHand,
    object_diameter: float,
    config: SegmentationConfig,
) -> Segment:
    """The points of the cloud that the hand does not explain."""
    # An object that a finger touches ends within its diameter of that finger.
    reach = object_diameter + config.certain_distance
    certain, moving = hand_state.certain, ~hand.is_palm
    poses = device_poses(hand_state.T_camera_link, hand.device)
    to_certain = hand.distances(cloud.points, poses, certain, FAR)[0]
    if config.method != "none":
        rest = to_certain >= config.hand_distance
        cloud, to_certain = Cloud(cloud.points[rest], cloud.normals[rest]), to_certain[rest]
    to_finger = hand.distances(cloud.points, poses, moving, 1.01 * reach)[0]
    to_hand = np.minimum(to_certain, to_finger)
    if config.method == "none":
        weight = np.ones(len(cloud.points), dtype=np.float32)
        return Segment(cloud.points, cloud.normals, to_hand, weight)
    if config.method == "threshold":
        distance = to_hand
        weight = (distance >= config.hand_distance).astype(np.float32)
    else:
        distance, share = to_certain, config.uncertain_weight
        weight = _not_hand(distance, config) * (share + (1 - share) * _not_hand(to_hand, config))
    weight[to_finger > reach] = 0.0
    keep = weight > 0
    return Segment(cloud.points[keep], cloud.normals[keep], distance[keep], weight[keep])


def _not_hand(distance: NDArray[np.float32], config: SegmentationConfig) -> NDArray[np.float32]:
    """Probability that points at these distances to the hand are not the hand's."""
    span = config.certain_distance - config.hand_distance
    weight = np.clip((distance - config.hand_distance) / span, 0.1, 1)
    return np.where(distance > config.hand_distance, weight, 0.0).astype(np.float32)
