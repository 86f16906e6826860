"""Choice of the answer among the poses that are left (paper, section IV-C)."""

import math

import numpy as np

from inhand.config import SelectionConfig
from inhand.packed import PackedHand, PackedObject, device_poses
from inhand.stages.clustering import distinct_poses, surface_distances_to
from inhand.stages.evidence import Evidence, agreement, contact_penalty, score_with_contact
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
    earlier: Selection | None = None,
) -> Selection:
    """Rank the poses.

    The paper keeps the best third by rendering discrepancy, then takes the highest LCP. By default
    one score weighs hits, free-space violations, occlusion, missing readings and contact; hidden
    fingers are placed against the best few poses before the last word. The answer of an `earlier`
    search of the same image is a second opinion: where it is the same, this one is surer.
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
    confirmed = False
    if earlier and len(earlier.poses) and len(ranked):
        first, other = ranked.T_camera_object[:1], earlier.T_camera_object[0]
        confirmed = surface_distances_to(first, other, obj, 0.1)[0] <= config.rival_distance
    confidence = _confidence(ranked, confirmed, evidence, obj, config)
    return Selection(candidates, confidence, joint_vector)


def _confidence(
    ranked: PoseSet, confirmed: bool, evidence: Evidence, obj: PackedObject, config: SelectionConfig
) -> float:
    """Probability that the first pose is right: how well it fits, its lead over any rival, and
    whether it is `confirmed` by another search.

    A rival is a pose whose surface lies elsewhere; slight variants of the first pose are none.
    """
    if not len(ranked):
        return 0.0
    apart = surface_distances_to(ranked.T_camera_object, ranked.T_camera_object[0], obj, 0.1)
    rivals = ranked.score[apart > config.rival_distance]
    lead = float(ranked.score[0] - rivals.max()) if len(rivals) else config.max_lead
    first = device_poses(ranked.T_camera_object[:1], obj.device)
    visible, explained = agreement(evidence, obj, first, config)[0]
    logit = (
        config.confidence_bias
        + config.confidence_visible * min(float(visible), config.max_visible)
        + config.confidence_explained * float(explained)
        + config.confidence_lead * math.sqrt(min(max(lead, 0.0), config.max_lead))
        + config.confidence_confirmed * confirmed
        - config.confidence_contact
        * float(contact_penalty(evidence, obj, first, config.contact_points)[0])
    )
    return 1 / (1 + math.exp(-max(min(logit, 50.0), -50.0)))
