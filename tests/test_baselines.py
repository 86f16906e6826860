"""Every method finds the object in an easy scene, and behaves as the interface says."""

import importlib
import math
from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import warp as wp
from held_object import CAMERA, HeldObject, held_object
from numpy.typing import NDArray

from inhand.baselines import registry
from inhand.baselines.estimators import ablation
from inhand.baselines.from_truth import FromTruth
from inhand.baselines.front_end import masked_cloud
from inhand.baselines.icp import rank, refine_by_icp
from inhand.baselines.method import Method, View, view_of
from inhand.baselines.registry import find_methods, method_names
from inhand.baselines.super4pcs import FARTHEST_CROSSING, Settings, Super4PCS
from inhand.baselines.views import spread_directions
from inhand.config import EstimatorConfig
from inhand.datasets.frame import Frame, Truth
from inhand.errors import InputError, NoAnswer
from inhand.estimate import PoseEstimate
from inhand.geometry import se3
from inhand.stages.congruent_sets import Bases
from inhand.stages.observation import Cloud

FROM_TRUTH = "icp-from-truth@10mm@10deg"


@cache
def scene() -> HeldObject:
    return held_object("bottle")


@cache
def mask() -> NDArray[np.bool_]:
    """The pixels that show the object, shape (H, W)."""
    alone, _ = scene().obj.renderer.render(CAMERA, scene().T_camera_object[None])
    return np.asarray((alone > 0) & (np.abs(alone - scene().depth) < 1e-4))


@cache
def view() -> View:
    s = scene()
    T_camera_hand = s.hand_state.T_camera_hand
    return View(
        s.depth,
        CAMERA,
        T_camera_hand,
        true_mask=mask(),
        true_T_camera_object=s.T_camera_object,
    )


def visible() -> Cloud:
    return Cloud(scene().segment.points, scene().segment.normals)


def find(name: str) -> Method:
    """The method; the test is skipped where its library cannot be imported."""
    library = registry.REGISTRATIONS.get(name.split("+")[0], (None, None))[1]
    if library:
        try:
            importlib.import_module(library.module)
        except (ImportError, OSError) as error:
            pytest.skip(f"{library.module} cannot be imported here: {error}")
    (method,) = find_methods(name)
    return method


def run(name: str, *views: View, of: HeldObject | None = None) -> list[PoseEstimate]:
    of = of or scene()
    prepared = find(name).prepare(of.hand.hand, of.obj.model, "cpu")
    return [prepared.estimate(v) for v in views or (view(),)]


def error(T_camera_object: Any, of: HeldObject | None = None) -> float:
    """Mean distance [m] of the true surface from the posed model's: symmetric poses are one."""
    of = of or scene()
    points = of.obj.model.surface.points.astype(np.float64)
    moved = se3.inverse(T_camera_object) @ of.T_camera_object
    field = of.obj.model.distance_field
    return float(np.abs(field.distance(se3.transform(moved, points))).mean())


@pytest.mark.parametrize("source", ["+hs", "+mask"])
@pytest.mark.parametrize("base", list(registry.REGISTRATIONS))
def test_a_registration_finds_the_object_without_the_hand(base: str, source: str) -> None:
    estimate, again = run(base + source, view(), view())
    assert estimate.found
    assert estimate.T_camera_object is not None
    # Without ICP, the distance between the model's sampled points limits the accuracy.
    if base + source != "opencv-ppf+hs":  # remains of the hand mislead it, see below
        assert error(estimate.T_camera_object) < (0.004 if base == "super4pcs" else 0.0005)
    np.testing.assert_array_equal(estimate.T_camera_object, estimate.candidates[0].T_camera_object)
    if base != "fpfh-ransac":  # Open3D's threads race for the best sample: a symmetric twin may win
        np.testing.assert_array_equal(estimate.T_camera_object, again.T_camera_object)
    assert estimate.confidence > 0.5
    assert bool(estimate.joint_positions) == (estimate.T_camera_hand is not None)
    assert bool(estimate.joint_positions) == (source == "+hs")
    assert ("hand_state" in estimate.timings) == (source == "+hs")
    assert ("icp" in estimate.timings) == (base != "super4pcs")


@pytest.mark.parametrize("aside", [-0.02, 0.0, 0.02])
def test_opencv_finds_a_bottle_without_the_hand(aside: float) -> None:
    # Remains of the hand pull at other objects: which of these places it finds a can or an
    # industrial part at changes with the segment's sampling.
    bottle = held_object("bottle", aside)
    seen = View(bottle.depth, CAMERA, bottle.hand_state.T_camera_hand)
    (estimate,) = run("opencv-ppf+hs", seen, of=bottle)
    assert estimate.T_camera_object is not None
    assert error(estimate.T_camera_object, of=bottle) < 0.0005


