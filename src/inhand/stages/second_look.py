"""Fingers that were missed, as the object segment or what an answer leaves of it shows."""

import math
from dataclasses import replace
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from inhand.config import EstimatorConfig, SecondLookConfig
from inhand.packed import PackedHand, PackedObject, PackedPart, device_poses
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
    look, every_link = config.second_look, np.ones(len(hand.hand.links), dtype=bool)
    moved = (
        _moved(observation, hand_state, finger, q, segment, hand, config, every_link)
        for finger, q, share in fingers_in_segment(hand_state, segment, hand, look)
        if share >= look.promising
    )
    return [state for state, share in moved if share >= look.explained]


def with_missed_fingers(
    observation: Observation,
    hand_state: HandState,
    selection: Selection,
    segment: Segment,
    hand: PackedHand,
    obj: PackedObject,
    config: EstimatorConfig,
) -> HandState | None:
    """The hand with fingers where they explain what an answer leaves of the segment, None if no
    finger does.

    Of a finger that hardly shows, a few readings are left when the object is known, and tell where
    it is: one finger after the other takes what it can.

    Args:
        observation: the image.
        hand_state: the hand that the answer was found with.
        selection: the answer.
        segment: the object segment it was found in.
        hand, obj: the hand and the object.
        config: parameters.
    """
    if not len(selection.poses) or hand_state.certain.all():
        return None
    look, q, T = config.second_look, selection.joint_vector, hand_state.T_camera_hand
    on_object = obj.distances(segment.points, selection.T_camera_object[0], look.near)
    left, found = segment.where(np.abs(on_object) >= look.near), None
    state = replace(hand_state, joint_vector=q, T_camera_link=hand.link_poses(q[None], T[None])[0])
    tried: list[PackedPart] = []
    while (left := _left_by_hand(state, left, hand, look)).weight.sum() >= look.least_left:
        places = fingers_in_segment(state, left, hand, look)
        places = [place for place in places if place[0] not in tried]
        if not places:
            break
        finger, q, share = max(places, key=itemgetter(2))
        least = max(look.left_explained, look.least_left / float(left.weight.sum()))
        if share < least:
            break
        tried.append(finger)
        used = state.certain.copy()
        used[finger.links] = True
        moved, share = _moved(observation, state, finger, q, left, hand, config, used)
        if share >= least:
            found = state = moved
    return found


def _moved(
    observation: Observation,
    hand_state: HandState,
    finger: PackedPart,
    q: Array,
    segment: Segment,
    hand: PackedHand,
    config: EstimatorConfig,
    used: NDArray[np.bool_],
) -> tuple[HandState, float]:
    """The hand refined from joint vector `q` (n,), by those links that are `used` (L,), and the
    share of a segment that a finger explains then; its links that explain some are relied on."""
    c, look, prior = config.hand_state, config.second_look, wrist_prior(observation, config.wrist)
    fit = whole_hand_fit(observation, hand, prior, c, used)
    widths = np.geomspace(c.first_width, c.last_width, look.iterations)
    q, T = fit.refine(q[None], hand_state.T_camera_hand[None], widths)
    points, weights = _thinned(segment, look)
    poses, links = hand.pose(q, T), np.arange(len(hand.hand.links))
    distance = np.concatenate(
        [hand.distances(points, poses, links == link, look.near) for link in finger.links]
    )
    certain = hand_state.certain.copy()
    certain[finger.links] |= _explained(distance, weights, look) > look.link_explained
    state = HandState(q[0], T[0], hand.link_poses(q, T)[0], certain, hand_state.allowed)
    return state, float(_explained(distance.min(axis=0), weights, look))


def _left_by_hand(
    hand_state: HandState, segment: Segment, hand: PackedHand, config: SecondLookConfig
) -> Segment:
    """What a hand leaves of a segment."""
    poses = device_poses(hand_state.T_camera_link, hand.device)
    every_link = np.ones(len(hand.hand.links), dtype=bool)
    distance = hand.distances(segment.points, poses, every_link, config.near)[0]
    return segment.where(np.abs(distance) >= config.near)


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
    points, weights = _thinned(segment, config)
    for i, finger in enumerate(hand.fingers):
        if hand_state.certain[finger.links].all():
            continue
        joints = configurations(finger, hand.hand, config.samples)
        poses = finger.pose(joints, hand_state.T_camera_hand[None])
        links = np.ones(len(finger.links), dtype=bool)
        distance = hand.distances(points, poses, links, config.near, finger=i)
        explained = _explained(distance, weights, config)
        best = explained.argmax()
        q = hand_state.joint_vector.copy()
        q[finger.joints] = joints[best]
        found.append((finger, q, float(explained[best])))
    return found


def _thinned(
    segment: Segment, config: SecondLookConfig
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """About `config.points` of the segment's points [m], camera frame, (n, 3); weights, (n,)."""
    stride = max(1, len(segment.points) // config.points)
    return segment.points[::stride], segment.weight[::stride]


def _explained(
    distance: NDArray[np.float32], weights: NDArray[np.float32], config: SecondLookConfig
) -> NDArray[np.float32]:
    """Shares (...) of the points' weight at a surface, by their distances (..., n) to it [m]."""
    near = np.maximum(0, 1 - np.abs(distance) / config.near)
    return np.asarray(near @ weights / weights.sum())
