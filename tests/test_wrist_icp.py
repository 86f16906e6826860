from dataclasses import replace

import numpy as np
import pytest
from held_object import HeldObject, held_object

from inhand.config import WristConfig
from inhand.geometry.se3 import exp, inverse, rotation_angle
from inhand.stages.wrist_icp import fit_wrist_icp


def fit(scene: HeldObject, T_camera_hand: np.ndarray) -> np.ndarray:
    """The corrected wrist pose, shape (4, 4), from a given one."""
    observation = replace(scene.observation, T_camera_hand=T_camera_hand)
    return fit_wrist_icp(observation, scene.hand, WristConfig(method="icp")).T_camera_hand


@pytest.mark.parametrize("seed", range(4))
def test_wrong_wrist_poses_are_corrected(seed: int) -> None:
    """From any start nearby to the same pose, up to the steps of a field of voxels; finger points
    next to the palm bias it a little."""
    scene = held_object("cuboid")
    true = scene.hand_state.T_camera_hand
    errors = np.random.default_rng(seed).normal(0, 1, (5, 6)) * ([0.03] * 3 + [0.005] * 3)
    found = np.stack([fit(scene, true @ exp(error)) for error in errors])
    off = inverse(true) @ found
    assert np.linalg.norm(errors[:, 3:], axis=1).mean() > 0.005
    assert np.linalg.norm(off[:, :3, 3], axis=1).max() < 0.002
    assert np.degrees(rotation_angle(np.eye(3), off[:, :3, :3])).max() < 1.0
    apart = inverse(found[0]) @ found
    assert np.linalg.norm(apart[:, :3, 3], axis=1).max() < 3e-4
    assert np.degrees(rotation_angle(np.eye(3), apart[:, :3, :3])).max() < 0.15


def test_a_pose_without_scene_points_near_it_stays() -> None:
    scene = held_object("cuboid")
    away = scene.hand_state.T_camera_hand.copy()
    away[0, 3] += 1.0
    np.testing.assert_allclose(fit(scene, away), away, atol=1e-6)