@pytest.mark.parametrize("name", ["inhand", "paper", "super4pcs+hs+icp", FROM_TRUTH])
def test_a_method_finds_the_object(name: str) -> None:
    (estimate,) = run(name)
    assert estimate.found
    assert error(estimate.T_camera_object) < 0.0005


@pytest.mark.parametrize("name", ["super4pcs+icp", "fpfh-ransac", "ablation-baseline"])
def test_methods_that_see_the_hand_too_give_some_pose(name: str) -> None:
    (estimate,) = run(name)
    assert estimate.found
    se3.check_rigid(estimate.T_camera_object, "T_camera_object")


def test_stages_are_told_where_there_are_some() -> None:
    prepared = find("super4pcs+hs+icp").prepare(scene().hand.hand, scene().obj.model, "cpu")
    estimate, stages = prepared.run(view())
    assert stages is not None
    assert stages.segment is not None
    assert stages.hypotheses is not None
    assert stages.refined is not None
    assert error(stages.refined.T_camera_object[0]) < error(stages.hypotheses.T_camera_object[0])
    assert stages.selection is not None
    np.testing.assert_array_equal(stages.selection.T_camera_object[0], estimate.T_camera_object)
    masked = find("super4pcs+mask").prepare(scene().hand.hand, scene().obj.model, "cpu")
    assert masked.run(view())[1] is None


@pytest.mark.parametrize("name", ["super4pcs", "super4pcs+hs", "super4pcs+mask"])
def test_an_image_without_an_answer_is_no_error(name: str) -> None:
    empty = replace(view(), depth=np.zeros_like(view().depth))
    (estimate,) = run(name, empty)
    assert not estimate.found
    assert "readings" in estimate.reason
    assert estimate.T_camera_object is None


@pytest.mark.parametrize(
    ("name", "missing", "words"),
    [("super4pcs+mask", "true_mask", "true mask"), (FROM_TRUTH, "true_T_camera_object", "pose")],
)
def test_a_view_that_lacks_what_the_method_needs_is_an_error(
    name: str, missing: str, words: str
) -> None:
    blind: dict[str, Any] = {missing: None}
    with pytest.raises(InputError, match=words):
        run(name, replace(view(), **blind))


# Names


def test_names() -> None:
    (method,) = find_methods("super4pcs+hs")
    assert (method.name, method.label, dict(method.perturbation)) == ("super4pcs+hs",) * 2 + ({},)
    steps = [m.label for m in find_methods("paper, ablation,inhand,paper")]
    assert steps == ["paper", *ablation(), "inhand"], "each once, in this order"
    curves = find_methods("icp-from-truth")
    assert {m.name for m in curves} == {"icp-from-truth"}
    assert curves[0].perturbation == {"translation": 0.0}
    for method in curves:
        (again,) = find_methods(method.label)
        assert again.perturbation == method.perturbation
    (both,) = find_methods("icp-from-truth+mask@5mm@10deg")
    assert both.name == "icp-from-truth+mask"
    assert both.perturbation == pytest.approx({"translation": 0.005, "rotation": math.radians(10)})


