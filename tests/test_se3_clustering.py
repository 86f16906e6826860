import numpy as np
import pytest
from held_object import built_in_object

from inhand.config import ClusteringConfig
from inhand.geometry import mesh as meshes
from inhand.geometry.se3 import exp, random_rotation, rotation_angle
from inhand.object_model import ObjectModel
from inhand.packed import PackedObject
from inhand.stages.results import PoseSet
from inhand.stages.se3_clustering import cluster_se3

CONFIG = ClusteringConfig(method="se3")
POSE = exp(np.array([0.4, -1.0, 2.0, 0.05, -0.02, 0.5]))


def clustered(obj: PackedObject, poses: np.ndarray, scores: np.ndarray | None = None) -> PoseSet:
    scores = np.linspace(1, 0.5, len(poses)) if scores is None else scores
    return cluster_se3(PoseSet(poses.astype(np.float32), scores.astype(np.float32)), obj, CONFIG)


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
        ("industrial_part", [], [(0, 0, 90), (180, 0, 0), (0, 0, 180), (20, 0, 0)]),
    ],
)
def test_poses_that_differ_by_a_symmetry_are_one(
    name: str, same: list[tuple[float, ...]], different: list[tuple[float, ...]]
) -> None:
    obj = built_in_object(name)
    for angles in same:
        assert len(clustered(obj, np.stack([POSE, POSE @ turned(*angles)]))) == 1, angles
    for angles in different:
        assert len(clustered(obj, np.stack([POSE, POSE @ turned(*angles)]))) == 2, angles


def test_symmetry_is_about_the_objects_own_axes() -> None:
    """A frame origin far outside the object, and an axis that is not z."""
    T = exp(np.array([0.7, 0.2, 0.0, 0.3, -0.2, 0.1]))
    mesh = meshes.transformed(meshes.cylinder(0.0175, 0.064), T)
    obj = PackedObject(ObjectModel.from_mesh(mesh), "cpu")
    own = T @ turned(0, 0, 75) @ np.linalg.inv(T)
    flip = T @ turned(180, 0, 0) @ np.linalg.inv(T)
    tilt = T @ turned(25, 0, 0) @ np.linalg.inv(T)
    found = clustered(obj, np.stack([POSE, POSE @ own, POSE @ flip @ own, POSE @ tilt]))
    assert len(found) == 2
    # A rotation about the frame's origin moves the object away.
    assert len(clustered(obj, np.stack([POSE, POSE @ turned(0, 0, 10)]))) == 2


def test_the_best_of_every_cluster_is_kept_in_order() -> None:
    obj = built_in_object("industrial_part")
    near = exp(np.array([0.05, 0, 0, 0.002, 0, 0]))
    far = exp(np.array([0, 0, 0, 0.02, 0, 0]))
    poses = np.stack([POSE, POSE @ near, POSE @ far, POSE @ far @ near])
    found = clustered(obj, poses, np.array([0.3, 0.5, 0.9, 0.7]))
    np.testing.assert_allclose(found.score, [0.9, 0.5])
    np.testing.assert_allclose(found.T_camera_object, poses[[2, 1]], atol=1e-6)


def test_no_more_clusters_than_asked_for() -> None:
    obj = built_in_object("industrial_part")
    poses = np.stack([exp(np.array([0, 0, 0, 0.02 * k, 0, 0])) for k in range(150)])
    found = clustered(obj, poses)
    assert len(found) == CONFIG.keep
    np.testing.assert_allclose(found.T_camera_object, poses[: CONFIG.keep], atol=1e-6)


def test_every_pose_is_near_a_kept_one_that_is_no_worse() -> None:
    """Thousands of poses; the object has no symmetry, so that distances are plain ones."""
    rng = np.random.default_rng(0)
    obj = built_in_object("industrial_part")
    poses = np.tile(np.eye(4), (20_000, 1, 1))
    centres = [random_rotation(rng) for _ in range(20)]
    poses[:, :3, :3] = np.stack(centres)[rng.integers(20, size=len(poses))]
    poses = poses @ exp(rng.normal(0, 0.05, (len(poses), 6)) * [1, 1, 1, 0, 0, 0])
    places = rng.uniform(-0.05, 0.05, (20, 3))
    poses[:, :3, 3] = places[rng.integers(20, size=len(poses))] + rng.normal(
        0, 0.001, (len(poses), 3)
    )
    scores = rng.uniform(size=len(poses))
    config = ClusteringConfig(method="se3", keep=len(poses))
    found = cluster_se3(PoseSet(poses.astype(np.float32), scores.astype(np.float32)), obj, config)
    assert 400 <= len(found) < 4000
    centre = obj.model.centre
    at = poses[:, :3, :3] @ centre + poses[:, :3, 3]
    kept = found.T_camera_object.astype(np.float64)
    kept_at = kept[:, :3, :3] @ centre + kept[:, :3, 3]
    for i in range(0, len(poses), 100):
        # Both lie within `distance` of the leader of their place.
        near = np.linalg.norm(kept_at - at[i], axis=1) < 2 * config.distance
        near &= rotation_angle(kept[:, :3, :3], poses[i, :3, :3]) < config.angle
        assert found.score[near].max() >= np.float32(scores[i])
