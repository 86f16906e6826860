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
    find_slots,
    sample_wide_bases,
)
from inhand.baselines.views import spread_directions
from inhand.errors import NoAnswer
from inhand.kernels.alignment import align_quadruples
from inhand.kernels.launch import launch
from inhand.kernels.lcp import pose_lcp
from inhand.packed import PackedObject
from inhand.stages.congruent_sets import Bases, CongruentSets
from inhand.stages.observation import Cloud

FARTHEST_CROSSING = 0.7
"""The lines of a base's pairs cross at most this far from the pairs' middles, in their lengths."""


@dataclass(frozen=True)
class Settings:
    """Parameters of Super4PCS."""

    delta: float = 0.03
    """Tolerance of lengths, intermediate points and the common pointset, in diameters of the
    object: about half the distance between `model_points`."""
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
    directions: int = 8
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
        self.delta = self.settings.delta * obj.model.diameter
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
            self.delta, np.pi, self.obj.device,
        )  # fmt: skip
        return np.asarray(poses.numpy()[[share.argmax()]], dtype=np.float64)

    def sample_bases(self, scene: Any, rng: np.random.Generator) -> Bases:
        """Wide, nearly coplanar bases on the cloud, a device array of `wp.vec3`."""
        s, rule = self.settings, WideBaseRule()
        rule.widest = s.overlap * self.obj.model.diameter
        rule.narrowest, rule.coplanarity = s.narrowest * rule.widest, self.delta
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
        index, other = self._index(other, ratios)
        count = self._empty(n_one, int)

        def complete(rank: Any, total: Any, start: Any, sets: Any) -> None:
            inputs = [scene, self._array(bases.points, wp.vec4i), ratios, one, other, index]
            inputs += [self.delta, self.settings.angle, self._array(rank, int)]
            inputs += [self._array(total, int), limit, self._array(start, int), count, sets]
            launch(complete_sets, n_one, inputs, self.obj.device, work_per_item=500)

        complete([], [], [], self._empty(0, wp.vec4i))
        before = _edges(count.numpy())
        base_start = before[np.searchsorted(one.base.numpy(), np.arange(n + 1))]
        total = np.diff(base_start)
        kept = np.minimum(total, limit)
        sets = self._empty(int(kept.sum()), wp.vec4i)
        rank = before[:-1] - base_start[one.base.numpy()]
        complete(rank, total, _edges(kept)[:-1], sets)
        return CongruentSets(np.repeat(np.arange(n, dtype=np.int32), kept), sets.numpy())

    def _pairs(self, scene: Any, ends: NDArray[np.int32]) -> Any:
        """Model pairs as long as the pairs of scene points with these indices, shape (b, 2)."""
        points = scene.numpy().astype(np.float64)
        wanted = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
        start = np.searchsorted(self._length, wanted - self.delta, "left")
        end = np.searchsorted(self._length, wanted + self.delta, "right")
        count = end - start
        place = np.arange(count.sum()) + np.repeat(start - (np.cumsum(count) - count), count)
        base = np.repeat(np.arange(len(ends), dtype=np.int32), count)
        return self._device_pairs(self._first[place], self._second[place], base)

    def _index(self, pairs: Any, ratios: Any) -> tuple[Any, Any]:
        """The rotation-aware grid of second pairs, and these in the order of its slots."""
        directions = spread_directions(self.settings.directions)
        index = RotationAwareGrid()
        index.directions = self._array(directions, wp.vec3)
        # Every direction has about as much of the sphere as a cap of this radius; the corners of
        # its share lie farther out.
        index.reach = 1.5 * float(np.arccos(1 - 2 / len(directions)))
        index.cell = 2.01 * self.delta
        # As far as lines are followed beyond their pairs, and a cell more for what lies beside.
        low, high = self.obj.model.mesh.bounds
        low, high = low - index.cell, high + index.cell
        margin = (FARTHEST_CROSSING - 0.5) * (high - low)
        index.origin = wp.vec3(*(low - margin))
        size = np.ceil((high - low + 2 * margin) / index.cell).astype(int) + 1
        index.size = wp.vec3i(*size.tolist())
        slot, n = self._empty(len(pairs.base), int), len(pairs.base)
        launch(find_slots, n, [pairs, ratios, index, slot], self.obj.device, work_per_item=100)
        slots = len(ratios) * int(size.prod()) * len(directions)
        index.start = self._array(_edges(np.bincount(slot.numpy(), minlength=slots)), int)
        order = np.argsort(slot.numpy(), kind="stable")
        first, second, base = (x.numpy()[order] for x in (pairs.first, pairs.second, pairs.base))
        return index, self._device_pairs(first, second, base)

    def _device_pairs(self, first: Any, second: Any, base: Any) -> Any:
        pairs = Pairs()
        pairs.points = self.obj.points
        pairs.first, pairs.second = self._array(first, int), self._array(second, int)
        pairs.base = self._array(base, int)
        return pairs

    def _empty(self, n: int, dtype: Any) -> Any:
        return wp.empty(n, dtype=dtype, device=self.obj.device)

    def _array(self, values: Any, dtype: Any) -> Any:
        values = np.asarray(values, dtype=np.int32 if dtype in (int, wp.vec4i) else np.float32)
        return wp.array(values, dtype=dtype, device=self.obj.device)


def _edges(counts: NDArray[Any]) -> NDArray[np.int64]:
    """Where the elements of every count begin when they lie one after the other, and the end."""
    return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])
