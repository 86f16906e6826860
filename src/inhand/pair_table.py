"""Lookup of oriented point pairs of a model by their pair feature."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inhand.geometry.sampling import SurfaceSamples

POINTS = 500
"""Surface samples whose pairs are tabled."""
DISTANCE_STEPS = 24
"""Distance steps over the diameter."""
ANGLE_STEPS = 12
"""Angle steps over pi: 15 degrees each."""


@dataclass(frozen=True, eq=False)
class PairTable:
    """All ordered pairs of model points, sorted into cells by their point pair feature.

    The feature of points p1, p2 with normals n1, n2 is |d|, angle(n1, d), angle(n2, d),
    angle(n1, n2) with d = p2 - p1 (paper, section III-C; Drost et al., "Model Globally, Match
    Locally", 2010). A pair lies in cell ((i_d * n_angle + i_1) * n_angle + i_2) * n_angle + i_12,
    where i_d = floor(|d| / distance_step) and i = floor(angle / (pi / n_angle)). Cell c holds the
    pairs cell_start[c] up to cell_start[c + 1].
    """

    cell_start: NDArray[np.int32]
    """First pair of every cell, and the number of pairs at the end, shape (n_cells + 1,)."""
    pair_first: NDArray[np.int32]
    """Index of each pair's first point among the surface samples, shape (m,)."""
    pair_second: NDArray[np.int32]
    """Index of each pair's second point, shape (m,)."""
    distance_step: float
    """Width of a distance step [m]."""
    n_distance: int
    """Number of distance steps."""
    n_angle: int
    """Number of angle steps."""


def pair_features(
    p1: NDArray[np.floating],
    n1: NDArray[np.floating],
    p2: NDArray[np.floating],
    n2: NDArray[np.floating],
) -> NDArray[np.float64]:
    """Distance [m] and the three angles [rad] of point pairs, shape (..., 4).

    Args:
        p1, p2: points [m], shape (..., 3); no pair may coincide.
        n1, n2: their unit normals, shape (..., 3).
    """
    d = (p2 - p1).astype(np.float64)
    length = np.linalg.norm(d, axis=-1)
    d /= length[..., None]
    cosines = [(a * b).sum(axis=-1) for a, b in ((n1, d), (n2, d), (n1, n2))]
    return np.stack([length, *np.arccos(np.clip(cosines, -1, 1))], axis=-1)


def build_pair_table(surface: SurfaceSamples, diameter: float) -> PairTable:
    """Table the pairs of the first `POINTS` surface samples; `diameter` of the object [m]."""
    points, normals = surface.points[:POINTS], surface.normals[:POINTS]
    step = diameter / DISTANCE_STEPS
    i, j = np.nonzero(np.linalg.norm(points[:, None] - points[None], axis=-1) > 1e-6 * diameter)
    feature = pair_features(points[i], normals[i], points[j], normals[j])
    # A pair as long as the diameter, or opposite normals, belong to the last step.
    shape = (DISTANCE_STEPS, ANGLE_STEPS, ANGLE_STEPS, ANGLE_STEPS)
    width = np.array([step, *[np.pi / ANGLE_STEPS] * 3])
    index = np.minimum(np.floor(feature / width).astype(int), np.array(shape) - 1)
    cell = np.ravel_multi_index(tuple(index.T), shape)
    order = np.argsort(cell, kind="stable")
    start = np.searchsorted(cell[order], np.arange(np.prod(shape) + 1))
    return PairTable(
        start.astype(np.int32),
        i[order].astype(np.int32),
        j[order].astype(np.int32),
        step,
        DISTANCE_STEPS,
        ANGLE_STEPS,
    )
