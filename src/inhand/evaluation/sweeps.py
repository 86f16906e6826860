"""Sweeps: a perturbation of frames at rising levels, and what a method makes of each."""

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import degrees, radians
from typing import NamedTuple

import numpy as np

from inhand.datasets.frames import Frame
from inhand.errors import InputError
from inhand.evaluation import perturbations as p
from inhand.evaluation.perturbations import Bodies
from inhand.evaluation.results import FrameResult

Perturb = Callable[[Frame, float, Bodies, np.random.Generator], Frame]
"""Makes a frame harder by a level."""

TURN_PER_SHIFT = radians(8) / 0.015
"""How the wrist's two errors grow together in the sweep `wrist` [rad/m]."""
HEIGHTS = {160: 120, 240: 180, 320: 240, 1280: 720}
"""Heights of images by their widths [pixel]."""
OBJECT_SCALE = "object-scale"
"""The sweep that changes the model that methods are given, not the frame."""


@dataclass(frozen=True)
class Sweep:
    """A perturbation, and how much of it is tried."""

    title: str
    """What is wrong, in words."""
    levels: tuple[float, ...]
    """How much of it, in SI units."""
    perturb: Perturb
    """Makes it so."""
    unit: str = ""
    """Unit in which levels are shown."""
    scale: float = 1.0
    """How many of these units are one in SI units."""
    none: float | None = 0.0
    """The level that a frame as it is stands for; None if it is on another scale."""

    def words(self, level: float) -> str:
        """A level with its unit."""
        return f"{float(f'{level * self.scale:.4g}'):g} {self.unit}"


_MM = ("mm", 1000.0)
_PERCENT = ("%", 100.0)

SWEEPS: Mapping[str, Sweep] = {
    "wrist-position": Sweep(
        "wrist given at a wrong place",
        (0.0, 0.003, 0.006, 0.009, 0.012, 0.015),
        lambda frame, level, _, rng: p.with_wrist_error(frame, level, 0.0, rng),
        *_MM,
        none=None,
    ),
    "wrist-rotation": Sweep(
        "wrist given wrongly turned",
        tuple(map(radians, (2, 4, 6, 8))),
        lambda frame, level, _, rng: p.with_wrist_error(frame, 0.0, level, rng),
        "deg",
        degrees(1),
        none=None,
    ),
    "wrist": Sweep(
        "wrist off, with 8 deg for every 15 mm",
        (0.003, 0.006, 0.009, 0.012, 0.015),
        lambda frame, level, _, rng: p.with_wrist_error(frame, level, level * TURN_PER_SHIFT, rng),
        *_MM,
        none=None,
    ),
    "noise": Sweep(
        "noise added, times structured light's",
        (0.5, 1.0, 2.0, 3.0),
        lambda frame, level, _, rng: p.with_depth_noise(frame, level, rng),
        "x",
    ),
    "missing": Sweep(
        "pixels without a reading",
        (0.1, 0.3, 0.5, 0.7),
        lambda frame, level, _, rng: p.with_missing_depth(frame, level, rng),
        *_PERCENT,
    ),
    "wall": Sweep(
        "a wall this far behind the hand",
        (0.20, 0.10, 0.05, 0.02),
        lambda frame, level, bodies, _: p.with_wall(frame, level, bodies),
        *_MM,
        none=None,
    ),
    "table": Sweep(
        "a table this far below the hand",
        (0.10, 0.05, 0.02, 0.0),
        lambda frame, level, bodies, _: p.with_table(frame, level, bodies),
        *_MM,
        none=None,
    ),
    "second-hand": Sweep(
        "a second hand this far beside the first",
        (0.10, 0.05, 0.02, 0.0),
        lambda frame, level, bodies, _: p.with_second_hand(frame, level, bodies),
        *_MM,
        none=None,
    ),
    "crop": Sweep(
        "share of the hand outside the image",
        (0.2, 0.4, 0.6, 0.8),
        lambda frame, level, *_: p.cropped(frame, level),
        *_PERCENT,
    ),
    OBJECT_SCALE: Sweep(
        "the object's model too large",
        (-0.03, -0.02, -0.01, 0.01, 0.02, 0.03),
        lambda frame, *_: frame,
        *_PERCENT,
    ),
    "focal-length": Sweep(
        "focal lengths given too large",
        (-0.02, -0.01, 0.01, 0.02),
        lambda frame, level, *_: p.with_focal_length(frame, 1 + level),
        *_PERCENT,
    ),
    "size": Sweep(
        "width of the image",
        (160, 240, 320, 1280),
        lambda frame, level, bodies, _: p.resized(frame, int(level), HEIGHTS[int(level)], bodies),
        "pixel",
        none=None,
    ),
}


