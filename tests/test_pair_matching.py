from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import warp as wp
from held_object import HeldObject, built_in_object, held_object
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from inhand.config import EvidenceConfig, HypothesesConfig
from inhand.errors import NoAnswer
from inhand.geometry.se3 import exp, transform
from inhand.kernels.launch import launch
from inhand.kernels.pair_matching import match_pairs
from inhand.packed import PackedObject
from inhand.pair_table import pair_features
from inhand.stages.evidence import gather_evidence
from inhand.stages.hypotheses import generate_hypotheses
from inhand.stages.results import PoseSet, Segment

MATCHES = 30


def matched(
    obj: PackedObject,
    points: np.ndarray,
    normals: np.ndarray,
    matches: int = MATCHES,
    seed: int = 0,
) -> np.ndarray:
    """Poses, (n / 2, matches, 4, 4), of the scene pairs (0, 1), (2, 3), ..."""
    first = np.arange(0, len(points), 2, dtype=np.int32)
    poses = wp.empty(len(first) * matches, dtype=wp.mat44, device="cpu")
    scene = [wp.array(x, dtype=wp.vec3) for x in (points, normals)]
    index = [wp.array(x, dtype=int) for x in (first, first + 1)]
    inputs = [*scene, *index, obj.pairs, matches, seed, poses]
    launch(match_pairs, len(first), inputs, "cpu", work_per_item=10 * matches)
    return np.asarray(poses.numpy().reshape(-1, matches, 4, 4))


def model_pairs(obj: PackedObject, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices (count,) of first and second points of random pairs in the table."""
    pairs = obj.model.pairs
    chosen = np.random.default_rng(seed).choice(len(pairs.pair_first), count, replace=False)
    return pairs.pair_first[chosen], pairs.pair_second[chosen]


def laid_out(
    obj: PackedObject, i: np.ndarray, j: np.ndarray, T: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals of the model pairs (i, j) at pose T, pair after pair."""
    index = np.stack([i, j], axis=1).reshape(-1)
    surface = obj.model.surface
    return transform(T, surface.points[index]), surface.normals[index] @ T[:3, :3].T


def features(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    return pair_features(points[0::2], normals[0::2], points[1::2], normals[1::2])


@cache
def midpoints(obj: PackedObject) -> cKDTree:
    """Tree of the middles of all pairs in the table."""
    points, pairs = obj.model.surface.points, obj.model.pairs
    return cKDTree((points[pairs.pair_first] + points[pairs.pair_second]) / 2)


def dihedral(along: np.ndarray, n1: np.ndarray, n2: np.ndarray) -> np.ndarray:
    """Angle [rad] from n1 to n2 about a direction, each (k, 3); NaN where a normal is along it."""
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    a, b = (n - (n * along).sum(axis=1, keepdims=True) * along for n in (n1, n2))
    angle = np.arctan2((np.cross(a, b) * along).sum(axis=1), (a * b).sum(axis=1))
    short = np.minimum(np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)) < 0.5
    return np.where(short, np.nan, angle)


@given(st.integers(0, 10_000), st.sampled_from(["cuboid", "industrial_part", "bottle"]))
@settings(max_examples=8, deadline=None)
def test_every_pose_lays_a_model_pair_on_the_scene_pair(seed: int, name: str) -> None:
    """By brute force over all pairs of the model."""
    obj = built_in_object(name)
    rng = np.random.default_rng(seed)
    points, normals = laid_out(obj, *model_pairs(obj, 16, seed), exp(rng.normal(0, 1, 6)))
    points += rng.normal(0, 0.001, points.shape)  # they need not lie on the model exactly
    poses = matched(obj, points, normals, seed=seed).astype(np.float64)

    empty = poses[..., 3, 3] == 0
    assert (poses[empty] == 0).all()
    assert empty.mean() < 0.9
    np.testing.assert_array_equal(poses[~empty][:, 3], np.tile([0, 0, 0, 1], (np.sum(~empty), 1)))
    R = poses[~empty][:, :3, :3]
    identities = np.tile(np.eye(3), (len(R), 1, 1))
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), identities, atol=1e-4)
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-4)

    surface, pairs = obj.model.surface, obj.model.pairs
    scene_features = features(points, normals)
    step = np.array([pairs.distance_step, *[np.pi / pairs.n_angle] * 3])
    for k, m in zip(*np.nonzero(~empty), strict=True):
        T, (p1, p2), (n1, n2) = poses[k, m], points[2 * k :][:2], normals[2 * k :][:2]
        middle = T[:3, :3].T @ ((p1 + p2) / 2 - T[:3, 3])
        near = np.array(midpoints(obj).query_ball_point(middle, 2e-5))
        assert len(near)
        i, j = pairs.pair_first[near], pairs.pair_second[near]
        along = (surface.points[j] - surface.points[i]) @ T[:3, :3].T
        parallel = np.linalg.norm(np.cross(along, p2 - p1), axis=1) < 1e-5 * np.linalg.norm(p2 - p1)
        found = pair_features(
            surface.points[i], surface.normals[i], surface.points[j], surface.normals[j]
        )
        # The cell of the jittered feature: at most a cell and a half away.
        alike = (np.abs(found - scene_features[k]) < 1.51 * step).all(axis=1)
        laid = parallel & (along @ (p2 - p1) > 0) & alike
        assert laid.any()
        # The normals fall on each other if the pairs are twisted alike, not mirror images.
        m1, m2 = (surface.normals[x][laid] @ T[:3, :3].T for x in (i, j))
        twist = dihedral(along[laid], m1, m2)
        wanted = dihedral((p2 - p1)[None], n1[None], n2[None])
        same = np.abs((twist - wanted + np.pi) % (2 * np.pi) - np.pi) < 0.25
        cosine = np.minimum(m1 @ n1, m2 @ n2)
        assert (cosine[same] > np.cos(0.6)).all()


