"""Choice of the answer among the poses that are left (paper, section IV-C)."""

import numpy as np

from inhand.config import SelectionConfig
from inhand.packed import PackedHand, PackedObject
from inhand.stages.clustering import distinct_poses
from inhand.stages.evidence import Evidence, score_with_contact
from inhand.stages.observation import Observation
from inhand.stages.render_selection import select_by_rendering
from inhand.stages.results import HandState, PoseSet, Segment, Selection


def select(
    poses: PoseSet,
    observation: Observation,
    hand_state: HandState,
    segment: Segment,
    evidence: Evidence,
    hand: PackedHand,
    obj: PackedObject,
    config: SelectionConfig,
) -> Selection:
    """Rank the poses.

    The paper keeps the best third by rendering discrepancy, then takes the highest LCP. By default
    one score weighs hits, free-space violations, occlusion and missing readings.
    """
    if config.method == "render":
        ranked = select_by_rendering(poses, observation, hand_state, hand, obj, segment, config)
        return Selection(ranked, _confidence(ranked, config))
    scores = score_with_contact(
        evidence,
        obj,
        poses.T_camera_object,
        model_points=config.model_points,
        segment_points=config.segment_points,
        tolerance=config.tolerance,
        contact_points=config.contact_points,
    )
    ranked = distinct_poses(
        PoseSet(poses.T_camera_object, scores), obj, config.merge_distance, config.candidates
    )
    return Selection(ranked, _confidence(ranked, config))


def _confidence(ranked: PoseSet, config: SelectionConfig) -> float:
    """Posterior of the first mode among the distinct modes, times how well it fits at all."""
    if not len(ranked):
        return 0.0
    odds = np.exp((ranked.score - ranked.score[0]) / config.temperature)
    fit = 1 / (1 + np.exp(-(ranked.score[0] - config.score_at_half) / config.score_slope))
    return float(odds[0] / odds.sum() * fit)
