from dataclasses import replace

import numpy as np
import pytest
from held_object import distance_to_hand, held_object

from inhand.config import PruningConfig
from inhand.errors import NoAnswer
from inhand.geometry.se3 import exp, transform
from inhand.stages.physics_pruning import prune_by_physics
from inhand.stages.results import PoseSet

CONFIG = PruningConfig(method="physics", max_penetration=0.004, max_gap=0.006)


def poses_around(count: int) -> PoseSet:
    """Poses up to some centimetres from the true one, the first of them."""
    rng = np.random.default_rng(0)
    motions = rng.normal(0, 1, (count, 6)) * ([0.5] * 3 + [0.03] * 3)
    motions[0] = 0
    poses = held_object("cuboid").T_camera_object @ exp(motions)
    return PoseSet(poses.astype(np.float32), rng.uniform(size=count).astype(np.float32))


def test_poses_that_touch_the_hand_are_kept_as_by_brute_force() -> None:
    scene, poses = held_object("cuboid"), poses_around(200)
    points = scene.obj.model.surface.points
    clearance = np.array(
        [
            distance_to_hand(transform(T, points), scene.hand, scene.hand_state).min()
            for T in poses.T_camera_object.astype(np.float64)
        ]
    )
    possible = (clearance > -CONFIG.max_penetration) & (clearance < CONFIG.max_gap)
    assert possible[0]
    assert (clearance < -CONFIG.max_penetration).sum() > 20
    assert (clearance > CONFIG.max_gap).sum() > 20
    kept = prune_by_physics(poses, scene.hand_state, scene.hand, scene.obj, CONFIG)
    np.testing.assert_array_equal(kept.score, poses.score[possible])
    np.testing.assert_array_equal(kept.T_camera_object, poses.T_camera_object[possible])


@pytest.mark.parametrize("shift", [0.3, -0.09], ids=["far away", "inside the palm"])
def test_without_a_possible_pose_there_is_no_answer(shift: float) -> None:
    scene = held_object("cuboid")
    pose = scene.T_camera_object.copy()
    pose[:3, 3] += shift * scene.hand_state.T_camera_hand[:3, 2]
    impossible = replace(poses_around(1), T_camera_object=pose[None].astype(np.float32))
    with pytest.raises(NoAnswer, match="all 1 object poses"):
        prune_by_physics(impossible, scene.hand_state, scene.hand, scene.obj, CONFIG)
