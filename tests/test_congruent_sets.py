from dataclasses import replace
from functools import cache
from itertools import permutations

import numpy as np
import pytest
from held_object import built_in_object, held_object

from inhand.config import HypothesesConfig
from inhand.errors import NoAnswer
from inhand.geometry.sampling import SurfaceSamples
from inhand.geometry.se3 import inverse, transform
from inhand.packed import PackedObject
from inhand.pair_table import build_pair_table, pair_features
from inhand.stages.congruent_sets import (
    Bases,
    CongruentSetSearch,
    generate_from_congruent_sets,
)
from inhand.stages.results import Segment

CONFIG = HypothesesConfig(method="congruent_sets")
EVERYTHING = replace(CONFIG, max_pairs_per_base=10**6, max_sets_per_base=10**6)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


# Bases


@cache
def sampled() -> tuple[Segment, Bases]:
    scene = held_object("industrial_part")
    search = CongruentSetSearch(scene.segment, scene.obj, CONFIG)
    return scene.segment, search.sample_bases(rng())


def known_features() -> set[tuple[int, ...]]:
    """Discretised features of all pairs of the model's tabled points."""
    model = built_in_object("industrial_part").model
    table, surface = model.pairs, model.surface
    i, j = table.pair_first, table.pair_second
    features = pair_features(
        surface.points[i], surface.normals[i], surface.points[j], surface.normals[j]
    )
    return set(map(tuple, discretised(features)))


def discretised(features: np.ndarray) -> np.ndarray:
    table = built_in_object("industrial_part").model.pairs
    bins = np.floor(features / [table.distance_step, *[np.pi / table.n_angle] * 3]).astype(int)
    return np.minimum(bins, [table.n_distance - 1, *[table.n_angle - 1] * 3])


def test_bases_meet_the_constraints_of_the_algorithm() -> None:
    segment, bases = sampled()
    assert len(bases.points) > 0.8 * CONFIG.bases
    known = known_features()
    for base in bases.points:
        assert len(set(base.tolist())) == 4
        p, n = segment.points[base].astype(np.float64), segment.normals[base].astype(np.float64)
        # The first point stays in its place when the points are paired, the fourth may be second.
        assert any(
            flat_and_wide(p[[0, b, c, d]]) for b, c, d in permutations([1, 2, 3]) if d in (1, 3)
        )
        for i in range(4):
            for j in range(i):
                features = pair_features(p[[i, j]], n[[i, j]], p[[j, i]], n[[j, i]])
                assert any(tuple(f) in known for f in discretised(features))


def flat_and_wide(p: np.ndarray) -> bool:
    """Whether the fourth point is near the plane of the others and the angle at the first large."""
    u, v = ((x - p[0]) / np.linalg.norm(x - p[0]) for x in p[1:3])
    normal = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
    flat = abs(normal @ (p[3] - p[0])) <= CONFIG.coplanarity + 1e-6
    return bool(flat and abs(u @ v) <= np.cos(CONFIG.min_angle) + 1e-6)


def test_the_lines_of_a_bases_pairs_cross_at_the_ratios() -> None:
    segment, bases = sampled()
    p = segment.points[bases.points].astype(np.float64)
    first = p[:, 0] + bases.ratios[:, :1] * (p[:, 1] - p[:, 0])
    second = p[:, 2] + bases.ratios[:, 1:] * (p[:, 3] - p[:, 2])
    gap = np.linalg.norm(first - second, axis=1)
    assert np.median(gap) < CONFIG.coplanarity
    assert np.abs(bases.ratios - 0.5).max() < 1.1
    # They come nearest there: the gap is square to both lines.
    for a, b in ((0, 1), (2, 3)):
        along = (p[:, b] - p[:, a]) / np.linalg.norm(p[:, b] - p[:, a], axis=1)[:, None]
        assert np.abs(((first - second) * along).sum(axis=1)).max() < 1e-4


def test_points_near_the_hand_are_sampled_rarely_and_points_in_it_never() -> None:
    scene = held_object("industrial_part")
    distance = np.where(scene.segment.points[:, 0] < np.median(scene.segment.points[:, 0]), 0, 0.01)
    distance[::7] = -0.001
    segment = replace(scene.segment, hand_distance=distance.astype(np.float32))
    bases = CongruentSetSearch(segment, scene.obj, CONFIG).sample_bases(rng())
    assert (distance[bases.points] > 0).all()
    near = replace(segment, hand_distance=np.where(distance > 0, 0.01, 2e-4).astype(np.float32))
    bases = CongruentSetSearch(near, scene.obj, CONFIG).sample_bases(rng())
    assert 0 < (distance[bases.points] <= 0).mean() < 0.2


