from dataclasses import replace

import numpy as np
import pytest
from hand_view import off_by, seen, wrist
from held_object import built_in_hand, held_object

from inhand.config import WristConfig
from inhand.geometry.se3 import exp
from inhand.stages.wrist import fit_wrist, wrist_prior
from inhand.stages.wrist_icp import fit_wrist_icp


def errors(count: int) -> np.ndarray:
    """Errors of given wrist poses, (count, 4, 4)."""
    sd = [0.015] * 3 + [0.003] * 3
    return exp(np.random.default_rng(0).normal(0, 1, (count, 6)) * sd)


def test_wrong_poses_are_corrected_whatever_the_fingers_do() -> None:
    hand, true = built_in_hand(), wrist(distance=0.6, height=0.1)
    for q in np.array([[0.2, 0.3, 0.4, 0.1], [1.2, 0.5, 1.0, 0.7], [2.2, 0.5, 0.3, 1.5]]):
        observation = seen(hand, q, true)
        for error in errors(3):
            given = replace(observation, T_camera_hand=true @ error)
            found = fit_wrist(given, hand, WristConfig()).T_camera_hand
            distance, angle = off_by(found, true)
            before = off_by(true @ error, true)
            assert distance < 0.002 or distance < 0.6 * before[0]
            assert angle < 0.7 or angle < 0.6 * before[1]


def test_a_right_pose_stays_right_around_an_object() -> None:
    scene = held_object("industrial_part")
    found = fit_wrist(scene.observation, scene.hand, WristConfig()).T_camera_hand
    distance, angle = off_by(found, scene.hand_state.T_camera_hand)
    assert distance < 0.001
    assert angle < 0.3


def test_the_method_of_the_paper_can_be_chosen() -> None:
    scene, config = held_object("cuboid"), WristConfig(method="icp")
    given = replace(scene.observation, T_camera_hand=scene.observation.T_camera_hand @ errors(1)[0])
    np.testing.assert_array_equal(
        fit_wrist(given, scene.hand, config).T_camera_hand,
        fit_wrist_icp(given, scene.hand, config).T_camera_hand,
    )


def test_the_prior_is_the_given_pose() -> None:
    scene = held_object("cuboid")
    prior = wrist_prior(scene.observation, WristConfig(prior_sd_translation=0.007))
    np.testing.assert_array_equal(prior.T_camera_hand, scene.observation.T_camera_hand)
    assert prior.sd_translation == pytest.approx(0.007)
    assert prior.sd_rotation == WristConfig().prior_sd_rotation
