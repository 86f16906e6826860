"""Clouds of points, coloured by what a stage made of them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inhand.overlay import HAND_COLOUR, OBJECT_COLOUR, Colour, Pixels
from inhand.packed import PackedHand
from inhand.stages.observation import Observation
from inhand.stages.results import HandState, Segment
from inhand.stages.segmentation import FAR, distances_to_hand

EXPLAINED = 0.003
"""Points this near to the hand are drawn as the hand's [m], as the segmentation counts them."""
GREY: Colour = (150, 150, 155)
DIM: Colour = (70, 70, 78)


@dataclass(frozen=True, eq=False)
class Cloud:
    """Coloured points."""

    points: NDArray[np.float32]
    """Points [m], camera frame, shape (n, 3)."""
    colours: Pixels
    """Red, green, blue, 0 to 255, shape (n, 3)."""


def plain(observation: Observation) -> Cloud:
    """The scene cloud, lit from the camera so that its shape can be seen."""
    towards = -observation.points / np.linalg.norm(observation.points, axis=1, keepdims=True)
    facing = np.clip((observation.normals * towards).sum(axis=1, keepdims=True), 0, 1)
    return Cloud(observation.points, ((0.3 + 0.7 * facing) * 220 + np.zeros(3)).astype(np.uint8))


def by_hand(observation: Observation, state: HandState, hand: PackedHand) -> Cloud:
    """The scene cloud, the hand's points in its colour."""
    links = np.ones(len(hand.hand.links), dtype=bool)
    distance = distances_to_hand(observation.points, state, hand, links, FAR)
    colours = np.where(distance[:, None] < EXPLAINED, HAND_COLOUR, GREY)
    return Cloud(observation.points, colours.astype(np.uint8))


def by_weight(observation: Observation, segment: Segment) -> Cloud:
    """The scene cloud, dim, with the object segment in the object's colour by weight."""
    share = 0.3 + 0.7 * segment.weight[:, None] / max(float(segment.weight.max()), 1e-6)
    of_segment = share * np.array(OBJECT_COLOUR)
    dim = np.broadcast_to(DIM, observation.points.shape)
    return Cloud(
        np.concatenate([observation.points, segment.points]),
        np.concatenate([dim, of_segment]).astype(np.uint8),
    )


def score_colours(scores: NDArray[np.float64]) -> Pixels:
    """Colours of scores, shape (m, 3): the lowest violet, the highest yellow."""
    low, high = np.array([90, 40, 140]), np.array([255, 225, 60])
    span = np.ptp(scores) if len(scores) else 0.0
    t = (scores - scores.min()) / span if span > 0 else np.ones(len(scores))
    return np.asarray(low + t[:, None] * (high - low)).astype(np.uint8)
