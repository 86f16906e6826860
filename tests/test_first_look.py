"""A quick search whose answer is taken if it is sure."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from inhand import EstimatorConfig, PoseEstimator
from inhand.config import FirstLookConfig
from inhand.stages.results import Selection
from inhand.stages.selection import select
from inhand.synth.scene import Scene

CONFIG = EstimatorConfig()
WITHOUT = FirstLookConfig(enough=1.0)


def estimator(scene: Scene, config: EstimatorConfig) -> PoseEstimator:
    return PoseEstimator(scene.hand, scene.obj, config, "cpu")


def test_a_sure_answer_of_the_quick_search_is_the_answer(scenes: list[Scene]) -> None:
    scene = scenes[0]
    given = scene.depth, scene.camera, scene.T_camera_hand_given
    found, stages = estimator(scene, CONFIG).run(*given)
    assert found.confidence >= CONFIG.first_look.enough
    assert stages.hypotheses is not None
    assert len(stages.hypotheses) <= CONFIG.first_look.hypotheses < CONFIG.hypotheses.keep
    alone = estimator(scene, replace(CONFIG.quick, first_look=WITHOUT)).estimate(*given)
    np.testing.assert_array_equal(found.T_camera_object, alone.T_camera_object)


def test_after_an_unsure_answer_the_whole_search_follows(scenes: list[Scene]) -> None:
    scene = scenes[0]
    given = scene.depth, scene.camera, scene.T_camera_hand_given
    never_sure = replace(CONFIG, first_look=replace(CONFIG.first_look, enough=0.99999))
    found, stages = estimator(scene, never_sure).run(*given)
    assert found.found
    assert stages.hypotheses is not None
    assert len(stages.hypotheses) > CONFIG.first_look.hypotheses


def test_a_quick_search_without_a_pose_is_not_the_end(scenes: list[Scene]) -> None:
    scene = scenes[0]
    given = scene.depth, scene.camera, scene.T_camera_hand_given
    one_pair = replace(CONFIG.first_look, pairs=1)
    for seed in range(20):
        config = replace(CONFIG, seed=seed, first_look=one_pair)
        quick = estimator(scene, replace(config.quick, first_look=WITHOUT)).estimate(*given)
        if not quick.found:
            assert estimator(scene, config).estimate(*given).found
            return
    raise AssertionError("one pair always found a pose")


def test_the_paper_has_no_first_look() -> None:
    assert EstimatorConfig.paper().first_look.enough == 1


def test_the_whole_search_is_surer_where_the_quick_one_found_the_same_pose(
    scenes: list[Scene], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second time, the whole search is told that the quick one's answer is 5 cm away."""
    scene = scenes[0]
    never_sure = replace(CONFIG, first_look=replace(CONFIG.first_look, enough=0.99999))
    own = estimator(scene, never_sure)
    given = scene.depth, scene.camera, scene.T_camera_hand_given
    answers: list[Selection] = []

    def told(*args: Any) -> Selection:
        *_, earlier = args
        if earlier is not None:
            assert earlier is answers[-1]
            poses = earlier.T_camera_object.copy()
            poses[:, 0, 3] += 0.05
            earlier = replace(earlier, poses=replace(earlier.poses, T_camera_object=poses))
        answers.append(select(*(*args[:-1], earlier)))
        return answers[-1]

    confirmed = own.estimate(*given)
    monkeypatch.setattr("inhand.estimator.select", told)
    alone = own.estimate(*given)
    assert len(answers) == 2
    np.testing.assert_array_equal(alone.T_camera_object, confirmed.T_camera_object)
    assert alone.confidence < confirmed.confidence
