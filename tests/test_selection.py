import math
from dataclasses import replace

import numpy as np
import pytest
from held_object import CAMERA, HeldObject, held_object

from inhand.config import EvidenceConfig, ObservationConfig, SelectionConfig
from inhand.geometry.mesh import TriangleMesh
from inhand.geometry.se3 import exp, inverse, transform
from inhand.object_model import ObjectModel
from inhand.packed import PackedObject
from inhand.stages.confidence import readings_on
from inhand.stages.evidence import gather_evidence, score_with_contact
from inhand.stages.observation import observe
from inhand.stages.render_selection import select_by_rendering
from inhand.stages.results import PoseSet, Segment, Selection
from inhand.stages.selection import select

CONFIG = SelectionConfig()


def selected(scene: HeldObject, poses: np.ndarray, config: SelectionConfig = CONFIG) -> Selection:
    evidence = gather_evidence(
        scene.observation, scene.hand_state, scene.segment, scene.hand, EvidenceConfig()
    )
    return select(
        PoseSet(poses.astype(np.float32), np.zeros(len(poses), dtype=np.float32)),
        scene.observation,
        scene.hand_state,
        scene.segment,
        evidence,
        scene.hand,
        scene.obj,
        config,
    )


def around(scene: HeldObject, count: int, angle: float, distance: float) -> np.ndarray:
    """Poses around the true one, with errors of sd `angle` [rad] and `distance` [m] per axis."""
    motions = np.random.default_rng(0).normal(0, 1, (count, 6)) * ([angle] * 3 + [distance] * 3)
    return np.asarray(scene.T_camera_object @ exp(motions))


def surface_error(scene: HeldObject, T: np.ndarray) -> float:
    """Mean distance [m] of the posed surface to the true one."""
    local = inverse(scene.T_camera_object) @ T.astype(np.float64)
    points = scene.obj.model.surface.points[:200]
    return float(np.abs(scene.obj.model.distance_field.distance(transform(local, points))).mean())


@pytest.mark.parametrize("name", ["industrial_part", "cuboid", "cylinder"])
def test_the_truth_is_selected(name: str) -> None:
    scene = held_object(name)
    poses = around(scene, 80, 0.4, 0.01)
    poses[37] = scene.T_camera_object
    found = selected(scene, poses)
    assert surface_error(scene, found.T_camera_object[0]) < 0.001
    assert found.confidence > 0.5


def test_candidates_are_ranked_distinct_and_few() -> None:
    scene = held_object("industrial_part")
    poses = np.concatenate([around(scene, 40, 0.3, 0.01)] * 2)
    found = selected(scene, poses, replace(CONFIG, candidates=6))
    assert len(found.poses) == len(found.score) == len(found.T_camera_object) == 6
    assert (np.diff(found.score) <= 0).all()
    known = {T.tobytes() for T in poses.astype(np.float32)}
    kept = {T.tobytes() for T in found.T_camera_object}
    assert len(kept) == 6
    assert kept <= known


def test_symmetric_poses_are_one_candidate() -> None:
    """The cuboid looks the same after a quarter turn about its long axis."""
    scene = held_object("cuboid")
    turns = exp(np.pi / 2 * np.pad(np.arange(4.0)[:, None], ((0, 0), (2, 3))))
    found = selected(scene, scene.T_camera_object @ turns)
    assert len(found.poses) == 1


def test_the_confidence_does_not_depend_on_how_many_candidates_are_reported() -> None:
    scene = held_object("industrial_part")
    poses = around(scene, 40, 0.3, 0.01)
    one, many = (selected(scene, poses, replace(CONFIG, candidates=n)) for n in (1, 20))
    assert one.confidence == many.confidence
    np.testing.assert_array_equal(one.T_camera_object[0], many.T_camera_object[0])


def test_a_better_fit_is_more_certain() -> None:
    scene = held_object("industrial_part")
    shifts = np.array([0.0, 0.004, 0.012, 0.05])
    confidences = []
    for shift in shifts:
        T = scene.T_camera_object.copy()
        T[2, 3] -= shift
        confidences.append(selected(scene, T[None]).confidence)
    assert (np.diff(confidences) <= 0).all()
    assert 0.5 < confidences[0] <= 1
    assert 0 <= confidences[-1] < 0.2


