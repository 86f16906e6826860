"""How precisely an image determines a pose: against samples and where the answer is plain."""

import numpy as np
import pytest
from hand_view import CAMERA
from held_object import HeldObject, built_in_hand, built_in_object, held_object
from hypothesis import given, settings
from hypothesis import strategies as st

from inhand.config import EvidenceConfig, ObservationConfig, PrecisionConfig
from inhand.geometry.se3 import exp, inverse, moved, random_rotation, transform
from inhand.kernels.depth import DepthRenderer
from inhand.packed import PackedObject
from inhand.stages.evidence import Evidence, gather_evidence
from inhand.stages.observation import observe
from inhand.stages.precision import LOOSE, loosest_twists, probes
from inhand.stages.refinement import fit_to_field
from inhand.stages.results import HandState, Segment

CONFIG = PrecisionConfig()


def evidence_of(scene: HeldObject) -> Evidence:
    return gather_evidence(
        scene.observation, scene.hand_state, scene.segment, scene.hand, EvidenceConfig()
    )


@given(st.integers(0, 10_000))
@settings(max_examples=20)
def test_the_twists_are_the_axes_of_what_the_surface_may_do(seed: int) -> None:
    obj, rng = built_in_object("industrial_part").model, np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = random_rotation(rng), rng.normal(size=3)
    root = rng.normal(size=(6, 6)) * ([20.0] * 3 + [1000.0] * 3)
    information = root.T @ root
    twists, sds = loosest_twists(information, obj, T)
    turn = np.kron(np.eye(2), T[:3, :3])
    form = turn @ obj.surface_form @ turn.T
    assert (np.diff(sds) <= 0).all()
    np.testing.assert_allclose(twists @ form @ twists.T, np.eye(6), atol=1e-6)
    # Independent of each other, and each with its sd.
    scaled = sds[:, None] * twists
    np.testing.assert_allclose(scaled @ information @ scaled.T, np.eye(6), atol=1e-6)
    assert (sds**2).sum() == pytest.approx(np.trace(form @ np.linalg.inv(information)), rel=1e-6)
    # No other twist that is as likely moves the surface farther.
    others = rng.normal(size=(1000, 6)) @ np.linalg.inv(root).T
    likely = np.einsum("ni,ij,nj->n", others, information, others)
    way = np.einsum("ni,ij,nj->n", others, form, others)
    assert (way / likely).max() <= sds[0] ** 2 * (1 + 1e-6)


def test_what_does_not_move_the_surface_is_not_loose() -> None:
    """The turn of a can about its axis, of which as little is known as of other turns."""
    obj = built_in_object("cylinder").model
    axis = np.concatenate([np.asarray(obj.symmetry.axis), np.zeros(3)])
    information = np.diag([100.0] * 3 + [1e6] * 3)
    twists, sds = loosest_twists(information, obj, np.eye(4))
    assert sds[-1] < 0.05 * sds[0]
    for twist in twists[:LOOSE]:  # a probe turns the can by less than a degree
        assert abs(CONFIG.probe * twist @ axis) < 0.01


@pytest.mark.parametrize("name", ["industrial_part", "cuboid", "cylinder", "bottle"])
def test_probes_lie_to_both_sides_and_move_the_surface_as_far(name: str) -> None:
    scene = held_object(name)
    T, model = scene.T_camera_object, scene.obj.model
    around = probes(T, evidence_of(scene), scene.obj, CONFIG)
    assert around.shape == (2 * LOOSE, 4, 4)
    points, normals = model.surface.points, model.surface.normals
    for probe, other in zip(around[:LOOSE], around[LOOSE:], strict=True):
        ways = [transform(inverse(T) @ pose, points) - points for pose in (probe, other)]
        along = [np.einsum("ni,ni->n", way, normals) for way in ways]
        for x in along:
            assert np.sqrt(np.mean(x**2)) == pytest.approx(CONFIG.probe, rel=0.15)
        assert np.mean(along[0] * along[1]) < -0.8 * CONFIG.probe**2


def face_on(name: str) -> tuple[PackedObject, np.ndarray, Evidence]:
    """An object without a hand, one of whose faces looks at the camera; nothing else shows."""
    obj = built_in_object(name)
    T = np.eye(4)
    T[:3, 3] = [0, 0, 0.5] - obj.model.centre
    depth, _ = DepthRenderer([obj.model.mesh]).render(CAMERA, T[None])
    reach = obj.model.centre, obj.model.diameter / 2
    observation = observe(depth, CAMERA, T, reach, 0.02, ObservationConfig(), "cpu")
    n = len(observation.points)
    ones = np.ones(n, dtype=np.float32)
    segment = Segment(observation.points, observation.normals, 0.02 * ones, ones)
    hand = built_in_hand()
    away = np.tile(exp(np.array([0, 0, 0, 0, 0, -5.0])), (len(hand.hand.links), 1, 1))
    certain = np.zeros(len(away), dtype=bool)
    state = HandState(np.zeros(len(hand.hand.joint_names)), np.eye(4), away, certain)
    return obj, T, gather_evidence(observation, state, segment, hand, EvidenceConfig())


def test_a_box_is_loose_along_the_face_that_is_seen() -> None:
    """Depth to it and its two tilts are known; that it slides or spins, no depth tells."""
    obj, T, evidence = face_on("cuboid")
    around = probes(T, evidence, obj, CONFIG)
    points = obj.model.surface.points
    face = points[points[:, 2] < points[:, 2].min() + 1e-4]
    assert len(face) > 100
    for probe in around:
        way = transform(probe, face) - transform(T, face)
        assert np.abs(way[:, 2]).max() < 0.1 * np.linalg.norm(way, axis=1).max()


def test_the_system_foretells_what_a_small_motion_changes() -> None:
    """Its matrix is how its right-hand side falls with a twist about the object's centre."""
    scene = held_object("industrial_part")
    evidence = evidence_of(scene)
    T, centre = scene.T_camera_object, scene.obj.model.centre
    small = np.diag([0.01] * 3 + [0.0005] * 3)
    poses = np.concatenate([T[None], moved(T, small, centre)])
    # Wide, so that weights hardly change.
    _, A, b = fit_to_field(evidence, scene.obj, 0.3, poses, 10**6, 1, (0.05, 0.05))
    size = np.sqrt(np.diag(A[0]))
    fallen = (b[0] - b[1:]) / np.diag(small)[:, None] / size / size[:, None]
    np.testing.assert_allclose(fallen, A[0] / size / size[:, None], atol=0.35)


def test_the_system_is_of_the_pose_before_the_last_step() -> None:
    scene = held_object("cuboid")
    evidence = evidence_of(scene)
    start = moved(scene.T_camera_object, np.array([0.02, 0, 0, 0.001, 0, 0.001]), np.zeros(3))
    once, first, _ = fit_to_field(evidence, scene.obj, 0.3, start[None], 300, 1, (0.01, 0.01))
    _, second, _ = fit_to_field(evidence, scene.obj, 0.3, start[None], 300, 2, (0.01, 0.01))
    _, there, _ = fit_to_field(evidence, scene.obj, 0.3, once, 300, 1, (0.01, 0.01))
    np.testing.assert_array_equal(second, there)
    assert not np.array_equal(first, second)
