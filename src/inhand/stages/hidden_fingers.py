"""Fingers that the image does not show, placed against the object."""

import numpy as np
from numpy.typing import NDArray

from inhand.config import SelectionConfig
from inhand.geometry.se3 import Array
from inhand.kernels.contact import configuration_clearances
from inhand.kernels.launch import computed
from inhand.packed import PackedObject, PackedPart, device_poses
from inhand.stages.evidence import Evidence, gap_cost, penetration_cost
from inhand.stages.results import Configurations, PoseSet


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
    state = evidence.hand_state
    n, score = min(config.grasps, len(ranked)), ranked.score.copy()
    joints = state.joint_vector.copy()
    hidden = [
        (finger, allowed)
        for finger, allowed in zip(evidence.hand.fingers, state.allowed, strict=False)
        if n > 0 and not state.certain[finger.links].all()
    ]
    for finger, allowed in hidden:
        poses, points = ranked.T_camera_object[:n], config.finger_points
        _, cost, apart = _places(finger, allowed, poses, points, obj, evidence, config)
        score[:n] += apart[:, 0] - cost.min(axis=1)
    order = np.concatenate([np.argsort(-score[:n], kind="stable"), np.arange(n, len(ranked))])
    ranked = PoseSet(ranked.T_camera_object[order], score[order])
    for finger, allowed in hidden:
        poses, points = ranked.T_camera_object[:1], config.placed_finger_points
        places, cost, _ = _places(finger, allowed, poses, points, obj, evidence, config)
        # The image's own place for it may be uncertain, but is more than a guess.
        cost[:, 1:] += config.finger_elsewhere
        joints[finger.joints] = places[cost.argmin()]
    return ranked, joints


def _places(
    finger: PackedPart,
    allowed: Configurations,
    T_camera_object: NDArray[np.float32],
    points: int,
    obj: PackedObject,
    evidence: Evidence,
    config: SelectionConfig,
) -> tuple[Array, Array, Array]:
    """Joints (c, k) of a finger where the image alone has put it and of all that the image allows,
    what each of them costs with each object pose, (m, c), and the part of it for the gap.

    `points`: surface samples of a link that are held against the object.
    """
    c, state, device = evidence.config, evidence.hand_state, obj.device
    joints = np.concatenate([state.joint_vector[None, finger.joints], allowed.joints])
    samples = int(np.minimum(finger.counts, points).sum())
    links = finger.pose(joints, state.T_camera_hand[None])
    inputs = [device_poses(T_camera_object, device), obj.fields, links, len(finger.links)]
    farthest = c.free_finger_gap + c.finger_gap_scale
    inputs += [len(joints), finger.points, finger.link, samples, farthest]
    shape, work = (len(T_camera_object), len(joints)), 4 * samples
    clearance = computed(configuration_clearances, shape, float, inputs, device, work_per_item=work)
    apart = gap_cost(clearance, c) / len(evidence.hand.fingers)
    doubt = config.finger_visibility * (allowed.score[0] - allowed.score)
    return joints, np.append(0.0, doubt) + penetration_cost(-clearance, c) + apart, apart