class Perturbation(NamedTuple):
    """One level of a sweep."""

    sweep: str
    """Name of the sweep."""
    level: float
    """The level."""

    @property
    def object_scale(self) -> float:
        """How much larger than the object the model is that methods are given."""
        return 1 + self.level if self.sweep == OBJECT_SCALE else 1.0

    def apply(self, frame: Frame, bodies: Bodies, seed: int) -> Frame:
        """The frame made harder.

        Args:
            frame: the frame.
            bodies: its hand and object.
            seed: every seed makes other random errors, the same at all levels.
        """
        names = [zlib.crc32(name.encode()) for name in (self.sweep, frame.name)]
        rng = np.random.default_rng([seed, *names])
        return SWEEPS[self.sweep].perturb(frame, self.level, bodies, rng)


def find_perturbations(names: str) -> list[Perturbation]:
    """All levels of the sweeps with these names, separated by commas; `all` stands for every one.

    Raises:
        InputError: a name is unknown, or there is none.
    """
    wanted = list(dict.fromkeys(name.strip() for name in names.split(",") if name.strip()))
    sweeps = list(SWEEPS) if wanted == ["all"] else wanted
    unknown = [name for name in sweeps if name not in SWEEPS]
    if unknown or not sweeps:
        raise InputError(
            f'there is no sweep "{", ".join(unknown)}"; known: all, {", ".join(SWEEPS)}'
        )
    return [Perturbation(sweep, level) for sweep in sweeps for level in SWEEPS[sweep].levels]


def perturbation_of(result: FrameResult) -> Perturbation | None:
    """The level of a sweep that a result belongs to, if any."""
    found = [Perturbation(*item) for item in result.perturbation.items() if item[0] in SWEEPS]
    return found[0] if found else None


def by_level(results: Sequence[FrameResult]) -> dict[str, dict[float, list[FrameResult]]]:
    """Results by sweep and level, the levels in the order of the sweep."""
    table: dict[str, dict[float, list[FrameResult]]] = {}
    for result in results:
        if at := perturbation_of(result):
            table.setdefault(at.sweep, {}).setdefault(at.level, []).append(result)
    return {
        name: {level: table[name][level] for level in sweep.levels if level in table[name]}
        for name, sweep in SWEEPS.items()
        if name in table
    }


def as_they_are(
    levels: Mapping[float, Sequence[FrameResult]], results: Sequence[FrameResult]
) -> list[FrameResult]:
    """The results on the same frames as those by level, but with nothing done to them."""
    frames = {r.frame for of_level in levels.values() for r in of_level}
    return [r for r in results if not r.perturbation and r.frame in frames]


def curve(sweep: str, results: Sequence[FrameResult]) -> dict[float, list[FrameResult]]:
    """One sweep's results by level, the levels rising; frames as they are where they belong.

    Empty when there is no result of the sweep.
    """
    levels = by_level(results).get(sweep, {})
    plain, none = as_they_are(levels, results), SWEEPS[sweep].none
    if plain and none is not None:
        levels = {none: plain, **levels}
    return dict(sorted(levels.items()))
