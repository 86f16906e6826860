import numpy as np
import pytest
from held_object import built_in_object, held_object
from hypothesis import given, settings
from hypothesis import strategies as st

from inhand.config import ClusteringConfig, EvidenceConfig
from inhand.geometry.se3 import exp, inverse, transform
from inhand.packed import PackedObject
from inhand.stages.clustering import cluster, distinct_poses
from inhand.stages.evidence import Evidence, gather_evidence
from inhand.stages.results import PoseSet

POSE = exp(np.array([0.4, -1.0, 2.0, 0.05, -0.02, 0.5]))
NEAR = 0.002


def pose_set(poses: np.ndarray, scores: np.ndarray | None = None) -> PoseSet:
    scores = np.linspace(1, 0.5, len(poses)) if scores is None else scores
    return PoseSet(poses.astype(np.float32), scores.astype(np.float32))


def turned(x: float, y: float, z: float) -> np.ndarray:
    """Rotation about the object's z axis, then y, then x [degrees]."""
    about_x, about_y, about_z = exp(np.radians(np.eye(3, 6) * [[x], [y], [z]]))
    return np.asarray(about_x @ about_y @ about_z)


@pytest.mark.parametrize(
    ("name", "same", "different"),
    [
        # 30 x 30 x 64 mm, the long axis along z.
        ("cuboid", [(0, 0, 90), (0, 0, 180), (180, 0, 0), (0, 180, 90)], [(90, 0, 0), (0, 0, 45)]),
        ("cylinder", [(0, 0, 17), (180, 0, 33), (0, 180, 0)], [(90, 0, 0), (20, 0, 0)]),
        ("ellipsoid", [(0, 0, 17), (180, 0, 33)], [(90, 0, 0), (40, 0, 0)]),
        ("industrial_part", [(0.5, 0, 0)], [(0, 0, 90), (180, 0, 0), (0, 0, 180), (20, 0, 0)]),
    ],
)
def test_poses_that_differ_by_a_symmetry_are_one(
    name: str, same: list[tuple[float, ...]], different: list[tuple[float, ...]]
) -> None:
    obj = built_in_object(name)
    for angles in same:
        pair = pose_set(np.stack([POSE, POSE @ turned(*angles)]))
        assert len(distinct_poses(pair, obj, NEAR, 10)) == 1, angles
    for angles in different:
        pair = pose_set(np.stack([POSE, POSE @ turned(*angles)]))
        assert len(distinct_poses(pair, obj, NEAR, 10)) == 2, angles


def test_shifts_are_told_apart() -> None:
    obj = built_in_object("cuboid")
    for shift, count in ((0.001, 1), (0.012, 2), (0.3, 2)):
        pair = pose_set(np.stack([POSE, POSE @ exp(np.array([0, 0, 0, shift, shift, 0]))]))
        assert len(distinct_poses(pair, obj, NEAR, 10)) == count, shift


def mean_distance(obj: PackedObject, T_a: np.ndarray, T_b: np.ndarray) -> float:
    """Mean distance [m] of samples of the surface at T_a to the surface at T_b."""
    local = inverse(T_b.astype(float)) @ T_a.astype(float)
    points = obj.model.surface.points[:200]
    return float(np.abs(obj.model.distance_field.distance(transform(local, points))).mean())


@given(st.integers(0, 10_000), st.sampled_from([0.001, 0.003]))
@settings(max_examples=10, deadline=None)
def test_what_is_dropped_lies_near_a_better_pose_that_is_kept(seed: int, near: float) -> None:
    obj = built_in_object("industrial_part")
    rng = np.random.default_rng(seed)
    centres = POSE @ exp(rng.normal(0, 1, (6, 6)) * ([0.5] * 3 + [0.01] * 3))
    poses = centres[rng.integers(6, size=60)] @ exp(rng.normal(0, 0.002, (60, 6)))
    given_poses = pose_set(poses, rng.normal(size=60))
    kept = distinct_poses(given_poses, obj, near, 100)
    assert 5 <= len(kept) < 60
    assert (np.diff(kept.score) <= 0).all()
    assert kept.score[0] == given_poses.score.max()
    # The stage looks at fewer samples of the surface than this test: allow for it.
    for i, T in enumerate(kept.T_camera_object):
        for better in kept.T_camera_object[:i]:
            assert mean_distance(obj, T, better) > 0.6 * near
    for T, score in zip(given_poses.T_camera_object, given_poses.score, strict=True):
        better = kept.T_camera_object[kept.score >= score]
        assert min(mean_distance(obj, T, other) for other in better) < 1.5 * near


def test_no_more_than_asked_for_best_first() -> None:
    obj = built_in_object("cuboid")
    poses = np.stack([POSE @ exp(np.array([0, 0, 0, 0.02 * k, 0, 0])) for k in range(12)])
    scores = np.random.default_rng(0).permutation(12).astype(float)
    found = distinct_poses(pose_set(poses, scores), obj, NEAR, 5)
    np.testing.assert_array_equal(found.score, [11, 10, 9, 8, 7])
    np.testing.assert_allclose(found.T_camera_object, poses[np.argsort(-scores)[:5]], atol=1e-6)


def test_at_no_distance_only_equal_poses_are_one() -> None:
    obj = built_in_object("cuboid")
    poses = np.stack([POSE, POSE, POSE @ exp(np.array([0, 0, 0, 0.001, 0.001, 0.001]))])
    assert len(distinct_poses(pose_set(poses), obj, 0.0, 10)) >= 2


def test_nothing_stays_nothing() -> None:
    nothing = PoseSet(np.zeros((0, 4, 4), dtype=np.float32), np.zeros(0, dtype=np.float32))
    assert len(distinct_poses(nothing, built_in_object("cuboid"), NEAR, 5)) == 0


# The stage


def evidence_of(name: str) -> Evidence:
    scene = held_object(name)
    return gather_evidence(
        scene.observation, scene.hand_state, scene.segment, scene.hand, EvidenceConfig()
    )


def hypotheses_around(name: str, count: int) -> PoseSet:
    """Poses around the truth, which is the first, with scores that say nothing."""
    rng = np.random.default_rng(0)
    errors = rng.normal(0, 1, (count, 6)) * ([0.4] * 3 + [0.01] * 3)
    errors[0] = 0
    return pose_set(held_object(name).T_camera_object @ exp(errors), np.zeros(count))


@pytest.mark.parametrize("name", ["industrial_part", "cuboid"])
def test_the_truth_comes_first_among_the_clusters(name: str) -> None:
    scene, hypotheses = held_object(name), hypotheses_around(name, 300)
    found = cluster(hypotheses, evidence_of(name), scene.obj, ClusteringConfig())
    assert mean_distance(scene.obj, found.T_camera_object[0], scene.T_camera_object) < 0.002
    assert (np.diff(found.score) <= 0).all()


def test_the_method_of_the_paper_can_be_chosen() -> None:
    scene, hypotheses = held_object("cuboid"), hypotheses_around("cuboid", 50)
    config = ClusteringConfig(method="se3")
    found = cluster(hypotheses, evidence_of("cuboid"), scene.obj, config)
    assert set(found.score) <= set(hypotheses.score)
