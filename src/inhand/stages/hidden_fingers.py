"""Fingers that the image does not show, placed against the object."""

import numpy as np
from numpy.typing import NDArray

from inhand.config import SelectionConfig
from inhand.geometry.se3 import Array
from inhand.kernels.contact import configuration_clearances
from inhand.kernels.launch import computed
from inhand.packed import PackedObject, PackedPart, device_poses
from inhand.stages.evidence import Evidence, gap_cost, penetration_cost
from inhand.stages.results import PoseSet


def place_hidden_fingers(
    ranked: PoseSet, evidence: Evidence, obj: PackedObject, config: SelectionConfig
) -> tuple[PoseSet, Array]:
    """The poses ranked anew, and the joint vector (n,) that goes with the first.

    A hidden finger may be anywhere that the image allows. Against each of the first poses it is
    placed where it touches the object, does not run into it, and contradicts the image least; what
    that costs takes the place of the gap to where the image alone has put it.

    Args:
        ranked: object poses, best first.
        evidence: what they were scored against.
        obj: the object.
        config: parameters.
    """
    state, hand = evidence.hand_state, evidence.hand
    n = min(config.grasps, len(ranked))
    score, joints = ranked.score.copy(), np.repeat(state.joint_vector[None], n, 0)
    if n == 0:
        return ranked, state.joint_vector
    for finger, allowed in zip(hand.fingers, state.allowed, strict=False):
        if state.certain[finger.links].all():
            continue
        tried = np.concatenate([state.joint_vector[None, finger.joints], allowed.joints])
        doubt = config.finger_visibility * (allowed.score[0] - allowed.score)
        doubt = np.concatenate([[0.0], doubt])
        clearance = _clearances(ranked.T_camera_object[:n], obj, finger, tried, evidence, config)
        apart = gap_cost(clearance, evidence.config) / len(hand.fingers)
        cost = doubt + penetration_cost(-clearance, evidence.config) + apart
        score[:n] += apart[:, 0] - cost.min(axis=1)
        # The image's own place for it may be uncertain, but is more than a guess.
        cost[:, 1:] += config.finger_elsewhere
        joints[:, finger.joints] = tried[cost.argmin(axis=1)]
    order = np.concatenate([np.argsort(-score[:n], kind="stable"), np.arange(n, len(ranked))])
    return PoseSet(ranked.T_camera_object[order], score[order]), joints[order[0]]


def _clearances(
    T_camera_object: NDArray[np.float32],
    obj: PackedObject,
    finger: PackedPart,
    joints: Array,
    evidence: Evidence,
    config: SelectionConfig,
) -> NDArray[np.float32]:
    """Smallest signed distances [m], (m, c), of a finger at joints (c, k) to posed objects."""
    device, c = obj.device, evidence.config
    samples = int(np.minimum(finger.counts, config.finger_points).sum())
    links = finger.pose(joints, evidence.hand_state.T_camera_hand[None])
    inputs = [device_poses(T_camera_object, device), obj.fields, links, len(finger.links)]
    inputs += [len(joints), finger.points, finger.link, samples]
    inputs += [c.free_finger_gap + c.finger_gap_scale]
    shape, work = (len(T_camera_object), len(joints)), 4 * samples
    return computed(configuration_clearances, shape, float, inputs, device, work_per_item=work)