def test_a_rival_makes_the_answer_less_certain() -> None:
    """The other pose lies elsewhere; the better it explains the image, the less is certain."""
    scene = held_object("industrial_part")
    true = scene.T_camera_object
    config = replace(CONFIG, max_lead=5.0, confidence_lead=1.0)
    others = true @ exp(np.array([[0, 0, 0, 0.001, 0, 0], [0.3, 0, 0, 0.02, 0, 0]]))
    far = exp(np.array([0, 0, 0, 0, 0, -0.1])) @ true
    alone, variant, rival, hopeless = (
        selected(scene, np.stack([true, *other]), config).confidence
        for other in ([], [others[0]], [others[1]], [far])
    )
    assert rival < hopeless < alone
    assert variant == alone


def test_a_pose_that_may_have_slid_is_less_certain() -> None:
    """A cuboid, the ends of which have no readings; only the drop at the probes counts."""
    scene, nothing = held_object("cuboid"), 1e-9
    config = replace(
        CONFIG,
        confidence_bias=0.0,
        confidence_visible=nothing,
        confidence_readings=nothing,
        confidence_misfit=nothing,
        confidence_contact=nothing,
        confidence_lead=nothing,
    )
    poses, segment = scene.T_camera_object[None], scene.segment
    local = transform(inverse(scene.T_camera_object), segment.points.astype(np.float64))
    along = local @ np.eye(3)[np.argmax(np.ptp(scene.obj.model.mesh.vertices, axis=0))]
    middle = np.abs(along - along.mean()) < 0.3 * np.ptp(along)
    # The image, too, ends where the segment does.
    u, v = np.rint(CAMERA.project(segment.points[~middle])).astype(int).T
    depth = scene.depth.copy()
    for du, dv in np.ndindex(13, 13):
        depth[v + dv - 6, u + du - 6] = 0
    hand = scene.hand.hand
    arguments = hand.reach, scene.obj.model.diameter, ObservationConfig(), "cpu"
    seen = observe(depth, CAMERA, scene.hand_state.T_camera_hand, *arguments)
    parts = (segment.points, segment.normals, segment.hand_distance, segment.weight)
    short = replace(scene, observation=seen, segment=Segment(*(part[middle] for part in parts)))
    sure, less = (selected(x, poses, config).confidence for x in (scene, short))
    drop, less_drop = (math.log(c / (1 - c)) / config.confidence_drop for c in (sure, less))
    assert 0.55 < drop < config.precision.max_drop + 1e-6
    assert 0.1 < less_drop < 0.85 * drop


def test_a_pose_within_the_hand_is_less_certain() -> None:
    """The same pose in the same image, with the hand's links where they run into it."""
    scene = held_object("industrial_part")
    links = scene.hand_state.T_camera_link.copy()
    links[:, :3, 3] += 0.3 * (scene.T_camera_object[:3, 3] - links[:, :3, 3])
    inside = replace(scene, hand_state=replace(scene.hand_state, T_camera_link=links))
    poses, blind = scene.T_camera_object[None], replace(CONFIG, confidence_contact=1e-6)
    assert selected(inside, poses).confidence < 0.5 * selected(inside, poses, blind).confidence


def test_readings_on_the_surface_and_how_far_off_they_are() -> None:
    """Points above the middle of a cuboid's face, whose distances are known."""
    scene = held_object("cuboid")
    heights = np.array([0.0, 0.0005, -0.001, 0.003, 0.02])
    local = np.tile(scene.obj.model.centre, (len(heights), 1))
    local[:, 2] = scene.obj.model.mesh.bounds[1, 2] + heights
    points = transform(scene.T_camera_object, local).astype(np.float32)
    weight = np.array([1, 1, 0.5, 0.5, 1], dtype=np.float32)
    segment = Segment(points, np.zeros_like(points), np.zeros_like(weight), weight)
    number, off = readings_on(segment, scene.T_camera_object, scene.obj, CONFIG)
    assert number == 3
    assert off == pytest.approx((0.0005 + 0.5 * 0.001 + 0.5 * 0.003) / 3, abs=2e-5)


