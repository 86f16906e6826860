"""The hand's joint angles (paper, section IV-A)."""

import numpy as np

from inhand.config import HandStateConfig, WristConfig
from inhand.errors import NoAnswer
from inhand.packed import PackedHand
from inhand.stages.articulated_fit import whole_hand_fit
from inhand.stages.finger_search import Array, FingerSearch
from inhand.stages.hand_visibility import hand_support
from inhand.stages.observation import Observation
from inhand.stages.particle_swarm import search_fingers
from inhand.stages.results import HandState, Wrist
from inhand.stages.wrist import wrist_prior


def estimate_hand_state(
    observation: Observation,
    wrist: Wrist,
    hand: PackedHand,
    config: HandStateConfig,
    wrist_config: WristConfig,
    rng: np.random.Generator,
) -> HandState:
    """Joint angles and refined wrist.

    The paper runs a particle swarm on Alg. 1. By default every finger is searched over its whole
    range with a visibility-aware score; the best few configurations of each then start a joint
    Gauss-Newton over wrist and all fingers, on a part of the points. It goes on with all points
    from the best that every finger came to.

    Raises:
        NoAnswer: the hand is not where it should be.
    """
    if config.method == "swarm":
        return search_fingers(observation, wrist, hand, config, rng)
    search = FingerSearch(observation, hand, config)
    fit = whole_hand_fit(observation, hand, wrist_prior(observation, wrist_config), config)
    alternatives, allowed = search.alternatives(wrist.T_camera_hand, rng)
    starts = _starts(alternatives, hand)
    wrists = np.repeat(wrist.T_camera_hand[None], len(starts), 0)
    widths = np.geomspace(config.first_width, config.middle_width, config.iterations)
    q, T = search.best_combination(*fit.refine(starts, wrists, widths, config.start_stride))
    widths = np.geomspace(config.middle_width, config.last_width, config.last_iterations)
    q, T = fit.refine(q[None], T[None], widths)
    T_camera_link = hand.link_poses(q, T)[0]
    support = hand_support(observation, hand, T_camera_link, config)
    if support.whole < config.min_hand_support:
        raise NoAnswer(
            "the image does not show the hand where the wrist pose puts it: it looks through the "
            "hand, or sees something else there; check the wrist pose and the hand model"
        )
    certain = (support.links > config.certain_support) | hand.is_palm
    return HandState(q[0], T[0], T_camera_link, certain, allowed)


def _starts(alternatives: list[Array], hand: PackedHand) -> Array:
    """Joint vectors (s, n): the best of every finger, every finger's second, and so on."""
    starts = np.repeat(hand.hand.rest[None], max(len(found) for found in alternatives), 0)
    for finger, found in zip(hand.hand.fingers, alternatives, strict=True):
        starts[:, finger.joints] = found[0]
        starts[: len(found), finger.joints] = found
    return starts
