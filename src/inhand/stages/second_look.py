"""Whether the object segment is a finger that was missed, and the hands that it would make."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.config import EstimatorConfig, SecondLookConfig
from inhand.packed import PackedHand, PackedPart
from inhand.stages.articulated_fit import whole_hand_fit
from inhand.stages.finger_search import Array, configurations
from inhand.stages.observation import Observation
from inhand.stages.results import HandState, Segment, Selection
from inhand.stages.wrist import wrist_prior


def hands_in_segment(
    observation: Observation,
    hand_state: HandState,
    segment: Segment,
    hand: PackedHand,
    config: EstimatorConfig,
) -> list[HandState]:
    """Hand states in which one finger explains most of what was taken for the object.

    A finger of which little shows may have been missed, and is then part of the segment: where most
    of it has no readings, it scores less than out of sight. The configuration that explains most of
    the segment is refined.
    """
    look, prior = config.second_look, wrist_prior(observation, config.wrist)
    fit = whole_hand_fit(observation, hand, prior, config.hand_state)
    widths = np.geomspace(
        config.hand_state.first_width, config.hand_state.last_width, look.iterations
    )
    found = []
    for finger, q, explained in fingers_in_segment(hand_state, segment, hand, look):
        if explained < look.promising:
            continue
        q, T = fit.refine(q[None], hand_state.T_camera_hand[None], widths)
        poses = hand.pose(q, T)
        if _explained(poses, finger.links, segment, hand, look)[0] < look.explained:
            continue
        certain = hand_state.certain.copy()
        for link in finger.links:
            if _explained(poses, link, segment, hand, look)[0] > look.link_explained:
                certain[link] = True
        found.append(HandState(q[0], T[0], hand.link_poses(q, T)[0], certain, hand_state.allowed))
    return found


def doubted(
    selection: Selection,
    hand_state: HandState,
    segment: Segment,
    hand: PackedHand,
    config: SecondLookConfig,
) -> Selection:
    """The answer, less sure where most of the segment could be a finger that was missed.

    Args:
        selection: the answer.
        hand_state: the hand it was found with.
        segment: the object segment it was found in.
        hand: the hand.
        config: parameters.
    """
    fingers = fingers_in_segment(hand_state, segment, hand, config)
    explained = max((share for _, _, share in fingers), default=0.0)
    odds = math.exp(-config.doubt * max(explained - config.undoubted, 0.0))
    sure = selection.confidence
    return replace(selection, confidence=sure * odds / (1 - sure + sure * odds))


def fingers_in_segment(
    hand_state: HandState, segment: Segment, hand: PackedHand, config: SecondLookConfig
) -> list[tuple[PackedPart, Array, float]]:
    """Every finger without support, with the joint vector (n,) that puts it where it explains most
    of the segment, and the share of the segment's weight that it explains there."""
    found = []
    for finger in hand.fingers:
        if hand_state.certain[finger.links].all():
            continue
        joints = configurations(finger, hand.hand, config.samples)
        q = np.repeat(hand_state.joint_vector[None], len(joints), 0)
        q[:, finger.joints] = joints
        poses = hand.pose(q, hand_state.T_camera_hand[None])
        explained = _explained(poses, finger.links, segment, hand, config)
        best = explained.argmax()
        found.append((finger, q[best], float(explained[best])))
    return found


def _explained(
    T_camera_link: Any,
    links: NDArray[np.intp] | int,
    segment: Segment,
    hand: PackedHand,
    config: SecondLookConfig,
) -> NDArray[np.float32]:
    """Shares (c,) of the segment's weight at the surface of some links.

    `T_camera_link`: poses on the device, flat (c * L).
    """
    stride = max(1, len(segment.points) // config.points)
    points, weights = segment.points[::stride], segment.weight[::stride]
    used = np.isin(np.arange(len(hand.hand.links)), links)
    distance = hand.distances(points, T_camera_link, used, config.near)
    near = np.maximum(0, 1 - np.abs(distance) / config.near)
    return np.asarray(near @ weights / weights.sum())
