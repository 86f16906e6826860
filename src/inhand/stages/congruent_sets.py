"""The paper's generation of object poses: heuristically sampled 4-point bases on the segment
(Alg. 2), their congruent sets on the model, and least-squares alignment (section IV-B)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.config import HypothesesConfig
from inhand.errors import NoAnswer
from inhand.kernels.alignment import align_quadruples
from inhand.kernels.congruent_sets import (
    BaseRule,
    find_pairs,
    match_pairs,
    sample_bases,
)
from inhand.kernels.launch import computed, launch
from inhand.packed import PackedObject
from inhand.stages.lcp import segment_lcp
from inhand.stages.results import PoseSet, Segment

# The hash grid's cells along x, where the bases lie side by side, and across.
GRID_CELLS = (2048, 32, 32)


@dataclass(frozen=True)
class Bases:
    """4-point bases on the segment."""

    points: NDArray[np.int32]
    """Indices of the points, shape (b, 4); the lines of pairs (0, 1) and (2, 3) cross."""
    ratios: NDArray[np.float32]
    """Where along either pair they cross, shape (b, 2)."""


@dataclass(frozen=True)
class CongruentSets:
    """Quadruples of model points that are congruent to bases."""

    base: NDArray[np.int32]
    """Index of the base, shape (s,)."""
    points: NDArray[np.int32]
    """Indices of the model's points, in the order of the base's, shape (s, 4)."""


def generate_from_congruent_sets(
    segment: Segment, obj: PackedObject, config: HypothesesConfig, rng: np.random.Generator
) -> PoseSet:
    """Object poses scored by their LCP.

    Raises:
        NoAnswer: no four points of the segment form a shape that the object has.
    """
    search = CongruentSetSearch(segment, obj, config)
    bases = search.sample_bases(rng)
    sets = search.extract(bases)
    if len(sets.base) == 0:
        raise NoAnswer(
            f"no part of the object matches the {len(segment.points)} points that were seen of it; "
            "is it the right object, in the right unit?"
        )
    poses = search.align(bases, sets)
    stride = -(-len(segment.points) // config.lcp_points)
    return PoseSet(poses, segment_lcp(poses, segment, obj, config, stride))


class CongruentSetSearch:
    """Bases on one segment and their congruent sets on one model."""

    def __init__(self, segment: Segment, obj: PackedObject, config: HypothesesConfig) -> None:
        self.segment, self.config, self.device = segment, config, obj.device
        # Within pi every angle agrees: the pair table then serves as an index by length alone.
        self.pair_angle = config.congruence_angle if config.ppf_constraint else np.pi
        self.points = wp.array(segment.points, dtype=wp.vec3, device=obj.device)
        self.normals = wp.array(segment.normals, dtype=wp.vec3, device=obj.device)
        self.diameter = obj.model.diameter
        self.model = obj.pairs

    def sample_bases(self, rng: np.random.Generator) -> Bases:
        """Bases by Alg. 2; those that found no fourth point are left out."""
        config, n = self.config, self.config.bases
        rule = BaseRule()
        rule.discount, rule.max_tries = config.sampling_discount, config.max_tries
        rule.coplanarity = config.coplanarity
        rule.max_cosine = float(np.cos(config.min_angle))
        rule.any_angles = int(not config.ppf_constraint)
        distance = np.maximum(self.segment.hand_distance, 0.0)
        prior = 1 - np.exp(-config.heuristic_decay * distance)
        if not config.heuristic:
            prior = np.ones_like(prior)
        bases, ratios = self._empty(n, wp.vec4i), self._empty(n, wp.vec2)
        inputs = [
            self.points,
            self.normals,
            wp.array(prior, dtype=float, device=self.device),
            self.model,
            rule,
            int(rng.integers(2**31)),
            wp.empty((n, len(self.points)), dtype=float, device=self.device),
            bases,
            ratios,
        ]
        launch(sample_bases, n, inputs, self.device, work_per_item=20 * len(self.points))
        found = bases.numpy()[:, 0] >= 0
        return Bases(bases.numpy()[found], ratios.numpy()[found])

    def extract(self, bases: Bases) -> CongruentSets:
        """Congruent sets of all bases; of a base that has more than `max_sets_per_base`, an even
        choice."""
        n, limit = len(bases.points), self.config.max_sets_per_base
        base = wp.array(bases.points, dtype=wp.vec4i, device=self.device)
        counts, pair, middle = self._find_pairs(base, bases.ratios)
        first_pairs = int(counts[:n].sum())
        owner = self._ints(np.repeat(np.arange(2 * n) % n, counts))
        found = self._empty(first_pairs, int)
        if first_pairs == 0 or first_pairs == len(pair):
            return CongruentSets(np.empty(0, np.int32), np.empty((0, 4), np.int32))
        grid = wp.HashGrid(*GRID_CELLS, device=self.device)
        grid.build(middle[first_pairs:], self.config.congruence)

        def match(rank: Any, total: Any, start: Any, sets: Any) -> None:
            tolerances = [self.config.congruence, self.config.congruence_angle, self.pair_angle]
            inputs = [self.points, self.normals, base, owner, self.model, pair, middle]
            inputs += [first_pairs, grid.id, *tolerances]
            inputs += [self._ints(rank), self._ints(total), limit, self._ints(start), found, sets]
            launch(match_pairs, first_pairs, inputs, self.device, work_per_item=100)

        match([], [], [], self._empty(0, wp.vec4i))
        found_before = _starts(found.numpy())
        bounds = np.append(found_before, found.numpy().sum())[_starts(counts[:n], end=True)]
        total = np.diff(bounds)
        kept = np.minimum(total, limit)
        sets = self._empty(int(kept.sum()), wp.vec4i)
        rank = found_before - np.repeat(bounds[:-1], counts[:n])
        match(rank, total, _starts(kept), sets)
        return CongruentSets(np.repeat(np.arange(n, dtype=np.int32), kept), sets.numpy())

    def align(self, bases: Bases, sets: CongruentSets) -> NDArray[np.float32]:
        """T_camera_object, shape (s, 4, 4), that takes every congruent set to its base."""
        inputs = [
            self.points,
            wp.array(bases.points[sets.base], dtype=wp.vec4i, device=self.device),
            self.model.points,
            wp.array(sets.points, dtype=wp.vec4i, device=self.device),
        ]
        shape = (len(sets.base),)
        return computed(align_quadruples, shape, wp.mat44, inputs, self.device, work_per_item=100)

    def _find_pairs(
        self, base: Any, ratios: NDArray[np.float32]
    ) -> tuple[NDArray[np.int32], Any, Any]:
        """Model pairs like the first pair of every base, then like the second; an even choice.

        Returns:
            their number for every pair of a base, shape (2 b,), their index in the pair table, and
            their intermediate points.
        """
        count, limit = self._empty(2 * len(base), int), self.config.max_pairs_per_base
        ratio = wp.array(ratios, dtype=wp.vec2, device=self.device)

        def find(start: Any, pair: Any, middle: Any) -> None:
            tolerances = [self.config.congruence, self.pair_angle]
            inputs = [self.points, self.normals, base, ratio, self.model, *tolerances]
            inputs += [self.diameter, limit, self._ints(start), count, pair, middle]
            launch(find_pairs, len(count), inputs, self.device, work_per_item=5000)

        find([], self._empty(0, int), self._empty(0, wp.vec3))
        counts = np.minimum(count.numpy(), limit)
        pair = self._empty(int(counts.sum()), int)
        middle = self._empty(len(pair), wp.vec3)
        find(_starts(counts), pair, middle)
        return counts, pair, middle

    def _empty(self, n: int, dtype: Any) -> Any:
        return wp.empty(n, dtype=dtype, device=self.device)

    def _ints(self, values: Any) -> Any:
        return wp.array(np.asarray(values, dtype=np.int32), dtype=int, device=self.device)


def _starts(counts: NDArray[Any], *, end: bool = False) -> NDArray[np.int64]:
    """Where the elements of every count begin when they lie one after the other; `end`: and end."""
    edges = np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])
    return edges if end else edges[:-1]
