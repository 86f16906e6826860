"""Correction of the wrist pose (paper, section IV-A)."""

import numpy as np

from inhand.config import HandStateConfig, WristConfig
from inhand.geometry.se3 import Array, moved
from inhand.packed import PackedHand
from inhand.stages.articulated_fit import ArticulatedFit, WristPrior
from inhand.stages.hand_visibility import HandVisibility
from inhand.stages.observation import Observation
from inhand.stages.results import Wrist
from inhand.stages.wrist_icp import fit_wrist_icp


def fit_wrist(
    observation: Observation,
    hand: PackedHand,
    config: WristConfig,
    hand_config: HandStateConfig,
    rng: np.random.Generator,
) -> Wrist:
    """Fit the palm to the scene cloud.

    The default differs from the paper's ICP in two ways. The given pose is a prior: on a flat palm
    the image leaves directions open in which ICP slides away. And the fit starts from several poses
    around the given one, those at which the camera should see what it sees: from a single start
    that is a centimetre off, the palm is often drawn to a finger or to the object.
    """
    if config.method == "icp":
        return fit_wrist_icp(observation, hand, config)
    if not hand.is_palm.any():  # nothing shows where the wrist is but the fingers
        return Wrist(observation.T_camera_hand)
    visibility = HandVisibility(observation, hand, hand_config)

    def score(T_camera_hand: Array, tolerance: float, points: int) -> Array:
        no_joints = np.zeros((len(T_camera_hand), 0))
        return visibility.score(hand.palm, no_joints, T_camera_hand, None, tolerance, points).strict

    tried = _around(observation.T_camera_hand, config, rng)
    scores = score(tried, hand_config.coarse_tolerance, hand_config.coarse_points)
    best = np.argsort(-scores[1:], kind="stable")[: config.starts - 1] + 1
    starts = tried[[0, *best]]
    fit = ArticulatedFit(
        observation,
        hand,
        used=hand.is_palm,
        free=np.zeros(len(hand.hand.joint_names), dtype=bool),
        prior=wrist_prior(observation, config),
        point_information=config.point_information,
        joint_damping=1.0,
    )
    widths = np.geomspace(config.max_distance, config.last_width, config.iterations)
    rest = np.repeat(hand.hand.rest[None], len(starts), 0)
    _, refined = fit.refine(rest, starts, widths, hand_config.start_stride)
    scores = score(refined, hand_config.fine_tolerance, hand_config.fine_points)
    return Wrist(refined[scores.argmax()])


def _around(T_camera_hand: Array, config: WristConfig, rng: np.random.Generator) -> Array:
    """The given pose and random ones around it, shape (n, 4, 4)."""
    sd = np.repeat([config.search_sd_rotation, config.search_sd_translation], 3)
    offset = rng.normal(0, 1, (config.samples, 6)) * sd
    offset[0] = 0.0
    return moved(T_camera_hand, offset, np.zeros(3))


def wrist_prior(observation: Observation, config: WristConfig) -> WristPrior:
    """The given wrist pose with its uncertainty."""
    return WristPrior(
        observation.T_camera_hand, config.prior_sd_rotation, config.prior_sd_translation
    )
