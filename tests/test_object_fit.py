from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh
import warp as wp
from hand_made import HIDDEN, MISSING, TOLERANCE, VIOLATION, view
from hand_view import CAMERA
from held_object import HeldObject, built_in_hand, built_in_object, held_object
from hypothesis import given, settings
from hypothesis import strategies as st
from probe_kernels import move, solve

from inhand.camera import Camera
from inhand.config import ClusteringConfig, EvidenceConfig, ObservationConfig, RefinementConfig
from inhand.geometry.mesh import box
from inhand.geometry.se3 import exp, inverse, random_rotation, transform
from inhand.kernels.depth import DepthRenderer
from inhand.kernels.launch import launch
from inhand.kernels.normal_equations import Matrix6, Vector6
from inhand.kernels.object_fit import ObjectEvidence
from inhand.object_model import ObjectModel
from inhand.packed import PackedObject, device_poses
from inhand.stages.evidence import Evidence, agreement, gather_evidence
from inhand.stages.observation import Observation, observe
from inhand.stages.refinement import fit_to_field, refine
from inhand.stages.results import HandState, PoseSet, Segment

# Algebra


@given(st.integers(0, 10_000), st.floats(0, 4))
@settings(max_examples=25, deadline=None)
def test_solve6_as_numpy(seed: int, decades: float) -> None:
    """Symmetric positive definite systems up to a condition number of 10^4."""
    rng = np.random.default_rng(seed)
    Q = np.linalg.qr(rng.normal(size=(20, 6, 6)))[0]
    A = np.einsum("nij,j,nkj->nik", Q, 10 ** np.linspace(0, decades, 6), Q)
    b = rng.normal(size=(20, 6))
    lower = np.tril(A)  # the upper half is not read
    x = wp.empty(20, dtype=Vector6, device="cpu")
    inputs = [wp.array(lower, dtype=Matrix6), wp.array(b, dtype=Vector6), x]
    launch(solve, 20, inputs, "cpu")
    expected = np.linalg.solve(A, b[..., None])[..., 0]
    error = np.linalg.norm(x.numpy() - expected, axis=1) / np.linalg.norm(expected, axis=1)
    assert error.max() < 1e-6 * 10**decades + 1e-5