def test_without_the_heuristic_points_near_the_hand_are_as_likely_as_others() -> None:
    scene = held_object("industrial_part")
    near = scene.segment.points[:, 0] < np.median(scene.segment.points[:, 0])
    segment = replace(scene.segment, hand_distance=np.where(near, 0, 0.01).astype(np.float32))
    uniform = replace(CONFIG, heuristic=False)
    bases = CongruentSetSearch(segment, scene.obj, uniform).sample_bases(rng())
    assert 0.35 < near[bases.points].mean() < 0.65


def test_bases_repeat_with_the_seed_and_differ_between_work_items() -> None:
    scene = held_object("industrial_part")
    search = CongruentSetSearch(scene.segment, scene.obj, CONFIG)
    a, b, other = (search.sample_bases(rng(seed)) for seed in (0, 0, 1))
    np.testing.assert_array_equal(a.points, b.points)
    assert len(np.unique(a.points, axis=0)) > 0.9 * len(a.points)
    assert {tuple(x) for x in a.points} != {tuple(x) for x in other.points}


# Congruent sets


def coarse_object(points: int) -> PackedObject:
    """The industrial part with a pair table of a few points."""
    model = built_in_object("industrial_part").model
    few = SurfaceSamples(model.surface.points[:points], model.surface.normals[:points])
    return PackedObject(replace(model, pairs=build_pair_table(few, model.diameter)), "cpu")


def brute_force(
    segment: Segment,
    bases: Bases,
    obj: PackedObject,
    count: int,
    tolerance: float,
    angle: float,
    normal_angle: float | None = None,
) -> list[set[tuple[int, ...]]]:
    """Per base, all quadruples of the first `count` model points that are congruent to it.

    `angle` is the tolerance of the enclosed angle and, unless there is another one for them, of
    the angles with normals.
    """
    n_angle = angle if normal_angle is None else normal_angle
    p = obj.model.surface.points[:count].astype(np.float64)
    n = obj.model.surface.normals[:count].astype(np.float64)
    i, j = np.nonzero(~np.eye(count, dtype=bool))
    features = pair_features(p[i], n[i], p[j], n[j])
    lines = (p[j] - p[i]) / features[:, :1]
    found = []
    for base, ratios in zip(bases.points, bases.ratios, strict=True):
        q = segment.points[base].astype(np.float64)
        m = segment.normals[base].astype(np.float64)
        wanted = pair_features(q[[0, 2]], m[[0, 2]], q[[1, 3]], m[[1, 3]])
        first, second = (
            np.flatnonzero(
                (np.abs(features - w) <= [tolerance, n_angle, n_angle, n_angle]).all(axis=1)
            )
            for w in wanted
        )
        u, v = ((q[b] - q[a]) / np.linalg.norm(q[b] - q[a]) for a, b in ((0, 1), (2, 3)))
        a, b = (x.ravel() for x in np.meshgrid(first, second, indexing="ij"))
        middle_a = p[i[a]] + ratios[0] * (p[j[a]] - p[i[a]])
        middle_b = p[i[b]] + ratios[1] * (p[j[b]] - p[i[b]])
        cross = np.cross(lines[a], lines[b])
        with np.errstate(invalid="ignore"):
            cross /= np.linalg.norm(cross, axis=1, keepdims=True)
        # Parallel lines have no plane, and so no side of it.
        side = (np.nan_to_num(cross) * (n[i[a]] + n[j[a]] + n[i[b]] + n[j[b]])).sum(axis=1) / 4
        plane = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
        enclosed = np.arccos(np.clip((lines[a] * lines[b]).sum(axis=1), -1, 1))
        good = np.linalg.norm(middle_a - middle_b, axis=1) <= tolerance
        good &= np.abs(enclosed - np.arccos(u @ v)) <= angle
        good &= np.abs(side - plane @ m.sum(axis=0) / 4) <= n_angle
        quadruples = np.stack([i[a], j[a], i[b], j[b]], axis=1)[good]
        found.append({tuple(x) for x in quadruples.tolist()})
    return found


def test_congruent_sets_are_those_of_a_brute_force_search() -> None:
    """Up to sets on the border of a tolerance, where single precision decides."""
    count = 90
    obj = coarse_object(count)
    segment, bases = sampled()
    sets = CongruentSetSearch(segment, obj, EVERYTHING).extract(bases)
    t, angle = CONFIG.congruence, CONFIG.congruence_angle
    certain = brute_force(segment, bases, obj, count, t - 1e-6, angle - 1e-3)
    possible = brute_force(segment, bases, obj, count, t + 1e-6, angle + 1e-3)
    assert sum(map(len, certain)) > 50
    for k in range(len(bases.points)):
        found = {tuple(x) for x in sets.points[sets.base == k].tolist()}
        assert len(found) == (sets.base == k).sum()
        assert certain[k] <= found <= possible[k]


