from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from held_object import HeldObject, distance_to_hand, held_object

from inhand.config import ClusteringConfig, EvidenceConfig
from inhand.geometry.se3 import exp, transform
from inhand.kernels.launch import on_host
from inhand.packed import device_poses
from inhand.stages.evidence import (
    Evidence,
    agreement,
    contact_penalty,
    gather_evidence,
    score_with_contact,
)
from inhand.stages.results import HandState

CONFIG = EvidenceConfig()
SAMPLES = ClusteringConfig(
    model_points=300, segment_points=300, contact_points=200, tolerance=0.004
)


def evidence_of(
    scene: HeldObject, state: HandState | None = None, config: EvidenceConfig = CONFIG
) -> Evidence:
    return gather_evidence(
        scene.observation, state or scene.hand_state, scene.segment, scene.hand, config
    )


def penalties(
    scene: HeldObject,
    T: np.ndarray,
    state: HandState | None = None,
    points: int = 1000,
    config: EvidenceConfig = CONFIG,
) -> np.ndarray:
    evidence = evidence_of(scene, state, config)
    return contact_penalty(evidence, scene.obj, device_poses(T, "cpu"), points)


def unsure_of(scene: HeldObject, *links: int) -> HandState:
    """The true hand, but the image does not support some links."""
    certain = np.ones(len(scene.hand.hand.links), dtype=bool)
    certain[list(links)] = False
    return replace(scene.hand_state, certain=certain)


def around(scene: HeldObject, count: int) -> np.ndarray:
    """Poses up to some centimetres from the true one, the first of them."""
    motions = np.random.default_rng(0).normal(0, 1, (count, 6)) * ([0.5] * 3 + [0.03] * 3)
    motions[0] = 0
    return np.asarray(scene.T_camera_object @ exp(motions))


def clearances(scene: HeldObject, T: np.ndarray, links: Sequence[int] | None = None) -> np.ndarray:
    """Smallest signed distances [m] of posed objects to some links or the hand, by brute force."""
    there = [transform(x, scene.obj.model.surface.points[:1000]) for x in T]
    return np.array([distance_to_hand(x, scene.hand, scene.hand_state, links).min() for x in there])


def test_penetration_and_gap_cost_in_proportion_beyond_what_model_errors_explain() -> None:
    scene, c = held_object("cuboid"), replace(CONFIG, finger_apart=0.0)
    T = around(scene, 300)
    fingers = [i for finger in scene.hand.hand.fingers for i in finger.links]
    depth, gap = -clearances(scene, T), clearances(scene, T, fingers)
    expected = np.maximum(
        (depth - c.free_penetration) / c.penetration_scale, (gap - c.free_gap) / c.gap_scale
    ).clip(0, c.max_contact_penalty)
    for cost in (0.0, c.max_contact_penalty):
        assert 10 < (expected == cost).sum() < 290
    np.testing.assert_allclose(penalties(scene, T, config=c), expected, atol=0.01)


def test_every_finger_that_does_not_touch_the_object_costs() -> None:
    scene = held_object("cuboid")
    T = around(scene, 50)
    gaps = np.array([clearances(scene, T, finger.links) for finger in scene.hand.hand.fingers])
    apart = ((gaps - CONFIG.free_finger_gap) / CONFIG.finger_gap_scale).clip(0, 1).mean(axis=0)
    without = penalties(scene, T, config=replace(CONFIG, finger_apart=0.0))
    found = penalties(scene, T) - without
    assert (apart > 0.1).any()
    assert (apart < 0.9).any()
    np.testing.assert_allclose(found, CONFIG.finger_apart * apart, atol=0.01)


def moved(scene: HeldObject, axis: int, steps: np.ndarray) -> np.ndarray:
    """The true pose, moved along an axis of the hand [m]."""
    T = np.tile(scene.T_camera_object, (len(steps), 1, 1))
    T[:, :3, 3] += steps[:, None] * scene.hand_state.T_camera_hand[:3, axis]
    return T


def test_the_penalty_grows_with_the_gap() -> None:
    """The object moves out of the plane of the fingers."""
    scene = held_object("cuboid")
    steps = np.linspace(0.06, 0.3, 20)
    penalty = penalties(scene, moved(scene, 1, steps))
    assert (np.diff(penalty) >= 0).all()
    assert penalty[-1] > penalty[0] + 0.5
    assert penalties(scene, moved(scene, 1, np.array([2.0])))[0] == penalty[-1]  # cut off


def test_the_penalty_grows_with_the_penetration() -> None:
    """The object moves into the palm."""
    scene = held_object("cuboid")
    T = moved(scene, 2, np.linspace(-0.04, -0.1, 15))
    config = replace(CONFIG, finger_apart=0.0)
    depth, penalty = -clearances(scene, T), penalties(scene, T, config=config)
    order = np.argsort(depth)
    assert np.ptp(depth) > 0.015
    assert (np.diff(penalty[order]) >= -1e-6).all()
    assert penalty[order][-1] > 0.5