@given(st.integers(0, 10_000), st.sampled_from([0.0, 1e-6, 0.1, 3.0]))
@settings(max_examples=25, deadline=None)
def test_moved_turns_about_the_pivot_then_shifts(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    T, x = exp(rng.normal(size=(10, 6))), size * rng.normal(size=(10, 6))
    pivot = rng.normal(size=(10, 3))
    out = wp.empty(10, dtype=wp.mat44, device="cpu")
    inputs = [device_poses(T, "cpu"), wp.array(x, dtype=Vector6), wp.array(pivot, dtype=wp.vec3)]
    launch(move, 10, [*inputs, out], "cpu")
    to_pivot = exp(np.concatenate([np.zeros((10, 3)), pivot], axis=1))
    expected = to_pivot @ exp(x) @ inverse(to_pivot) @ T
    np.testing.assert_allclose(out.numpy(), expected, atol=2e-6)


# Scores in situations made by hand

SMALL = Camera(fx=300, fy=300, cx=50, cy=40, width=101, height=81)
WALL = 0.5
SLAB = np.array([0.06, 0.05, 0.02])


@pytest.fixture(scope="module")
def slab() -> PackedObject:
    """A box whose large face, at z = -10 mm, is turned to the camera."""
    return PackedObject(ObjectModel.from_mesh(box(SLAB)), "cpu")


def at(z: float, x: float = 0.0) -> np.ndarray:
    """Pose of the slab with its front face at depth z."""
    return exp(np.array([[0, 0, 0, x, 0, z + SLAB[2] / 2]]))


def evidence_of(
    image: Any,
    hand_depth: float = 0.0,
    points: np.ndarray | None = None,
    normals: np.ndarray | None = None,
    weights: np.ndarray | None = None,
    share_weight: float = 0.0,
) -> Evidence:
    """Evidence of one image, one hand depth everywhere, and some segment points."""
    points = np.zeros((1, 3)) if points is None else points
    normals = np.zeros_like(points) if normals is None else normals
    weights = np.ones(len(points)) if weights is None else weights
    e = ObjectEvidence()
    e.view, e.hand_step = image, 1
    pixels = image.camera.width * image.camera.height
    e.hand_depth = wp.full(pixels, hand_depth, dtype=float, device="cpu")
    e.points, e.normals = (wp.array(x, dtype=wp.vec3) for x in (points, normals))
    e.weights = wp.array(weights, dtype=float)
    e.near, e.share_weight = 0.004, share_weight
    config = EvidenceConfig(violation=VIOLATION, missing=MISSING, hidden=HIDDEN)
    return Evidence(e, weights.astype(np.float32), built_in_hand(), nowhere(), config)


def nowhere() -> HandState:
    """The hand behind the camera, far away."""
    hand = built_in_hand()
    T = exp(np.array([0, 0, 0, 0, 0, -5.0]))
    return HandState(
        np.zeros(4), T, hand.link_poses(np.zeros((1, 4)), T[None])[0], np.ones(5, dtype=bool)
    )


FINE = ClusteringConfig(model_points=1000, segment_points=10_000, tolerance=TOLERANCE)


def scored(
    evidence: Evidence, obj: PackedObject, T: np.ndarray, worth: float = -np.inf, **samples: Any
) -> np.ndarray:
    found = agreement(evidence, obj, device_poses(T, "cpu"), replace(FINE, **samples), worth)
    return found.sum(axis=1)


def frontal_area(obj: PackedObject, z: float) -> float:
    """Score of the slab at depth z if every sample that faces the camera counts fully."""
    surface = obj.model.surface
    points = transform(at(z)[0], surface.points[:1000])
    facing = -(points * surface.normals[:1000]).sum(axis=1) / np.linalg.norm(points, axis=1)
    # A convex body shows a quarter of its surface on average.
    return float(facing[facing > 0.1].sum() / (0.25 * 1000))


def test_a_pose_that_lies_on_its_readings_scores_its_visible_area(slab: PackedObject) -> None:
    found = scored(evidence_of(view(SMALL, WALL)), slab, at(WALL))[0]
    assert found == pytest.approx(frontal_area(slab, WALL), rel=1e-3)


@pytest.mark.parametrize(
    ("depth", "judgement"),
    [(WALL + 3 * TOLERANCE, -VIOLATION), (WALL - 3 * TOLERANCE, -HIDDEN), (0.0, -MISSING * 0.7)],
    ids=["looked through", "hidden", "no readings"],
)
def test_every_visible_sample_is_judged(slab: PackedObject, depth: float, judgement: float) -> None:
    found = scored(evidence_of(view(SMALL, depth, missing=0.7)), slab, at(WALL))[0]
    assert found == pytest.approx(judgement * frontal_area(slab, WALL), rel=1e-3)


def test_what_the_hand_hides_is_not_held_against_a_pose(slab: PackedObject) -> None:
    image = view(SMALL, WALL - 0.1)
    assert scored(evidence_of(image, hand_depth=WALL - 0.1), slab, at(WALL))[0] == 0
    # The same readings without a hand there, or with the hand behind the object.
    for hand_depth in (0.0, WALL + 0.1):
        assert scored(evidence_of(image, hand_depth), slab, at(WALL))[0] < -0.1


def test_outside_the_image_nothing_is_judged(slab: PackedObject) -> None:
    evidence = evidence_of(view(SMALL, WALL))
    assert scored(evidence, slab, np.concatenate([at(WALL, x=2.0), at(-WALL)])).tolist() == [0, 0]


def surface_segment(obj: PackedObject, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals of the posed surface, away from its edges."""
    surface = obj.model.surface
    middle = (np.abs(surface.points) < SLAB / 2 - 0.003).sum(axis=1) == 2
    return transform(T, surface.points[middle]), surface.normals[middle] @ T[:3, :3].T


TURNED = exp(np.array([0.4, -0.9, 0.3, 0.05, -0.02, 0.6]))


def share_of(
    slab: PackedObject, points: np.ndarray, normals: np.ndarray, weights: np.ndarray | None = None
) -> float:
    """Explained share of a segment at `TURNED`; there are no readings in the image."""
    image = view(SMALL, 0.0, missing=0.0)
    evidence = evidence_of(image, 0.0, points, normals, weights, share_weight=1.0)
    return float(scored(evidence, slab, TURNED[None])[0])


def test_a_segment_on_the_surface_is_explained(slab: PackedObject) -> None:
    points, normals = surface_segment(slab, TURNED)
    assert share_of(slab, points, normals) == pytest.approx(1, abs=1e-3)
    shares = [share_of(slab, points + d * normals, normals) for d in (0.0, 0.001, 0.002, 0.0035)]
    assert (np.diff(shares) < 0).all()
    assert share_of(slab, points + 0.0045 * normals, normals) == pytest.approx(0, abs=1e-3)
    assert share_of(slab, points, -normals) == pytest.approx(0, abs=1e-3)


def test_the_explained_share_is_a_weighted_mean(slab: PackedObject) -> None:
    points, normals = surface_segment(slab, TURNED)
    away = points.copy()
    away[::2] += 1.0
    weights = np.random.default_rng(0).uniform(0.1, 1, len(points))
    expected = weights[1::2].sum() / weights.sum()
    for scale in (1, 10):
        found = share_of(slab, away, normals, scale * weights)
        assert found == pytest.approx(expected, abs=2e-3)


def test_fewer_samples_score_about_the_same() -> None:
    scene = held_object("industrial_part")
    evidence = gather_evidence(
        scene.observation, scene.hand_state, scene.segment, scene.hand, EvidenceConfig()
    )
    T = scene.T_camera_object @ exp(np.random.default_rng(0).normal(0, 0.004, (50, 6)))
    fine = scored(evidence, scene.obj, T, model_points=2000)
    coarse = scored(evidence, scene.obj, T, model_points=200, segment_points=100)
    assert np.corrcoef(fine, coarse)[0, 1] > 0.9
    too_many = scored(evidence, scene.obj, T, model_points=10**6, segment_points=10**6)
    np.testing.assert_allclose(too_many, fine, atol=1e-5)


def test_what_scores_enough_is_scored_in_full_and_the_rest_is_left_below() -> None:
    scene = held_object("industrial_part")
    evidence = gather_evidence(
        scene.observation, scene.hand_state, scene.segment, scene.hand, EvidenceConfig()
    )
    T = scene.T_camera_object @ exp(np.random.default_rng(0).normal(0, 0.006, (200, 6)))
    full = scored(evidence, scene.obj, T)
    for worth in np.quantile(full, (0.1, 0.5, 0.9)):
        found = scored(evidence, scene.obj, T, worth=worth)
        np.testing.assert_array_equal(found >= worth, full >= worth)
        np.testing.assert_array_equal(found[full >= worth], full[full >= worth])


# Refinement


def alone(name: str, seed: int) -> tuple[PackedObject, np.ndarray, Observation, Segment]:
    """An object without a hand: its model, true pose, image and segment."""
    obj = built_in_object(name)
    T = np.eye(4)
    T[:3, :3] = random_rotation(np.random.default_rng(seed))
    T[2, 3] = 0.5
    depth, _ = DepthRenderer([obj.model.mesh]).render(CAMERA, T[None])
    radius = obj.model.diameter / 2
    # Normals of small patches: a plane through a bent patch lies inside the object.
    config = ObservationConfig(normal_window=0.002)
    observation = observe(depth, CAMERA, T, (obj.model.centre, radius), 0.02, config, "cpu")
    n = len(observation.points)
    weights, distances = np.ones(n, dtype=np.float32), np.full(n, 0.02, dtype=np.float32)
    segment = Segment(observation.points, observation.normals, distances, weights)
    return obj, T, observation, segment


def starts(T: np.ndarray, count: int) -> PoseSet:
    """Poses 5 mm and 5 degrees off."""
    errors = np.random.default_rng(0).normal(size=(count, 2, 3))
    errors *= np.array([np.radians(5), 0.005])[:, None] / np.linalg.norm(errors, axis=2)[..., None]
    poses = T @ exp(errors.reshape(count, 6))
    return PoseSet(poses.astype(np.float32), np.arange(count, dtype=np.float32))


def fitted(start: PoseSet, evidence: Evidence, obj: PackedObject, points: int = 300) -> np.ndarray:
    """Poses, shape (m, 4, 4), after twelve iterations."""
    return fit_to_field(
        evidence, obj, 0.3, start.T_camera_object, points, iterations=12, widths=(0.010, 0.004)
    )[0]


def surface_error(obj: PackedObject, T: np.ndarray, T_true: np.ndarray) -> np.ndarray:
    """Mean distance [m] of the surface at poses (m, 4, 4) to the true one, shape (m,)."""
    points = obj.model.surface.points[:300]
    local = inverse(T_true) @ T.astype(np.float64)
    field = obj.model.distance_field
    return np.array([np.abs(field.distance(transform(x, points))).mean() for x in local])


@pytest.mark.parametrize(("name", "seed"), [("industrial_part", 0), ("cuboid", 0), ("can", 1)])
def test_poses_converge_to_the_truth(name: str, seed: int) -> None:
    obj, T, observation, segment = alone(name, seed)
    evidence = gather_evidence(observation, nowhere(), segment, built_in_hand(), EvidenceConfig())
    start = starts(T, 40)
    found = fitted(start, evidence, obj)
    assert np.median(surface_error(obj, start.T_camera_object, T)) > 0.002
    assert surface_error(obj, found, T).max() < 0.0003
    R = found[:, :3, :3]
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (40, 1, 1)), atol=1e-5)


def test_poses_are_no_worse_than_those_of_another_implementation() -> None:
    small_gicp = pytest.importorskip("small_gicp")
    obj, T, observation, segment = alone("industrial_part", 0)
    evidence = gather_evidence(observation, nowhere(), segment, built_in_hand(), EvidenceConfig())
    start = starts(T, 20)
    found = fitted(start, evidence, obj)
    mesh = trimesh.Trimesh(obj.model.mesh.vertices, obj.model.mesh.faces)
    target = small_gicp.PointCloud(np.asarray(mesh.sample(40_000, seed=0)))
    tree = small_gicp.KdTree(target)
    small_gicp.estimate_normals_covariances(target, tree, num_neighbors=8)
    source = small_gicp.PointCloud(segment.points.astype(np.float64))
    others = [
        small_gicp.align(
            target,
            source,
            tree,
            init_T_target_source=inverse(pose.astype(np.float64)),
            registration_type="PLANE_ICP",
            max_correspondence_distance=0.01,
        ).T_target_source
        for pose in start.T_camera_object
    ]
    ours = surface_error(obj, found, T)
    theirs = surface_error(obj, inverse(np.stack(others)), T)
    assert np.median(ours) < np.median(theirs) + 0.0001
    assert ours.max() < theirs.max() + 0.0001


def test_poses_converge_in_the_hand() -> None:
    """Parts of the object are hidden, and the readings around it are the hand's."""
    scene = held_object("industrial_part")
    evidence = evidence_in_hand(scene)
    found = fitted(starts(scene.T_camera_object, 40), evidence, scene.obj)
    error = surface_error(scene.obj, found, scene.T_camera_object)
    assert (error < 0.0006).mean() > 0.9


def test_the_stage_refines_the_best_of_what_is_distinct() -> None:
    """Starts around the truth come together and are one; those around another pose are others."""
    scene = held_object("industrial_part")
    evidence = evidence_in_hand(scene)
    elsewhere = scene.T_camera_object @ exp(np.array([0.0, 0.0, 1.5, 0.0, 0.0, 0.0]))
    around = [starts(T, 40).T_camera_object for T in (elsewhere, scene.T_camera_object)]
    start = PoseSet(np.concatenate(around), np.zeros(80, dtype=np.float32))
    found = refine(start, scene.segment, evidence, scene.obj, RefinementConfig())
    assert 2 <= len(found) <= RefinementConfig().keep
    assert (np.diff(found.score) <= 0).all()
    error = surface_error(scene.obj, found.T_camera_object, scene.T_camera_object)
    assert error[0] < 0.0006
    assert (error < 0.002).sum() < 10
    few = replace(RefinementConfig(), keep=3)
    kept = refine(start, scene.segment, evidence, scene.obj, few)
    np.testing.assert_array_equal(kept.T_camera_object, found.T_camera_object[:3])


def evidence_in_hand(scene: HeldObject) -> Evidence:
    return gather_evidence(
        scene.observation, scene.hand_state, scene.segment, scene.hand, EvidenceConfig()
    )


def test_refinement_does_not_depend_on_the_company() -> None:
    scene = held_object("cuboid")
    evidence = evidence_in_hand(scene)
    start = starts(scene.T_camera_object, 12)
    together = fitted(start, evidence, scene.obj)
    for k in (0, 7):
        found = fitted(start.take(np.array([k])), evidence, scene.obj)
        np.testing.assert_array_equal(found[0], together[k])


def test_more_points_than_the_model_has_are_all_of_them() -> None:
    scene = held_object("cuboid")
    start, evidence = starts(scene.T_camera_object, 3), evidence_in_hand(scene)
    all_points, more = (
        fitted(start, evidence, scene.obj, points=n) for n in (len(scene.obj.points), 10**7)
    )
    np.testing.assert_array_equal(all_points, more)


def test_a_pose_far_from_every_reading_stays() -> None:
    scene = held_object("cuboid")
    away = exp(np.array([[0.3, 0.2, 0.1, 0.0, 0.0, 2.0]]))
    start = PoseSet(away.astype(np.float32), np.zeros(1, dtype=np.float32))
    found = refine(start, scene.segment, evidence_in_hand(scene), scene.obj, RefinementConfig())
    np.testing.assert_allclose(found.T_camera_object, away, atol=1e-6)
