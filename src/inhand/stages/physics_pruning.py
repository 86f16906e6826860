"""The paper's rejection of physically impossible object poses (section IV-C)."""

import numpy as np

from inhand.config import PruningConfig
from inhand.errors import NoAnswer
from inhand.packed import PackedHand, PackedObject, device_poses
from inhand.stages.evidence import clearances
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
    # Beyond this distance it does not matter how far the object is.
    farthest = config.max_gap + 1e-3
    on_device = device_poses(poses.T_camera_object, obj.device)
    clearance = clearances(on_device, obj, len(obj.points), hand, hand_state, farthest)
    distance = clearance.min(axis=1)
    possible = (distance > -config.max_penetration) & (distance < config.max_gap)
    if not possible.any():
        raise NoAnswer(
            f"all {len(poses)} object poses that fit the image collide with the estimated hand or "
            "do not touch it"
        )
    return poses.take(np.flatnonzero(possible))
