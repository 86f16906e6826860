"""Rejection of physically impossible poses (paper, section IV-C)."""

from inhand.config import PruningConfig
from inhand.packed import PackedHand, PackedObject
from inhand.stages.physics_pruning import prune_by_physics
from inhand.stages.results import HandState, PoseSet


def prune(
    poses: PoseSet,
    hand_state: HandState,
    hand: PackedHand,
    obj: PackedObject,
    config: PruningConfig,
) -> PoseSet:
    """Poses that neither lie deep in the hand nor fail to touch it."""
    if config.method == "physics":
        return prune_by_physics(poses, hand_state, hand, obj, config)
    return poses
