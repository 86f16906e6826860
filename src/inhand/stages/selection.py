"""Choice of the answer among the poses that are left (paper, section IV-C)."""

import numpy as np

from inhand.config import SelectionConfig
from inhand.packed import PackedHand, PackedObject
from inhand.stages.clustering import distinct_poses
from inhand.stages.confidence import confidence
from inhand.stages.evidence import Evidence, score_with_contact
from inhand.stages.hidden_fingers import place_hidden_fingers
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
    one score weighs hits, free-space violations, occlusion, missing readings and contact; hidden
    fingers are placed against the best few poses before the last word.
    """
    if config.method == "render":
        ranked = select_by_rendering(poses, observation, hand_state, hand, obj, segment, config)
        joint_vector = hand_state.joint_vector
    else:
        scores = score_with_contact(evidence, obj, poses.T_camera_object, config, near=config.near)
        scored = PoseSet(poses.T_camera_object, scores)
        ranked = distinct_poses(scored, obj, config.merge_distance, len(poses))
        ranked, joint_vector = place_hidden_fingers(ranked, evidence, obj, config)
    candidates = ranked.take(np.arange(min(config.candidates, len(ranked))))
    sure = confidence(ranked, segment, evidence, obj, config)
    return Selection(candidates, sure, joint_vector)
