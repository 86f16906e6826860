"""Errors of poses against closed forms and independent implementations."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from inhand.camera import Camera
from inhand.evaluation import metrics, visible_surface
from inhand.evaluation.metrics import ObjectMetric
from inhand.geometry import mesh as meshes
from inhand.geometry.distance_field import DistanceField, build_distance_field
from inhand.geometry.se3 import exp, random_rotation
from inhand.kernels.depth import DepthRenderer
from inhand.object_symmetry import Symmetry

RNG = np.random.default_rng(7)
CAMERA = Camera(150.0, 140.0, 31.5, 23.5, 64, 48)


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


def test_adi_of_the_toolkit_goes_the_other_way(box_metric: ObjectMetric) -> None:
    truth = seen_pose()
    estimate = truth @ pose(Rotation.from_rotvec([0.3, 0.1, 0.2]), (0.004, 0.002, 0.001))
    scores = box_metric.scores(estimate, truth, np.zeros((48, 64)), CAMERA)
    a, b = (box_metric.points @ T[:3, :3].T + T[:3, 3] for T in (estimate, truth))
    distance = cdist(a, b)
    assert scores.adi == pytest.approx(distance.min(axis=1).mean(), rel=1e-9)
    assert scores.adi_from_truth == pytest.approx(distance.min(axis=0).mean(), rel=1e-9)
    assert scores.adi != scores.adi_from_truth


def seen_pose() -> np.ndarray:
    """A pose half a metre in front of the camera."""
    return pose(random_rotation(RNG), (0.01, -0.02, 0.5))


def toolkit_mssd(points: Any, T: Any, truth: Any, symmetric: Any) -> float:
    """As the BOP toolkit computes it: every vertex at every symmetric pose."""
    moved = points @ T[:3, :3].T + T[:3, 3]
    places = [points @ (truth @ S)[:3, :3].T + (truth @ S)[:3, 3] for S in symmetric]
    return float(min(np.linalg.norm(moved - place, axis=1).max() for place in places))


def toolkit_mspd(points: Any, T: Any, truth: Any, symmetric: Any, camera: Camera) -> float:
    def pixels(T: Any) -> Any:
        image = (points @ T[:3, :3].T + T[:3, 3]) @ camera.matrix.T
        return image[:, :2] / image[:, 2:]

    places = [pixels(truth @ S) for S in symmetric]
    return float(min(np.linalg.norm(pixels(T) - place, axis=1).max() for place in places))


def test_mssd_and_mspd_closed_forms(box_metric: ObjectMetric) -> None:
    truth = pose(translation=(0, 0, 0.5))
    shifted = pose(translation=(0.003, 0.004, 0.5))
    assert box_metric.mssd(shifted, truth) == pytest.approx(0.005, rel=1e-9)
    # The near face is 0.03 m closer: a shift along u of s moves its pixels by f s / z.
    sideways = pose(translation=(0.003, 0, 0.5))
    expected = CAMERA.fx * 0.003 / (0.5 - 0.03)
    assert box_metric.mspd(sideways, truth, CAMERA) == pytest.approx(expected, rel=1e-9)
    # A turn about z by a moves the farthest corner by its chord.
    turned = truth @ pose(Rotation.from_euler("z", 0.2))
    radius = np.hypot(0.015, 0.02)
    assert box_metric.mssd(turned, truth) == pytest.approx(2 * radius * np.sin(0.1), rel=1e-9)
    assert box_metric.mspd(pose(translation=(0, 0, -0.5)), truth, CAMERA) == np.inf


@pytest.mark.parametrize("kind", ["box", "flipped box", "can"])
@pytest.mark.parametrize("spread", [0.02, 0.3, 2.0])
def test_mssd_and_mspd_against_the_toolkits_way(kind: str, spread: float) -> None:
    mesh = meshes.transformed(
        meshes.cylinder(0.02, 0.05) if kind == "can" else meshes.box((0.03, 0.04, 0.06)),
        pose(translation=(0.03, 0.0, -0.02)),
    )
    centre = pose(translation=mesh.bounds.mean(axis=0))
    flip = centre @ pose(Rotation.from_euler("x", np.pi)) @ np.linalg.inv(centre)
    rotations = [np.eye(4)] if kind == "box" else [np.eye(4), flip]
    scored = metric(mesh, rotations, np.array([0.0, 0, 1]) if kind == "can" else None)
    symmetric = [centre @ r @ np.linalg.inv(centre) for r in spins(315 if kind == "can" else 1)]
    symmetric = [turn @ r for turn in symmetric for r in rotations]
    for _ in range(3):
        truth = seen_pose()
        T = truth @ exp(RNG.normal(size=6) * [spread, spread, spread, 0.01, 0.01, 0.01])
        T[2, 3] = max(T[2, 3], 0.4)
        expected = toolkit_mssd(mesh.vertices, T, truth, symmetric)
        assert scored.mssd(T, truth) == pytest.approx(expected, rel=1e-9)
        expected = toolkit_mspd(mesh.vertices, T, truth, symmetric, CAMERA)
        assert scored.mspd(T, truth, CAMERA) == pytest.approx(expected, rel=1e-9)


def spins(steps: int) -> list[np.ndarray]:
    return [pose(Rotation.from_euler("z", 2 * np.pi * i / steps)) for i in range(steps)]


def test_bop_shares_count_the_thresholds_above_the_error(box_metric: ObjectMetric) -> None:
    truth = pose(translation=(0, 0, 0.5))
    diameter = np.linalg.norm((0.03, 0.04, 0.06))
    depth = np.zeros((48, 64))
    # 0.12 diameters sideways: above BOP's thresholds 0.05 and 0.10 of 0.05 to 0.50.
    estimate = pose(translation=(0.12 * diameter, 0, 0.5))
    scores = box_metric.scores(estimate, truth, depth, CAMERA)
    assert scores.mssd == pytest.approx(0.12 * diameter)
    assert scores.mssd_share == pytest.approx(0.8)
    # 3 pixels of an image 64 wide are 30 of one 640 wide: not below 5, 10 ... 30, but 35 to 50.
    assert scores.mspd is not None
    assert scores.mspd == pytest.approx(CAMERA.fx * 0.12 * diameter / 0.47)
    passed = (scores.mspd * 640 / 64 < np.arange(5, 51, 5)).sum()
    assert scores.mspd_share == pytest.approx(passed / 10)
    perfect = box_metric.scores(truth, truth, depth, CAMERA)
    assert (perfect.mssd_share, perfect.mspd_share, perfect.vsd_share) == (1, 1, 1)


def test_no_rotation_moves_a_sphere_in_mssd() -> None:
    tilts = [pose(Rotation.from_euler("x", a)) for a in (0.0, 0.5, 1.0)]
    ball = metric(meshes.sphere(0.02), tilts, np.array([0.0, 0, 1]))
    truth = seen_pose()
    T = pose(random_rotation(RNG), truth[:3, 3] + (0.003, 0.0, 0.004))
    assert ball.mssd(T, truth) == pytest.approx(0.005, rel=1e-6)


def render(scored: ObjectMetric, T: np.ndarray) -> np.ndarray:
    return DepthRenderer([scored.model.mesh]).render(CAMERA, T[None])[0]


def test_vsd_closed_forms(box_metric: ObjectMetric) -> None:
    truth = pose(translation=(0, 0, 0.5))
    depth = render(box_metric, truth)
    diameter = box_metric.model.mesh.diameter
    assert box_metric.vsd(truth, truth, depth, CAMERA) == pytest.approx(np.zeros(10))
    # Behind something: nothing of either pose can be seen.
    hidden = np.full_like(depth, 0.3)
    assert box_metric.vsd(truth, truth, hidden, CAMERA) == pytest.approx(np.ones(10))
    # Beside each other in the image: no pixel in common.
    aside = pose(translation=(0.1, 0, 0.5))
    assert box_metric.vsd(aside, truth, depth, CAMERA) == pytest.approx(np.ones(10))
    # Nearer by 0.12 diameters, both visible: the pixels in common agree from the third tolerance.
    nearer = pose(translation=(0, 0, 0.5 - 0.12 * diameter))
    found = box_metric.vsd(nearer, truth, depth, CAMERA)
    shown = render(box_metric, nearer) > 0
    assert found[:2] == pytest.approx(np.ones(2))
    assert found[2:] == pytest.approx(1 - (depth > 0).sum() / shown.sum(), abs=0.05)


def test_vsd_against_a_loop_over_the_pixels(box_metric: ObjectMetric) -> None:
    for _ in range(3):
        truth = seen_pose()
        T = truth @ exp(RNG.normal(size=6) * [0.3, 0.3, 0.3, 0.01, 0.01, 0.01])
        at_truth, at_estimate = render(box_metric, truth), render(box_metric, T)
        observed = np.where(RNG.random(at_truth.shape) < 0.2, 0, at_truth + 0.01)
        observed[:, 30:] = RNG.choice([0.4, 0.52, 0.6], size=observed[:, 30:].shape)
        expected = looped_vsd(observed, at_truth, at_estimate, box_metric.model.mesh.diameter)
        assert box_metric.vsd(T, truth, observed, CAMERA) == pytest.approx(expected)


def looped_vsd(observed: Any, truth: Any, estimate: Any, diameter: float) -> list[float]:
    def distance(depth: Any, v: int, u: int) -> float:
        ray = np.linalg.inv(CAMERA.matrix) @ (u, v, 1)
        return float(np.linalg.norm(depth[v, u] * ray))

    costs = []
    for tolerance in visible_surface.TOLERANCES:
        wrong = either = 0
        for v, u in np.ndindex(observed.shape):
            o, t, e = (distance(image, v, u) for image in (observed, truth, estimate))
            truth_visible = t > 0 and (o == 0 or t - o <= 0.015)
            estimate_visible = e > 0 and (o == 0 or e - o <= 0.015 or truth_visible)
            either += truth_visible or estimate_visible
            matched = truth_visible and estimate_visible and abs(t - e) < tolerance * diameter
            wrong += (truth_visible or estimate_visible) and not matched
        costs.append(wrong / either)
    return costs