@pytest.mark.parametrize("name", ["industrial_part", "bottle"])
def test_the_true_pose_is_among_many_draws(name: str) -> None:
    obj = built_in_object(name)
    T = exp(np.array([0.3, -1.2, 0.8, 0.02, -0.1, 0.5]))
    i, j = model_pairs(obj, 400, 0)
    points, normals = laid_out(obj, i, j, T)
    feature = features(points, normals)
    wide = feature[:, 0] > 0.3 * obj.model.diameter
    rows = np.repeat(wide, 2)
    poses = matched(obj, points[rows], normals[rows], matches=400)
    off = np.abs(poses - T).max(axis=(2, 3))
    # A cell holds many pairs: not each is drawn.
    assert (off.min(axis=1) < 1e-3).mean() > 0.5
    assert (off.min(axis=1) < 0.1).mean() > 0.7


def test_draws_depend_on_the_seed_alone() -> None:
    obj = built_in_object("industrial_part")
    points, normals = laid_out(obj, *model_pairs(obj, 300, 1), np.eye(4))
    one, again, other = (matched(obj, points, normals, seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, other)
    # 300 pairs are sliced over the cores, 20 are not.
    few = matched(obj, points[:40], normals[:40], seed=1)
    np.testing.assert_array_equal(few, one[:20])


def test_pairs_unlike_any_of_the_model_give_no_pose() -> None:
    obj = built_in_object("cuboid")
    far = np.array([[0, 0, 0], [0, 0, 2 * obj.model.diameter]])
    coincident = np.zeros((2, 3))
    # A cuboid has no pair whose normals look at each other.
    opposed = np.array([[0, 0, 0.0], [0, 0, 0.03]])
    inward = np.array([[0, 0, 1.0], [0, 0, -1.0]])
    up = np.array([[1.0, 0, 0]] * 2)
    for points, normals in ((far, up), (coincident, up), (opposed, inward)):
        assert (matched(obj, points, normals) == 0).all()


def test_normals_along_the_pair_give_rigid_poses_or_none() -> None:
    """Nothing fixes the rotation about the pair then."""
    obj = built_in_object("cuboid")
    points = np.array([[0, 0, 0], [0, 0, 0.0301]])
    normals = np.array([[0, 0, -1.0], [0, 0, 1.0]])
    poses = matched(obj, points, normals, matches=500)[0].astype(float)
    poses = poses[poses[:, 3, 3] > 0]
    np.testing.assert_allclose(np.linalg.det(poses[:, :3, :3]), np.ones(len(poses)), atol=1e-4)


# The stage


def hypotheses_of(scene: HeldObject, segment: Segment, **changes: Any) -> PoseSet:
    evidence = gather_evidence(
        scene.observation, scene.hand_state, segment, scene.hand, EvidenceConfig()
    )
    config = replace(HypothesesConfig(), **changes)
    return generate_hypotheses(segment, evidence, scene.obj, config, np.random.default_rng(0))


def surface_error(scene: HeldObject, T: np.ndarray) -> np.ndarray:
    """Mean distance [m] of the surface at poses (m, 4, 4) to the true one, shape (m,)."""
    points = scene.obj.model.surface.points[:100]
    tree = cKDTree(transform(scene.T_camera_object, scene.obj.model.surface.points))
    moved = points @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3]
    return np.asarray(tree.query(moved.reshape(-1, 3))[0].reshape(len(T), -1).mean(axis=1))


