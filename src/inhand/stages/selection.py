"""Choice of the answer among the poses that are left (paper, section IV-C)."""

import math

import numpy as np

from inhand.config import SelectionConfig
from inhand.packed import PackedHand, PackedObject, device_poses
from inhand.stages.clustering import distinct_poses, surface_distances_to
from inhand.stages.evidence import Evidence, agreement, contact_penalty, score_with_contact
from inhand.stages.hidden_fingers import place_hidden_fingers
from inhand.stages.observation import Observation
from inhand.stages.precision import probes
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
    return Selection(candidates, _confidence(ranked, evidence, obj, config), joint_vector)


def _confidence(
    ranked: PoseSet, evidence: Evidence, obj: PackedObject, config: SelectionConfig
) -> float:
    """Probability that the first pose is right.

    It counts how well the pose fits, its lead over any rival, and how firmly the image holds it:
    how much worse poses to either side fit. A rival is a pose whose surface lies elsewhere; slight
    variants of the first pose are none.
    """
    if not len(ranked):
        return 0.0
    c = config
    apart = surface_distances_to(ranked.T_camera_object, ranked.T_camera_object[0], obj, 0.1)
    rivals = ranked.score[apart > c.rival_distance]
    lead = float(ranked.score[0] - rivals.max()) if len(rivals) else c.max_lead
    first = ranked.T_camera_object[:1].astype(np.float64)
    aside = probes(first[0], evidence, obj, c.precision)
    poses = device_poses(np.concatenate([first, aside]), obj.device)
    seen = agreement(evidence, obj, poses, c).astype(np.float64)
    contact = contact_penalty(evidence, obj, poses, c.contact_points)
    score = seen.sum(axis=1) - contact
    drop = np.clip(score[0] - score[1:], 0, c.precision.max_drop).mean()
    visible, explained = seen[0]
    logit = (
        c.confidence_bias
        + c.confidence_visible * min(visible, c.max_visible)
        + c.confidence_explained * explained
        + c.confidence_lead * math.sqrt(min(max(lead, 0.0), c.max_lead))
        + c.confidence_drop * drop
        - c.confidence_contact * contact[0]
    )
    return 1 / (1 + math.exp(-max(min(logit, 50.0), -50.0)))