def test_nothing_is_known_of_links_that_the_image_does_not_support() -> None:
    """The object is in the middle of a finger's last link."""
    scene = held_object("cuboid")
    links = scene.hand.hand.fingers[0].links
    T = scene.T_camera_object.copy()
    T[:3, 3] = transform(scene.hand_state.T_camera_link[links[-1]], np.array([[0, 0, 0.025]]))[0]
    sure = penalties(scene, T[None])[0]
    unsure = penalties(scene, T[None], unsure_of(scene, *links))[0]
    assert 0 <= unsure < sure


def test_a_gap_may_hide_a_link_whose_place_is_unknown() -> None:
    scene = held_object("cuboid")
    T = moved(scene, 1, np.array([0.07]))
    assert clearances(scene, T)[0] > CONFIG.free_gap
    fingers = [i for f in scene.hand.hand.fingers for i in f.links]
    assert 0 <= penalties(scene, T, unsure_of(scene, *fingers))[0] < penalties(scene, T)[0]


def test_more_contact_points_than_the_model_has_are_all_of_them() -> None:
    scene = held_object("cuboid")
    T = around(scene, 20)
    np.testing.assert_array_equal(
        penalties(scene, T, points=len(scene.obj.points)), penalties(scene, T, points=10**7)
    )


def test_the_score_with_contact_is_the_score_less_the_penalty() -> None:
    scene = held_object("industrial_part")
    T = around(scene, 40)
    evidence = evidence_of(scene)
    found = score_with_contact(evidence, scene.obj, T, SAMPLES)
    plain = agreement(evidence, scene.obj, device_poses(T, "cpu"), SAMPLES).sum(axis=1)
    np.testing.assert_allclose(found, plain - penalties(scene, T, points=200), atol=1e-6)


@pytest.mark.parametrize("name", ["industrial_part", "cuboid", "cylinder"])
def test_no_pose_nearby_explains_the_image_better_than_the_true_one(name: str) -> None:
    scene = held_object(name)
    T = around(scene, 200)
    found = score_with_contact(evidence_of(scene), scene.obj, T, SAMPLES)
    assert found.argmax() == 0
    assert found[0] > 0.5


def test_the_explained_share_counts_points_as_near_as_asked_for() -> None:
    scene = held_object("industrial_part")
    T = scene.T_camera_object @ exp(np.random.default_rng(1).normal(0, 0.002, (20, 6)))
    poses = device_poses(T, "cpu")
    usual, narrow = evidence_of(scene), evidence_of(scene, config=replace(CONFIG, near=0.002))
    asked = agreement(usual, scene.obj, poses, SAMPLES, near=0.002)
    np.testing.assert_array_equal(asked, agreement(narrow, scene.obj, poses, SAMPLES))
    wide = agreement(usual, scene.obj, poses, SAMPLES)
    np.testing.assert_array_equal(asked[:, 0], wide[:, 0])
    assert (asked[:, 1] < 0.95 * wide[:, 1]).all()


def test_links_without_support_do_not_hide_the_object() -> None:
    """Rendered where the image shows empty space, a link would excuse wrong poses."""
    scene = held_object("cuboid")
    links = scene.hand.hand.fingers[0].links
    with_links = evidence_of(scene).arrays.hand_depth.numpy()
    without = evidence_of(scene, unsure_of(scene, *links)).arrays.hand_depth.numpy()
    camera = scene.observation.camera.subsampled(CONFIG.hand_step)
    assert len(without) == camera.width * camera.height
    assert (without > 0).sum() < (with_links > 0).sum()
    others = np.ones(len(scene.hand.hand.links), dtype=bool)
    others[list(links)] = False
    expected = on_host(scene.hand.render(camera, scene.hand_state.T_camera_link, others))
    np.testing.assert_array_equal(without, expected)


def test_every_segment_point_is_part_of_the_evidence() -> None:
    scene = held_object("cuboid")
    evidence = evidence_of(scene)
    assert len(evidence.segment_weights) == len(scene.segment.points)
    given = np.column_stack([scene.segment.points, scene.segment.normals, scene.segment.weight])
    e = evidence.arrays
    found = np.column_stack([e.points.numpy(), e.normals.numpy(), e.weights.numpy()])
    np.testing.assert_array_equal(np.unique(found, axis=0), np.unique(given, axis=0))
    # Any stride takes an even sample of the segment.
    spread = scene.segment.points.std(axis=0)
    np.testing.assert_allclose(e.points.numpy()[::7].std(axis=0), spread, rtol=0.3)
