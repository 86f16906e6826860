from dataclasses import replace

import numpy as np
import pytest
import trimesh
from held_object import HeldObject, held_object

from inhand.config import RefinementConfig
from inhand.geometry.se3 import exp, inverse, rotation_angle
from inhand.kernels.lcp import pose_lcp
from inhand.stages.point_to_plane import align_model, refine_by_icp
from inhand.stages.results import PoseSet

CONFIG = RefinementConfig(method="icp", iterations=30)


def poses_around(scene: HeldObject, count: int, angle: float, distance: float) -> PoseSet:
    """Poses around the true one, with errors of sd `angle` [rad] and `distance` [m] per axis."""
    motions = np.random.default_rng(0).normal(0, 1, (count, 6)) * ([angle] * 3 + [distance] * 3)
    poses = scene.T_camera_object @ exp(motions)
    return PoseSet(poses.astype(np.float32), np.zeros(count, dtype=np.float32))


def errors(T: np.ndarray, T_true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance [m] and angle [degrees] of poses (m, 4, 4) from one or as many."""
    off = inverse(T_true) @ T.astype(np.float64)
    angle = rotation_angle(np.eye(3), off[..., :3, :3])
    return np.linalg.norm(off[..., :3, 3], axis=-1), np.degrees(angle)


def test_poses_converge_to_the_truth() -> None:
    scene = held_object("industrial_part")
    start = poses_around(scene, 30, 0.08, 0.003)
    found = align_model(start, scene.segment, scene.obj, CONFIG)
    distance, angle = errors(found, scene.T_camera_object)
    assert np.median(errors(start.T_camera_object, scene.T_camera_object)[0]) > 0.004
    assert (distance < 0.001).mean() > 0.9
    assert (angle < 1.0).mean() > 0.9


def test_poses_converge_as_with_another_implementation() -> None:
    """Where both converge: their correspondences differ, by field here and by samples there."""
    small_gicp = pytest.importorskip("small_gicp")
    scene = held_object("industrial_part")
    start = poses_around(scene, 20, 0.05, 0.002)
    found = align_model(start, scene.segment, scene.obj, CONFIG)
    mesh = trimesh.Trimesh(scene.obj.model.mesh.vertices, scene.obj.model.mesh.faces)
    target = small_gicp.PointCloud(np.asarray(mesh.sample(40_000, seed=0)))
    tree = small_gicp.KdTree(target)
    small_gicp.estimate_normals_covariances(target, tree, num_neighbors=8)
    source = small_gicp.PointCloud(scene.segment.points.astype(np.float64))
    others = np.stack(
        [
            inverse(
                small_gicp.align(
                    target,
                    source,
                    tree,
                    init_T_target_source=inverse(T.astype(np.float64)),
                    registration_type="PLANE_ICP",
                    max_correspondence_distance=CONFIG.max_distance,
                ).T_target_source
            )
            for T in start.T_camera_object
        ]
    )
    distance, angle = errors(found, others)
    assert np.median(distance) < 0.0005
    assert np.median(angle) < 0.5


def test_poses_that_became_the_same_are_merged() -> None:
    """The cuboid looks the same after a quarter turn about its long axis and when flipped."""
    scene = held_object("cuboid")
    turns = np.pi * np.array([[0, 0, 0], [0, 0, 0.5], [1, 0, 0], [0, 1, 0]])
    start = poses_around(scene, 4, 0.02, 0.001)
    turned = start.T_camera_object @ exp(np.pad(turns, ((0, 0), (0, 3))))
    start = PoseSet(turned.astype(np.float32), start.score)
    found = refine_by_icp(start, scene.segment, scene.obj, CONFIG)
    assert len(found) == 1
    other = start.T_camera_object @ exp(np.array([0, 0, 0, 0.03, 0, 0]))
    both = np.concatenate([start.T_camera_object, other]).astype(np.float32)
    apart = PoseSet(both, np.zeros(8, dtype=np.float32))
    assert len(refine_by_icp(apart, scene.segment, scene.obj, CONFIG)) > 1


def test_the_poses_with_the_highest_lcp_are_kept() -> None:
    scene = held_object("industrial_part")
    start = poses_around(scene, 60, 0.5, 0.02)
    full = refine_by_icp(start, scene.segment, scene.obj, CONFIG)
    kept = refine_by_icp(start, scene.segment, scene.obj, replace(CONFIG, keep=5))
    lcp = pose_lcp(
        full.T_camera_object,
        scene.segment.points,
        scene.segment.normals,
        scene.obj.fields,
        CONFIG.lcp_distance,
        CONFIG.lcp_normal_angle,
        "cpu",
    )
    assert len(full) > 20
    np.testing.assert_array_equal(full.score, lcp)
    assert (np.diff(full.score) <= 0).all()
    np.testing.assert_array_equal(kept.score, full.score[:5])
    np.testing.assert_array_equal(kept.T_camera_object, full.T_camera_object[:5])


def test_a_pose_without_points_near_it_stays() -> None:
    scene = held_object("cuboid")
    start = poses_around(scene, 1, 0.0, 0.0)
    start.T_camera_object[:, 0, 3] += 1.0
    found = align_model(start, scene.segment, scene.obj, CONFIG)
    np.testing.assert_allclose(found, start.T_camera_object, atol=1e-6)