def test_every_name_is_found() -> None:
    for name in method_names():
        if name.split("+")[0] not in registry.REGISTRATIONS or name.startswith("super4pcs"):
            assert find_methods(name), name
    assert {"fgr", "fgr+hs", "fgr+mask", "super4pcs+icp+mask"} <= set(method_names())


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ("magic", 'no method "magic"; known: inhand, paper'),
        ("super4pcs+magic", "no method"),
        (" ,", "at least one method"),
        ("icp-from-truth@5", "5mm or 10deg"),
        ("icp-from-truthful", "no method"),
    ],
)
def test_unknown_names_are_refused(names: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        find_methods(names)


def test_a_missing_library_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(name: str) -> None:
        raise problem[name]

    problem = {
        "open3d": ModuleNotFoundError("No module named 'open3d'", name="open3d"),
        "kiss_matcher": ImportError("libstdc++ is too old"),
    }
    monkeypatch.setattr(importlib, "import_module", refuse)
    with pytest.raises(InputError) as first:
        find_methods("fgr+hs")
    line = 'the method fgr+hs needs open3d, which is not installed: pip install "inhand[bench]"'
    assert str(first.value) == line
    with pytest.raises(InputError) as second:  # installing it once more would not help
        find_methods("kiss-matcher")
    line = (
        "the method kiss-matcher needs kiss_matcher, which does not load here: libstdc++ is too old"
    )
    assert str(second.value) == line


def test_the_ablation_leads_from_the_baseline_over_the_paper_to_the_default() -> None:
    steps = list(ablation().values())
    assert steps[4] == EstimatorConfig.paper()
    assert steps[-1] == EstimatorConfig()
    assert all(a != b for a, b in pairwise(steps))


# Views


def test_a_view_has_what_the_frame_tells() -> None:
    s = scene()
    label = np.where(mask(), 2, 1).astype(np.uint8)
    truth = Truth(s.hand_state.T_camera_hand, s.T_camera_object, {}, label, 0.5)
    rgb = np.zeros((*label.shape, 3), dtype=np.uint8)
    frame = Frame("set/1", "bottle", s.depth, CAMERA, s.hand_state.T_camera_hand, truth, rgb)
    made = view_of(frame)
    assert made.rgb is rgb
    np.testing.assert_array_equal(made.true_mask, mask())
    assert made.object_box is not None
    u0, v0, u1, v1 = made.object_box
    inside = np.zeros_like(label, dtype=bool)
    inside[v0:v1, u0:u1] = True
    assert not (mask() & ~inside).any()
    assert all(
        edge.any() for edge in (mask()[v0], mask()[v1 - 1], mask()[:, u0], mask()[:, u1 - 1])
    )
    hidden = replace(frame, truth=replace(truth, label=np.ones_like(label)))
    assert view_of(hidden).object_box is None


def test_the_mask_takes_its_pixels_points() -> None:
    s, config = scene(), EstimatorConfig()
    points = masked_cloud(s.observation, mask(), config).points
    field = s.obj.model.distance_field
    on_object = field.distance(se3.transform(se3.inverse(s.T_camera_object), points))
    assert np.abs(on_object).max() < 0.003
    assert len(points) == pytest.approx(len(s.segment.points), rel=0.02)
    few = mask() & (np.cumsum(mask()).reshape(mask().shape) <= 200)
    assert len(masked_cloud(s.observation, few, config).points) > 150, "every pixel of a small mask"
    with pytest.raises(NoAnswer, match="show the object"):
        masked_cloud(s.observation, np.zeros_like(mask()), config)


# ICP


def test_the_perturbation_is_as_large_as_told() -> None:
    s = scene()
    centre = s.obj.model.centre[None]
    moved_ways, turned_ways = [], []
    for seed in range(3):
        T = FromTruth(s.obj, seed, {"translation": 0.02, "rotation": 0.3}).align(visible(), view())
        shift = se3.transform(T[0], centre) - se3.transform(s.T_camera_object, centre)
        assert np.linalg.norm(shift) == pytest.approx(0.02)
        assert se3.rotation_angle(T[0, :3, :3], s.T_camera_object[:3, :3]) == pytest.approx(0.3)
        moved_ways.append(shift[0] / 0.02)
        turned_ways.append(T[0, :3, :3])
    assert abs(moved_ways[0] @ moved_ways[1]) < 0.99
    assert se3.rotation_angle(turned_ways[0], turned_ways[1]) > 0.01
    other = replace(view(), depth=view().depth + np.float32(1e-3))
    frames = [
        FromTruth(s.obj, 0, {"translation": 0.02}).align(visible(), v) for v in (view(), other)
    ]
    assert np.linalg.norm(frames[0] - frames[1]) > 0.001, "each image has its own directions"
    unmoved = FromTruth(s.obj, 0, {}).align(visible(), view())
    np.testing.assert_allclose(unmoved[0], s.T_camera_object, atol=1e-9)


def test_icp_pulls_poses_onto_the_cloud_and_the_best_comes_first() -> None:
    s = scene()
    far = s.T_camera_object @ se3.exp(np.array([0, 0, 2.0, 0.1, 0, 0]))
    near = s.T_camera_object @ se3.exp(np.array([0.1, -0.1, 0.1, 0.005, -0.005, 0.008]))
    refined = refine_by_icp(np.stack([far, near]), visible(), s.obj)
    assert error(refined[1]) < 0.0005 < error(near)
    ranked = rank(refined, visible(), s.obj)
    np.testing.assert_allclose(ranked.T_camera_object[0], refined[1], atol=1e-6)
    assert ranked.score[0] > 0.95 > ranked.score[1]


# Super4PCS


@cache
def sampled() -> tuple[Super4PCS, Any, Bases]:
    search = Super4PCS(scene().obj, 0, Settings(bases=20, model_points=60, sets_per_base=10**6))
    points = wp.array(scene().segment.points, dtype=wp.vec3, device="cpu")
    return search, points, search.sample_bases(points, np.random.default_rng(0))


def test_bases_are_wide_flat_and_cross() -> None:
    search, points, bases = sampled()
    assert len(bases.points) == 20
    p = points.numpy().astype(np.float64)[bases.points]
    widest = search.settings.overlap * scene().obj.model.diameter
    for base, ratios in zip(p, bases.ratios, strict=True):
        # The first point stays in its place when the points are paired; the fourth may be second.
        assert min(height(base[[0, 2, 3]], base[1]), height(base[:3], base[3])) < search.delta
        assert np.linalg.norm(base[1:] - base[0], axis=1).max() < widest
        assert max(area(base[[0, 2, 3]]), area(base[:3])) > 0.1 * widest**2
        assert np.abs(ratios - 0.5).max() < FARTHEST_CROSSING
        one, other = (
            base[i] + r * (base[i + 1] - base[i]) for i, r in zip((0, 2), ratios, strict=True)
        )
        assert np.linalg.norm(one - other) < 2 * search.delta
    assert len({tuple(x) for x in bases.points.tolist()}) > 15


def area(triangle: Any) -> float:
    """Area of a triangle, shape (3, 3)."""
    return float(np.linalg.norm(np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])) / 2)


