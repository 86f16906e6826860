"""From the estimator's stage results to what is drawn and said of them."""

import numpy as np
import pytest
from reference_depth import open3d_depth
from scipy.spatial import KDTree
from viewed_scenes import analyst, demo, demo_analysis, hidden_analysis, viewed

from inhand.evaluation.metrics import sample_model
from inhand.geometry.se3 import exp, transform
from inhand.overlay import HAND_COLOUR, OBJECT_COLOUR
from inhand.viewer.analysis import Analysis
from inhand.viewer.clouds import DIM, score_colours
from inhand.viewer.silhouettes import Residuals
from inhand.viewer.stages import (
    CHOICE,
    HAND,
    POSE_STAGES,
    REGION,
    SEGMENT,
    STAGES,
    WRIST,
    StageView,
)


@pytest.fixture(scope="module")
def analysis() -> Analysis:
    return demo_analysis()


def stage(analysis: Analysis, name: str) -> StageView:
    return next(view for view in analysis.stages if view.name == name)


def test_every_stage_has_a_view(analysis: Analysis) -> None:
    assert tuple(view.name for view in analysis.stages) == STAGES
    assert all(view.reached for view in analysis.stages)


def test_the_region_shows_the_scene_cloud(analysis: Analysis) -> None:
    assert analysis.results is not None
    assert analysis.results.observation is not None
    cloud = stage(analysis, REGION).cloud
    assert cloud is not None
    np.testing.assert_array_equal(cloud.points, analysis.results.observation.points)
    assert f"{len(cloud.points)} points" in stage(analysis, REGION).text


def test_the_wrist_places_the_palm_alone(analysis: Analysis) -> None:
    view, hand = stage(analysis, WRIST), demo().hand
    assert set(np.flatnonzero(view.links)) == set(hand.palm_links)
    assert view.placement(0).T_camera_object is None


def test_points_are_blue_that_the_true_hand_is_near_to(analysis: Analysis) -> None:
    """Against the exact distance to the hand's mesh where it truly is."""
    cloud = stage(analysis, HAND).cloud
    assert cloud is not None
    scene = demo()
    links = scene.T_camera_hand @ scene.hand.forward_kinematics(
        scene.hand.joint_vector(scene.joint_positions)
    )
    surface = np.concatenate(
        [
            transform(T, sample_model(link.mesh, 20_000))
            for T, link in zip(links, scene.hand.links, strict=True)
        ]
    )
    distance = KDTree(surface).query(cloud.points)[0]
    blue = (cloud.colours == HAND_COLOUR).all(axis=1)
    assert blue[distance < 0.002].mean() > 0.95
    assert blue[distance > 0.006].mean() < 0.02


def test_the_segment_is_drawn_by_weight_over_what_was_removed(analysis: Analysis) -> None:
    assert analysis.results is not None
    assert analysis.results.segment is not None
    segment, cloud = analysis.results.segment, stage(analysis, SEGMENT).cloud
    assert cloud is not None
    removed, kept = np.split(cloud.colours, [-len(segment.points)])
    assert (removed == DIM).all()
    np.testing.assert_array_equal(cloud.points[-len(kept) :], segment.points)
    surest = np.argmax(segment.weight)
    np.testing.assert_array_equal(kept[surest], OBJECT_COLOUR)
    order = np.argsort(segment.weight)
    assert (np.diff(kept[order, 0].astype(int)) >= 0).all()


@pytest.mark.parametrize("name", [*POSE_STAGES, CHOICE])
def test_poses_come_best_first(analysis: Analysis, name: str) -> None:
    view = stage(analysis, name)
    assert len(view.poses) == len(view.scores) > 1
    assert (np.diff(view.scores) <= 0).all()
    first, beyond = view.placement(0).T_camera_object, view.placement(10**6).T_camera_object
    np.testing.assert_array_equal(first, view.poses[0])
    np.testing.assert_array_equal(beyond, view.poses[-1])


def test_the_choice_is_the_answer(analysis: Analysis) -> None:
    placement, estimate = stage(analysis, CHOICE).placement(0), analysis.estimate
    np.testing.assert_array_equal(placement.T_camera_object, estimate.T_camera_object)
    np.testing.assert_array_equal(placement.T_camera_hand, estimate.T_camera_hand)
    assert placement.joint_vector is not None
    assert demo().hand.joint_dict(placement.joint_vector) == pytest.approx(estimate.joint_positions)