@pytest.mark.parametrize("name", ["industrial_part", "cuboid", "cylinder"])
def test_the_truth_is_among_the_best_hypotheses(name: str) -> None:
    scene = held_object(name)
    found = hypotheses_of(scene, scene.segment)
    assert len(found) == HypothesesConfig().keep
    np.testing.assert_allclose(np.linalg.det(found.T_camera_object[:, :3, :3]), 1, atol=1e-3)
    best = found.take(np.argsort(-found.score)[:50])
    # Samples of the model are some millimetres apart.
    spacing = surface_error(scene, scene.T_camera_object[None])[0]
    assert surface_error(scene, best.T_camera_object.astype(float)).min() < spacing + 0.002


def test_the_poses_that_are_kept_are_the_best_of_all() -> None:
    scene = held_object("industrial_part")
    everything = hypotheses_of(scene, scene.segment, pairs=200, keep=10**6)
    kept = hypotheses_of(scene, scene.segment, pairs=200, keep=50)
    assert len(everything) > 1000
    np.testing.assert_array_equal(np.sort(kept.score), np.sort(everything.score)[-50:])


def test_hypotheses_are_repeatable() -> None:
    scene = held_object("cuboid")
    one, again = (hypotheses_of(scene, scene.segment, pairs=50) for _ in range(2))
    np.testing.assert_array_equal(one.T_camera_object, again.T_camera_object)
    np.testing.assert_array_equal(one.score, again.score)


def test_points_without_weight_are_not_sampled() -> None:
    """Half of the segment is clutter that is known to be none of the object's."""
    scene = held_object("industrial_part")
    segment = scene.segment
    clutter = segment.points + np.array([0.5, 0, 0], dtype=np.float32)
    mixed = Segment(
        np.concatenate([segment.points, clutter]),
        np.concatenate([segment.normals, segment.normals]),
        np.concatenate([segment.hand_distance, segment.hand_distance]),
        np.concatenate([segment.weight, 0 * segment.weight]),
    )
    found = hypotheses_of(scene, mixed, pairs=200)
    away = found.T_camera_object[:, 0, 3] > scene.T_camera_object[0, 3] + 0.25
    assert away.mean() < 0.05


def test_without_any_match_there_is_no_answer() -> None:
    scene = held_object("cuboid")
    lone = Segment(
        scene.segment.points[:1].repeat(30, axis=0),
        scene.segment.normals[:1].repeat(30, axis=0),
        np.full(30, 0.01, dtype=np.float32),
        np.ones(30, dtype=np.float32),
    )
    with pytest.raises(NoAnswer, match="matches the object"):
        hypotheses_of(scene, lone)