def height(triangle: Any, point: Any) -> float:
    """Distance of a point from the plane of a triangle: six volumes over two areas."""
    return float(abs(np.linalg.det(triangle - point)) / (2 * area(triangle)))


def test_congruent_sets_are_those_of_a_brute_force_search() -> None:
    """Up to sets on the border of a tolerance, where single precision decides."""
    search, points, bases = sampled()
    sets = search.extract(points, bases)
    total = 0
    for k in range(len(bases.points)):
        found = {tuple(x) for x in sets.points[sets.base == k].tolist()}
        assert len(found) == (sets.base == k).sum()
        certain, possible = (brute_force(bases, k, slack) for slack in (-1e-6, 1e-6))
        assert certain <= found <= possible
        total += len(certain)
    assert total > 200


def brute_force(bases: Bases, k: int, slack: float) -> set[tuple[int, ...]]:
    search, points, _ = sampled()
    delta, angle = search.delta + slack, search.settings.angle + 1e3 * slack
    base = points.numpy().astype(np.float64)[bases.points[k]]
    model = scene().obj.model.surface.points[: search.settings.model_points].astype(np.float64)
    i, j = np.nonzero(~np.eye(len(model), dtype=bool))
    line = model[j] - model[i]
    length = np.linalg.norm(line, axis=1)
    u, v = base[1] - base[0], base[3] - base[2]
    first, second = (
        np.flatnonzero(np.abs(length - np.linalg.norm(side)) <= delta) for side in (u, v)
    )
    a, b = (x.ravel() for x in np.meshgrid(first, second, indexing="ij"))
    middles = [model[i[x]] + r * line[x] for x, r in zip((a, b), bases.ratios[k], strict=True)]
    cosine = (line[a] * line[b]).sum(axis=1) / length[a] / length[b]
    wanted = np.arccos(u @ v / np.linalg.norm(u) / np.linalg.norm(v))
    good = np.linalg.norm(middles[0] - middles[1], axis=1) <= delta
    good &= np.abs(np.arccos(np.clip(cosine, -1, 1)) - wanted) <= angle
    return {tuple(x) for x in np.stack([i[a], j[a], i[b], j[b]], axis=1)[good].tolist()}


def test_of_many_sets_an_even_choice_is_kept() -> None:
    search, points, bases = sampled()
    everything = search.extract(points, bases)
    few = Super4PCS(scene().obj, 0, replace(search.settings, sets_per_base=10))
    limited = few.extract(points, bases)
    for k in range(len(bases.points)):
        total, kept = (s.points[s.base == k].tolist() for s in (everything, limited))
        assert len(kept) == min(10, len(total))
        assert {tuple(x) for x in kept} <= {tuple(x) for x in total}


def test_points_that_no_object_of_this_size_has_give_no_answer() -> None:
    flat = np.array([[0, 0, 1], [0.5, 0, 1], [0, 0.5, 1], [0.5, 0.5, 1]], dtype=np.float32)
    cloud = Cloud(flat, np.tile(np.array([0, 0, -1], dtype=np.float32), (4, 1)))
    with pytest.raises(NoAnswer, match="four points"):
        Super4PCS(scene().obj, 0).align(cloud, view())


def test_directions_are_spread_evenly() -> None:
    directions = spread_directions(100)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)
    np.testing.assert_allclose(directions.mean(axis=0), 0, atol=0.01)
    cosine = directions @ directions.T - 2 * np.eye(100)
    nearest = np.arccos(cosine.max(axis=1))
    assert nearest.min() > 0.8 * nearest.max()
