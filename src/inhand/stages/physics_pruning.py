"""The paper's rejection of physically impossible object poses (section IV-C)."""

import numpy as np
import warp as wp

from inhand.config import PruningConfig
from inhand.errors import NoAnswer
from inhand.kernels.contact import hand_clearance
from inhand.kernels.launch import launch
from inhand.packed import PackedHand, PackedObject, device_poses
from inhand.stages.results import HandState, PoseSet


def prune_by_physics(
    poses: PoseSet,
    hand_state: HandState,
    hand: PackedHand,
    obj: PackedObject,
    config: PruningConfig,
) -> PoseSet:
    """The poses, in their order, whose object touches the hand and does not run deep into it.

    Raises:
        NoAnswer: none does.
    """
    device = obj.device
    # Beyond this distance it does not matter how far the object is.
    farthest = config.max_gap + 1e-3
    clearance = wp.empty(len(poses), dtype=float, device=device)
    inputs = [
        device_poses(poses.T_camera_object, device),
        obj.points,
        len(obj.points),
        hand.fields,
        hand.spheres,
        device_poses(hand_state.T_camera_link, device),
        wp.ones(len(hand.hand.links), dtype=int, device=device),
        farthest,
        clearance,
    ]
    launch(hand_clearance, len(poses), inputs, device, work_per_item=4 * len(obj.points))
    distance = clearance.numpy()
    possible = (distance > -config.max_penetration) & (distance < config.max_gap)
    if not possible.any():
        raise NoAnswer(
            f"all {len(poses)} object poses that fit the image collide with the estimated hand or "
            "do not touch it"
        )
    return poses.take(np.flatnonzero(possible))
