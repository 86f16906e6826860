"""Super4PCS (Mellado et al., "Super 4PCS: Fast Global Pointcloud Registration via Smart Indexing",
2014): congruent 4-point sets, verified by the largest common pointset."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.baselines.method import View
from inhand.baselines.registration import Registration
from inhand.baselines.super4pcs_kernels import (
    Pairs,
    RotationAwareGrid,
    WideBaseRule,
    complete_sets,
    fill_grid,
    sample_wide_bases,
)
from inhand.errors import NoAnswer
from inhand.kernels.alignment import align_quadruples
from inhand.kernels.launch import launch
from inhand.kernels.lcp import pose_lcp
from inhand.packed import PackedObject
from inhand.stages.congruent_sets import Bases, CongruentSets
from inhand.stages.observation import Cloud

GRID_CELLS = (512, 128, 32)
"""The hash grid's cells; bases lie side by side along the first axis, directions along the next."""

FARTHEST_CROSSING = 0.7
"""The lines of a base's pairs cross at most this far from the pairs' middles, in their lengths."""


@dataclass(frozen=True)
class Settings:
    """Parameters of Super4PCS."""

    delta: float = 0.004
    """Tolerance of lengths, intermediate points and the common pointset [m]."""
    angle: float = 0.1
    """Tolerance of the angle between a set's two pairs [rad]."""
    overlap: float = 0.5
    """Widest base, in diameters of the object: the share of it that is expected to be seen."""
    narrowest: float = 0.2
    """Distance of the fourth point to the others, in widths of the widest base."""
    bases: int = 100
    """Number of bases."""
    triangles: int = 200
    """Triangles of which a base takes the largest."""
    attempts: int = 20
    """Times that a base is begun anew when it finds no fourth point."""
    model_points: int = 200
    """Points of the model that make sets."""
    directions: int = 16
    """Bins of directions in the rotation-aware grid."""
    sets_per_base: int = 500
    """Congruent sets of a base that are verified at most."""
    lcp_points: int = 200
    """Points of the cloud that verify them at most."""


