"""Errors and statistics against closed forms and independent implementations."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest, mannwhitneyu

from inhand.errors import InputError
from inhand.evaluation import metrics
from inhand.evaluation.metrics import ObjectMetric
from inhand.geometry import mesh as meshes
from inhand.geometry.distance_field import DistanceField, build_distance_field
from inhand.geometry.se3 import exp, random_rotation
from inhand.object_symmetry import Symmetry

RNG = np.random.default_rng(7)


def pose(rotation: Any = None, translation: Any = (0.0, 0.0, 0.0)) -> np.ndarray:
    T = np.eye(4)
    if rotation is not None:
        T[:3, :3] = rotation.as_matrix() if isinstance(rotation, Rotation) else rotation
    T[:3, 3] = translation
    return T


def random_pose() -> np.ndarray:
    return pose(random_rotation(RNG), RNG.normal(size=3))


@dataclass
class Model:
    """The part of an object model that errors depend on."""

    mesh: meshes.TriangleMesh
    symmetry: Symmetry
    distance_field: DistanceField


def metric(mesh: meshes.TriangleMesh, rotations: Any = None, axis: Any = None) -> ObjectMetric:
    """Metric of an object with the given symmetries; identity only by default."""
    rotations = np.eye(4)[None] if rotations is None else np.asarray(rotations)
    symmetry = Symmetry(mesh.bounds.mean(axis=0), axis, rotations)
    model: Any = Model(mesh, symmetry, build_distance_field(mesh, 0.002, 0.02))
    return ObjectMetric(model)


@pytest.fixture(scope="module")
def box_metric() -> ObjectMetric:
    return metric(meshes.box((0.03, 0.04, 0.06)))


def test_model_points_lie_on_the_surface_in_proportion_to_area() -> None:
    points = metrics.sample_model(meshes.box((0.02, 0.02, 0.10)), 4000)
    assert points.shape == (4000, 3)
    on_face = np.isclose(np.abs(points), (0.01, 0.01, 0.05))
    assert on_face.any(axis=1).all()
    ends = 2 * 0.02**2
    share = ends / (ends + 4 * 0.02 * 0.10)
    assert on_face[:, 2].mean() == pytest.approx(share, abs=0.02)


def test_adi_against_brute_force() -> None:
    points = RNG.normal(size=(300, 3)) * 0.03
    truth, estimate = random_pose(), random_pose()
    estimate[:3, 3] = truth[:3, 3] + 0.01
    a = points @ estimate[:3, :3].T + estimate[:3, 3]
    b = points @ truth[:3, :3].T + truth[:3, 3]
    expected = cdist(a, b).min(axis=1).mean()
    assert metrics.adi(KDTree(points), estimate, truth) == pytest.approx(expected, rel=1e-9)


def test_adi_closed_forms(box_metric: ObjectMetric) -> None:
    truth = random_pose()
    assert box_metric.adi(truth, truth) == pytest.approx(0.0, abs=1e-9)
    # Far away along x, every point's nearest neighbour lies near the facing side.
    far = truth @ pose(translation=(10.0, 0, 0))
    assert box_metric.adi(far, truth) == pytest.approx(10.0 - 0.015, abs=2e-3)
    # Half a turn maps the box to itself, up to the spacing of the points.
    turned = truth @ pose(Rotation.from_euler("z", np.pi))
    assert box_metric.adi(turned, truth) < 0.001


def test_add_closed_forms_and_against_brute_force(box_metric: ObjectMetric) -> None:
    truth, estimate = random_pose(), random_pose()
    points = box_metric.points
    a = points @ estimate[:3, :3].T + estimate[:3, 3]
    b = points @ truth[:3, :3].T + truth[:3, 3]
    expected = np.linalg.norm(a - b, axis=1).mean()
    assert metrics.add(points, estimate, truth) == pytest.approx(expected, rel=1e-9)
    shifted = truth @ pose(translation=(0.0, 0.003, 0.004))
    assert box_metric.add(shifted, truth) == pytest.approx(0.005, rel=1e-9)


def test_best_adi_finds_the_exact_best_of_thousands(box_metric: ObjectMetric) -> None:
    truth = random_pose()
    poses = np.stack([random_pose() for _ in range(3000)])
    near = truth @ exp(RNG.normal(size=(60, 6)) * [0.15, 0.15, 0.15, 0.006, 0.006, 0.006])
    poses[::50] = near
    exact = min(box_metric.adi(T, truth) for T in near)
    best = box_metric.best_adi(poses.astype(np.float32), truth)
    assert best is not None
    assert best == pytest.approx(exact, abs=2e-4)
    assert best >= exact - 1e-6
    assert box_metric.best_adi(np.empty((0, 4, 4)), truth) is None


def test_pose_error_without_symmetry(box_metric: ObjectMetric) -> None:
    truth = random_pose()
    turn = Rotation.from_rotvec([0.1, -0.2, 0.2])
    error = box_metric.pose_error(truth @ pose(turn, (0.003, 0.0, 0.004)), truth)
    assert error.translation == pytest.approx(0.005, rel=1e-6)
    assert error.rotation == pytest.approx(0.3, rel=1e-6)


def test_rotation_about_a_symmetry_is_no_error() -> None:
    flip = pose(Rotation.from_euler("x", np.pi))
    can = metric(meshes.cylinder(0.02, 0.06), [np.eye(4), flip], np.array([0.0, 0, 1]))
    truth = random_pose()
    alike = truth @ flip @ pose(Rotation.from_euler("z", 1.234))
    assert can.pose_error(alike, truth).rotation == pytest.approx(0.0, abs=1e-6)
    assert can.add(alike, truth) == pytest.approx(0.0, abs=1e-9)
    tilted = alike @ pose(Rotation.from_euler("y", 0.25))
    assert can.pose_error(tilted, truth).rotation == pytest.approx(0.25, abs=1e-6)


def test_symmetric_rotation_error_against_a_dense_search() -> None:
    axis = np.array([1.0, 2, 2]) / 3
    can = metric(meshes.cylinder(0.02, 0.06), axis=axis)
    spins = Rotation.from_rotvec(np.linspace(0, 2 * np.pi, 20001)[:, None] * axis).as_matrix()
    for _ in range(20):
        truth, estimate = random_pose(), random_pose()
        R = Rotation.from_matrix((truth[:3, :3] @ spins).swapaxes(1, 2) @ estimate[:3, :3])
        expected = R.magnitude().min()
        assert can.pose_error(estimate, truth).rotation == pytest.approx(expected, abs=1e-4)


def test_symmetries_leave_the_translation_alone_far_from_the_origin() -> None:
    body = meshes.transformed(meshes.cylinder(0.02, 0.06), pose(translation=(0.1, 0.2, 0.3)))
    centre = body.bounds.mean(axis=0)
    about_centre = pose(translation=centre) @ pose(Rotation.from_euler("x", np.pi))
    flip = about_centre @ pose(translation=-centre)
    can = metric(body, [np.eye(4), flip], np.array([0.0, 0, 1]))
    truth = random_pose()
    spin = pose(translation=centre) @ pose(Rotation.from_euler("z", 2.0))
    alike = truth @ flip @ spin @ pose(translation=-centre)
    assert can.pose_error(alike, truth) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert can.add(alike, truth) == pytest.approx(0.0, abs=1e-9)


def test_no_rotation_of_a_sphere_is_an_error() -> None:
    ball = meshes.transformed(meshes.sphere(0.02), pose(translation=(0.1, 0.0, 0.0)))
    centre = np.array([0.1, 0, 0])
    tilts = [Rotation.from_euler("x", a) for a in (0.0, 0.5, 1.0, 1.5)]
    rotations = [
        pose(translation=centre) @ pose(tilt) @ pose(translation=-centre) for tilt in tilts
    ]
    sphere = metric(ball, rotations, np.array([0.0, 0, 1]))
    truth, estimate = random_pose(), random_pose()
    estimate[:3, 3] += (truth - estimate)[:3, :3] @ centre + truth[:3, 3] - estimate[:3, 3]
    estimate[:3, 3] += (0.003, 0.004, 0.0)
    assert sphere.pose_error(estimate, truth) == pytest.approx((0.005, 0.0), abs=1e-6)
    assert sphere.add(estimate, truth) == pytest.approx(0.005, abs=1e-9)


def test_wrist_and_angle_errors() -> None:
    T = random_pose()
    off = T @ pose(Rotation.from_euler("y", 0.05), (0.0, 0.0, 0.002))
    assert metrics.wrist_error(off, T) == pytest.approx((0.002, 0.05))
    errors = metrics.angle_errors(
        {"a": 0.5, "b": 3.1, "c": 0.1 + 2 * np.pi, "mimic": 1.0}, {"a": 0.2, "b": -3.1, "c": 0.0}
    )
    assert errors == pytest.approx({"a": 0.3, "b": 2 * np.pi - 6.2, "c": 0.1})


@pytest.mark.parametrize(("hits", "trials"), [(0, 10), (3, 10), (10, 10), (1, 1), (117, 132)])
def test_wilson_interval_against_scipy(hits: int, trials: int) -> None:
    expected = binomtest(hits, trials).proportion_ci(0.95, method="wilson")
    assert metrics.wilson_interval(hits, trials) == pytest.approx(tuple(expected), abs=1e-4)


def test_wilson_interval_of_nothing() -> None:
    assert metrics.wilson_interval(0, 0) == (0.0, 1.0)
    with pytest.raises(InputError, match="3 successes of 2"):
        metrics.wilson_interval(3, 2)


def test_auroc_closed_forms() -> None:
    assert metrics.auroc([0.1, 0.9], [False, True]) == 1.0
    assert metrics.auroc([0.9, 0.1], [False, True]) == 0.0
    assert metrics.auroc([0.5, 0.5], [False, True]) == 0.5
    assert metrics.auroc([0.5, 0.7], [True, True]) is None
    assert metrics.auroc([], []) is None


def test_auroc_against_the_rank_test() -> None:
    scores = RNG.integers(0, 12, size=200) / 12
    correct = RNG.random(200) < 0.2 + 0.6 * scores
    u = mannwhitneyu(scores[correct], scores[~correct]).statistic
    expected = u / (correct.sum() * (~correct).sum())
    assert metrics.auroc(scores, correct) == pytest.approx(expected)
