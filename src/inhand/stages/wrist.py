"""Correction of the wrist pose (paper, section IV-A)."""

import numpy as np

from inhand.config import WristConfig
from inhand.packed import PackedHand
from inhand.stages.articulated_fit import ArticulatedFit, WristPrior
from inhand.stages.observation import Observation
from inhand.stages.results import Wrist
from inhand.stages.wrist_icp import fit_wrist_icp


def fit_wrist(observation: Observation, hand: PackedHand, config: WristConfig) -> Wrist:
    """Fit the palm to the scene cloud.

    The default differs from the paper's ICP in that the given pose is a prior: on a flat palm the
    image leaves directions open in which ICP slides away.
    """
    if config.method == "icp":
        return fit_wrist_icp(observation, hand, config)
    used = np.zeros(len(hand.hand.links), dtype=bool)
    used[list(hand.hand.palm_links)] = True
    fit = ArticulatedFit(
        observation,
        hand,
        used,
        free=np.zeros(len(hand.hand.joint_names), dtype=bool),
        prior=wrist_prior(observation, config),
        point_information=config.point_information,
        joint_damping=1.0,
    )
    widths = np.geomspace(config.max_distance, config.last_width, config.iterations)
    _, T = fit.refine(hand.hand.rest[None], observation.T_camera_hand[None], widths)
    return Wrist(T[0])


def wrist_prior(observation: Observation, config: WristConfig) -> WristPrior:
    """The given wrist pose with its uncertainty."""
    return WristPrior(
        observation.T_camera_hand, config.prior_sd_rotation, config.prior_sd_translation
    )