def test_without_the_features_lengths_and_the_enclosed_angle_decide() -> None:
    """Up to sets on the border of a tolerance."""
    count = 40
    obj = coarse_object(count)
    segment, _ = sampled()
    lengths_only = replace(EVERYTHING, ppf_constraint=False, bases=20)
    search = CongruentSetSearch(segment, obj, lengths_only)
    bases = search.sample_bases(rng())
    sets = search.extract(bases)
    t, angle = CONFIG.congruence, CONFIG.congruence_angle
    certain = brute_force(segment, bases, obj, count, t - 1e-6, angle - 1e-3, np.pi)
    possible = brute_force(segment, bases, obj, count, t + 1e-6, angle + 1e-3, np.pi)
    constrained = brute_force(segment, bases, obj, count, t, angle)
    assert sum(map(len, certain)) > 10 * sum(map(len, constrained))
    for k in range(len(bases.points)):
        found = {tuple(x) for x in sets.points[sets.base == k].tolist()}
        assert certain[k] <= found <= possible[k]


def test_of_many_sets_an_even_choice_is_kept() -> None:
    scene = held_object("cylinder")
    full = CongruentSetSearch(scene.segment, scene.obj, replace(EVERYTHING, bases=5))
    bases = full.sample_bases(rng())
    everything = full.extract(bases)
    limited = CongruentSetSearch(
        scene.segment, scene.obj, replace(EVERYTHING, max_sets_per_base=50)
    ).extract(bases)
    for k in range(len(bases.points)):
        total = everything.points[everything.base == k]
        kept = limited.points[limited.base == k]
        assert len(total) > 100
        chosen = np.ceil(np.arange(50) * len(total) / 50).astype(int)
        np.testing.assert_array_equal(kept, total[chosen])


def test_the_number_of_pairs_is_limited() -> None:
    scene = held_object("cylinder")
    few = replace(EVERYTHING, max_pairs_per_base=20)
    search = CongruentSetSearch(scene.segment, scene.obj, few)
    sets = search.extract(search.sample_bases(rng()))
    for k in np.unique(sets.base):
        for pair in (sets.points[sets.base == k, :2], sets.points[sets.base == k, 2:]):
            assert len(np.unique(pair, axis=0)) <= 20


# Poses


@pytest.mark.parametrize("name", ["industrial_part", "cuboid", "cylinder"])
def test_a_known_pose_is_among_the_hypotheses_and_scores_high(name: str) -> None:
    scene = held_object(name)
    poses, again = (
        generate_from_congruent_sets(scene.segment, scene.obj, CONFIG, rng()) for _ in range(2)
    )
    np.testing.assert_array_equal(poses.T_camera_object, again.T_camera_object)
    np.testing.assert_array_equal(poses.score, again.score)
    best = poses.T_camera_object[np.argsort(-poses.score)[:100]].astype(np.float64)
    points = scene.obj.model.surface.points[::10].astype(np.float64)
    true = transform(scene.T_camera_object, points)
    # Mean distance of the true surface from the posed model's: the same for symmetric poses.
    distances = [
        np.abs(scene.obj.model.distance_field.distance(transform(inverse(T), true))).mean()
        for T in best
    ]
    assert min(distances) < 0.002
    assert poses.score.max() > 0.6


def test_an_aligned_set_lies_on_its_base() -> None:
    scene = held_object("industrial_part")
    search = CongruentSetSearch(scene.segment, scene.obj, CONFIG)
    bases = search.sample_bases(rng())
    sets = search.extract(bases)
    poses = search.align(bases, sets).astype(np.float64)
    model = scene.obj.model.surface.points[sets.points].astype(np.float64)
    moved = np.einsum("sij,skj->ski", poses[:, :3, :3], model) + poses[:, None, :3, 3]
    base = scene.segment.points[bases.points[sets.base]]
    assert np.linalg.norm(moved - base, axis=2).mean() < CONFIG.congruence


def test_points_that_no_object_of_this_size_has_give_no_answer() -> None:
    scene = held_object("industrial_part")
    points = np.array([[0, 0, 1], [0.5, 0, 1], [0, 0.5, 1], [0.5, 0.5, 1]])
    wide = Segment(
        points.astype(np.float32),
        np.tile(np.array([0, 0, -1], dtype=np.float32), (4, 1)),
        np.full(4, 0.1, dtype=np.float32),
        np.ones(4, dtype=np.float32),
    )
    with pytest.raises(NoAnswer, match="the right object"):
        generate_from_congruent_sets(wide, scene.obj, CONFIG, rng())