class Super4PCS(Registration):
    """The method for one object.

    Bases come from the cloud and their congruent sets from the model, whose pairs are sorted by
    length once; the original makes the same choice by the sizes of its two clouds.
    """

    def __init__(self, obj: PackedObject, seed: int, settings: Settings | None = None) -> None:
        self.obj, self.seed = obj, seed
        self.settings = Settings() if settings is None else settings
        points = obj.model.surface.points[: self.settings.model_points].astype(np.float64)
        first, second = np.nonzero(~np.eye(len(points), dtype=bool))
        length = np.linalg.norm(points[first] - points[second], axis=1)
        order = np.argsort(length, kind="stable")
        self._length = length[order]
        self._first, self._second = (x[order].astype(np.int32) for x in (first, second))

    def align(self, cloud: Cloud, view: View) -> NDArray[np.float64]:
        """The pose that explains most of the cloud, shape (1, 4, 4)."""
        rng = np.random.default_rng(self.seed)
        scene = wp.array(cloud.points, dtype=wp.vec3, device=self.obj.device)
        bases = self.sample_bases(scene, rng)
        sets = self.extract(scene, bases)
        if not len(sets.base):
            raise NoAnswer("no four points of the cloud form a shape that the object has")
        poses = self._empty(len(sets.base), wp.mat44)
        inputs = [scene, self._array(bases.points[sets.base], wp.vec4i), self.obj.points]
        inputs += [self._array(sets.points, wp.vec4i), poses]
        launch(align_quadruples, len(poses), inputs, self.obj.device, work_per_item=100)
        stride = -(-len(cloud.points) // self.settings.lcp_points)
        share = pose_lcp(
            poses.numpy(), cloud.points[::stride], cloud.normals[::stride], self.obj.fields,
            self.settings.delta, np.pi, self.obj.device,
        )  # fmt: skip
        return np.asarray(poses.numpy()[[share.argmax()]], dtype=np.float64)

    def sample_bases(self, scene: Any, rng: np.random.Generator) -> Bases:
        """Wide, nearly coplanar bases on the cloud, a device array of `wp.vec3`."""
        s, rule = self.settings, WideBaseRule()
        rule.widest = s.overlap * self.obj.model.diameter
        rule.narrowest, rule.coplanarity = s.narrowest * rule.widest, s.delta
        rule.triangles, rule.attempts = s.triangles, s.attempts
        rule.farthest_crossing = FARTHEST_CROSSING
        bases, ratios = self._empty(s.bases, wp.vec4i), self._empty(s.bases, wp.vec2)
        inputs = [scene, rule, int(rng.integers(2**31)), bases, ratios]
        work = 20 * (s.triangles + len(scene))
        launch(sample_wide_bases, s.bases, inputs, self.obj.device, work_per_item=work)
        found = bases.numpy()[:, 0] >= 0
        return Bases(bases.numpy()[found], ratios.numpy()[found])

    def extract(self, scene: Any, bases: Bases) -> CongruentSets:
        """The model's congruent sets of all bases; of a base with too many, an even choice."""
        one, other = (self._pairs(scene, bases.points[:, k : k + 2]) for k in (0, 2))
        n, n_one, limit = len(bases.points), len(one.base), self.settings.sets_per_base
        if not n_one or not len(other.base):
            return CongruentSets(np.empty(0, np.int32), np.empty((0, 4), np.int32))
        ratios = self._array(bases.ratios, wp.vec2)
        index, grid = self._index(other, ratios)
        count = self._empty(n_one, int)

        def complete(rank: Any, total: Any, start: Any, sets: Any) -> None:
            inputs = [scene, self._array(bases.points, wp.vec4i), ratios, one, other, index]
            inputs += [self.settings.delta, self.settings.angle, self._array(rank, int)]
            inputs += [self._array(total, int), limit, self._array(start, int), count, sets]
            launch(complete_sets, n_one, inputs, self.obj.device, work_per_item=500)

        complete([], [], [], self._empty(0, wp.vec4i))
        before = np.concatenate([[0], np.cumsum(count.numpy(), dtype=np.int64)])
        base_start = before[np.searchsorted(one.base.numpy(), np.arange(n + 1))]
        total = np.diff(base_start)
        kept = np.minimum(total, limit)
        sets = self._empty(int(kept.sum()), wp.vec4i)
        rank = before[:-1] - base_start[one.base.numpy()]
        complete(rank, total, np.cumsum(kept) - kept, sets)
        del grid  # lives until here: kernels know it by its number alone
        return CongruentSets(np.repeat(np.arange(n, dtype=np.int32), kept), sets.numpy())

    def _pairs(self, scene: Any, ends: NDArray[np.int32]) -> Any:
        """Model pairs as long as the pairs of scene points with these indices, shape (b, 2)."""
        points = scene.numpy().astype(np.float64)
        wanted = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
        start = np.searchsorted(self._length, wanted - self.settings.delta, "left")
        end = np.searchsorted(self._length, wanted + self.settings.delta, "right")
        count = end - start
        place = np.arange(count.sum()) + np.repeat(start - (np.cumsum(count) - count), count)
        pairs = Pairs()
        pairs.points = self.obj.points
        pairs.first = self._array(self._first[place], int)
        pairs.second = self._array(self._second[place], int)
        pairs.base = self._array(np.repeat(np.arange(len(ends)), count), int)
        return pairs

    def _index(self, pairs: Any, ratios: Any) -> tuple[Any, Any]:
        """The rotation-aware grid of second pairs, and the hash grid in it."""
        n = len(pairs.base)
        directions = spread_directions(self.settings.directions)
        index, grid = RotationAwareGrid(), wp.HashGrid(*GRID_CELLS, device=self.obj.device)
        index.grid, index.points = grid.id, self._empty(n, wp.vec3)
        index.directions = self._array(directions, wp.vec3)
        # Every direction has about as much of the sphere as a cap of this radius; the corners of
        # its share lie farther out.
        index.reach = 1.5 * float(np.arccos(1 - 2 / len(directions)))
        # With `FARTHEST_CROSSING` intermediate points lie within 1.4 diameters of each other.
        index.stretch = 2 * self.obj.model.diameter
        inputs = [pairs, ratios, index]
        launch(fill_grid, n, inputs, self.obj.device, work_per_item=3 * len(directions))
        grid.build(index.points, 2 * self.settings.delta)
        return index, grid

    def _empty(self, n: int, dtype: Any) -> Any:
        return wp.empty(n, dtype=dtype, device=self.obj.device)

    def _array(self, values: Any, dtype: Any) -> Any:
        values = np.asarray(values, dtype=np.int32 if dtype in (int, wp.vec4i) else np.float32)
        return wp.array(values, dtype=dtype, device=self.obj.device)


def spread_directions(count: int) -> NDArray[np.float64]:
    """Unit vectors (count, 3) spread evenly over the sphere: a Fibonacci spiral."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    width = np.sqrt(1 - z**2)
    return np.stack([width * np.cos(turn), width * np.sin(turn), z], axis=1)