def test_errors_are_of_the_stage_that_names_them(analysis: Analysis) -> None:
    joints = demo().joint_positions
    assert analysis.results is not None
    assert analysis.results.hand_state is not None
    found = demo().hand.joint_dict(analysis.results.hand_state.joint_vector)
    name = next(iter(joints))
    error = np.degrees(abs(found[name] - joints[name]))
    assert (
        f"{name}: {np.degrees(found[name]):.1f}° (off by {error:.1f}°)"
        in stage(analysis, HAND).text
    )


def test_stages_that_were_not_reached_say_why() -> None:
    hidden = hidden_analysis()
    assert not hidden.estimate.found
    reached = [view.reached for view in hidden.stages]
    assert reached == [name in (REGION, WRIST, HAND) for name in STAGES]
    assert hidden.estimate.reason in stage(hidden, CHOICE).text
    placement = stage(hidden, CHOICE).placement(0)
    assert placement.T_camera_object is None
    np.testing.assert_array_equal(placement.T_camera_hand, hidden.estimate.T_camera_hand)


def test_an_estimate_alone_has_the_choice_alone(analysis: Analysis) -> None:
    frame = viewed(demo(), "demo")
    alone = analyst().of_estimate(frame, demo().obj, analysis.estimate)
    assert [view.name for view in alone.stages] == [CHOICE]
    assert alone.score(alone.stages[0].placement(0)) is None
    assert alone.verdict is not None
    assert alone.verdict.adi == analysis.adi(analysis.estimate.T_camera_object)


def test_residuals_as_in_open3d(analysis: Analysis) -> None:
    scene = demo()
    placement = stage(analysis, CHOICE).placement(0)
    assert placement.T_camera_hand is not None
    assert placement.T_camera_object is not None
    assert placement.joint_vector is not None
    links = placement.T_camera_hand @ scene.hand.forward_kinematics(placement.joint_vector)
    meshes = [*(link.mesh for link in scene.hand.links), scene.obj.mesh]
    depth, index = open3d_depth(meshes, np.stack([*links, placement.T_camera_object]), scene.camera)
    known = np.isfinite(depth) & (scene.depth > 0)
    residuals = analysis.pictures.residuals(placement)[1]
    for values, mask in (
        (residuals.hand, index < len(links)),
        (residuals.object, index == len(links)),
    ):
        expected = (scene.depth - depth)[known & mask]
        assert len(values) == pytest.approx(len(expected), rel=0.003)
        assert np.median(np.abs(values)) == pytest.approx(np.median(np.abs(expected)), rel=0.01)


def test_the_residual_grows_with_a_wrong_pose(analysis: Analysis) -> None:
    right = stage(analysis, CHOICE).placement(0)
    assert right.T_camera_object is not None
    shift = exp(np.array([0, 0, 0, 0, 0, -0.006]))
    wrong = type(right)(right.T_camera_hand, right.joint_vector, shift @ right.T_camera_object)
    of_right, of_wrong = (analysis.pictures.residuals(p)[1].object for p in (right, wrong))
    assert np.median(of_wrong) - np.median(of_right) == pytest.approx(0.006, abs=0.001)
    right_score, wrong_score = analysis.score(right), analysis.score(wrong)
    assert right_score is not None
    assert wrong_score is not None
    assert right_score > wrong_score + 0.3


def test_what_is_said_of_residuals() -> None:
    residuals = Residuals(np.array([0.001, -0.002, 0.010], np.float32), np.zeros(0, np.float32), 0)
    text = residuals.summary()
    assert "**hand**: 2.0 mm in the median, 67% of 3 px within 3 mm" in text
    assert "**object**: not seen" in text
    missing = Residuals(np.zeros(0, np.float32), np.zeros(3, np.float32), 1)
    assert "25% without a reading" in missing.summary()


def test_colours_of_scores_span_the_scale() -> None:
    colours = score_colours(np.array([1.0, 2.0, 3.0]))
    assert len(np.unique(colours, axis=0)) == 3
    np.testing.assert_array_equal(score_colours(np.array([5.0, 5.0]))[0], colours[2])
    assert score_colours(np.zeros(0)).shape == (0, 3)