def test_an_answer_that_rests_on_few_readings_is_less_certain() -> None:
    scene = held_object("industrial_part")
    whole = scene.segment
    few = Segment(
        whole.points[::40], whole.normals[::40], whole.hand_distance[::40], whole.weight[::40]
    )
    blind, poses = replace(CONFIG, confidence_readings=1e-6), scene.T_camera_object[None]

    def worth(segment: Segment) -> float:
        """Log odds that the number of readings is worth."""
        c, without = (
            selected(replace(scene, segment=segment), poses, config).confidence
            for config in (CONFIG, blind)
        )
        return math.log(c / (1 - c)) - math.log(without / (1 - without))

    number = few.weight.sum()
    assert 1 < number < CONFIG.max_readings < whole.weight.sum()
    assert worth(whole) == pytest.approx(
        CONFIG.confidence_readings * math.log(CONFIG.max_readings), abs=1e-3
    )
    assert worth(few) == pytest.approx(CONFIG.confidence_readings * math.log(number), abs=0.1)


def test_the_hand_says_how_far_off_the_surface_readings_may_be() -> None:
    scene = held_object("industrial_part")
    shift = exp(np.array([0, 0, 0, 0, 0, 0.002])) @ scene.T_camera_object
    exact, rough = (
        replace(scene, segment=replace(scene.segment, hand_misfit=off)) for off in (0.0, 0.002)
    )
    strict, lenient = (selected(x, shift[None]).confidence for x in (exact, rough))
    assert strict < lenient
    blind = selected(exact, shift[None], replace(CONFIG, confidence_misfit=1e-9)).confidence
    assert lenient == pytest.approx(blind, rel=1e-6)


def test_the_model_of_a_larger_object_is_less_certain() -> None:
    """The true pose, where a surface that is off counts and where it does not."""
    scene = held_object("industrial_part")
    model = scene.obj.model
    vertices = model.centre + 1.1 * (model.mesh.vertices - model.centre)
    mesh = TriangleMesh(vertices, model.mesh.faces)
    larger = PackedObject(ObjectModel.from_mesh(mesh), "cpu")
    other, blind = replace(scene, obj=larger), replace(CONFIG, confidence_misfit=1e-6)
    poses = scene.T_camera_object[None]
    right, wrong, wrong_if_blind = (
        selected(x, poses, config).confidence
        for x, config in ((scene, CONFIG), (other, CONFIG), (other, blind))
    )
    assert wrong < 0.5 * wrong_if_blind
    assert wrong < 0.5 * right


def test_no_pose_gives_no_confidence() -> None:
    found = selected(held_object("cuboid"), np.zeros((0, 4, 4)))
    assert len(found.poses) == 0
    assert found.confidence == 0


def test_the_ranking_is_by_fit_and_contact() -> None:
    scene = held_object("industrial_part")
    poses = around(scene, 30, 0.3, 0.01)
    found = selected(scene, poses, replace(CONFIG, candidates=30, merge_distance=0.0))
    evidence = gather_evidence(
        scene.observation, scene.hand_state, scene.segment, scene.hand, EvidenceConfig()
    )
    T = poses.astype(np.float32)
    expected = score_with_contact(evidence, scene.obj, T, CONFIG, near=CONFIG.near)
    np.testing.assert_array_equal(found.score, np.sort(expected)[::-1])


def test_the_method_of_the_paper_can_be_chosen() -> None:
    scene = held_object("cuboid")
    poses, config = around(scene, 30, 0.3, 0.01), SelectionConfig(method="render")
    found = selected(scene, poses, config)
    given = PoseSet(poses.astype(np.float32), np.zeros(30, dtype=np.float32))
    expected = select_by_rendering(
        given, scene.observation, scene.hand_state, scene.hand, scene.obj, scene.segment, config
    )
    np.testing.assert_array_equal(found.T_camera_object, expected.T_camera_object)
    np.testing.assert_array_equal(found.score, expected.score)
    assert 0 <= found.confidence <= 1
