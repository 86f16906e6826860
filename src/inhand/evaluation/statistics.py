"""How sure a share, a mean or a confidence is."""

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from inhand.errors import InputError

RESAMPLES = 1000
"""Resamples of a bootstrap."""
RELIABILITY_BINS = 10
"""Bins of equal width that the reliability curve groups confidences in."""


class Estimate(NamedTuple):
    """A number and its 95 % confidence interval; all None where there was nothing to estimate."""

    value: float | None
    low: float | None
    high: float | None


class ReliabilityBin(NamedTuple):
    """Answers of similar confidence: how sure they claim to be, and how often they are right."""

    confidence: float
    """Mean confidence."""
    share: float
    """Share of right answers."""
    low: float
    """Lower end of the share's 95 % interval."""
    high: float
    """Upper end."""
    answers: int
    """How many there are."""


def wilson_interval(successes: int, trials: int, z: float = 1.96) -> tuple[float, float]:
    """Confidence interval of a share by Wilson's score method (95 % at z = 1.96); (0, 1) of none.

    Raises:
        InputError: `successes` is not between 0 and `trials`.
    """
    if not 0 <= successes <= trials:
        raise InputError(f"{successes} successes of {trials} trials is not a share")
    if trials == 0:
        return 0.0, 1.0
    share = successes / trials
    scale = 1 + z * z / trials
    middle = (share + z * z / (2 * trials)) / scale
    half = z / scale * np.sqrt(share * (1 - share) / trials + (z / (2 * trials)) ** 2)
    return max(0.0, float(middle - half)), min(1.0, float(middle + half))


def auroc(scores: ArrayLike, correct: ArrayLike) -> float | None:
    """Chance that a correct answer has a higher score than a wrong one, ties counted half.

    The area under the receiver operating characteristic. None without both kinds of answers.

    Args:
        scores: confidences, shape (n,).
        correct: whether each answer is right, shape (n,).
    """
    values, right = np.asarray(scores, dtype=np.float64), np.asarray(correct, dtype=bool)
    wrong_scores = np.sort(values[~right])
    if not right.any() or right.all():
        return None
    below = np.searchsorted(wrong_scores, values[right], side="left")
    not_above = np.searchsorted(wrong_scores, values[right], side="right")
    return float((below + not_above).mean() / 2 / len(wrong_scores))


def mean(values: ArrayLike, groups: Sequence[Hashable] | None = None, seed: int = 0) -> Estimate:
    """Mean of the group means of one quantity: see `means`."""
    return means({"": values}, groups, seed)[""]


def means(
    quantities: Mapping[str, ArrayLike], groups: Sequence[Hashable] | None = None, seed: int = 0
) -> dict[str, Estimate]:
    """Means of the group means, every group counting alike; without groups plain means.

    The intervals are the bootstrap's (Efron 1979, percentiles), resampled within the groups.

    Args:
        quantities: values by name, each of shape (n,).
        groups: group of each value, length n.
        seed: seed of the resampling.
    """
    table = np.array([np.asarray(v, dtype=np.float64) for v in quantities.values()])  # (k, n)
    if not table.size:
        return dict.fromkeys(quantities, Estimate(None, None, None))
    members = _members(table.shape[1], groups)
    for group in members:
        table[:, group] /= len(members) * len(group)
    resampled = np.array([table @ drawn for drawn in _draws(members, seed)])  # (RESAMPLES, k)
    return {
        name: Estimate(float(values.sum()), *_percentiles(resampled[:, i]))
        for i, (name, values) in enumerate(zip(quantities, table, strict=True))
    }


def bootstrap(
    statistic: Callable[..., float | None], *arrays: ArrayLike, seed: int = 0
) -> Estimate:
    """`statistic` of arrays of one length, with the bootstrap's percentile interval.

    Resamples for which the statistic is None are left out.
    """
    columns = [np.asarray(array) for array in arrays]
    value = statistic(*columns)
    if value is None:
        return Estimate(None, None, None)
    every = np.arange(len(columns[0]))
    found = []
    for drawn in _draws([every], seed):
        pick = np.repeat(every, drawn)
        found.append(statistic(*(column[pick] for column in columns)))
    return Estimate(value, *_percentiles([f for f in found if f is not None]))


def _members(count: int, groups: Sequence[Hashable] | None) -> list[NDArray[np.int64]]:
    """Indices of the members of every group."""
    by_group: dict[Any, list[int]] = {}
    for i in range(count):
        by_group.setdefault(None if groups is None else groups[i], []).append(i)
    return [np.array(indices) for indices in by_group.values()]


def _draws(members: list[NDArray[np.int64]], seed: int) -> Iterator[NDArray[np.int64]]:
    """How often each of n things is drawn in each of the resamples, shape (n,)."""
    rng = np.random.default_rng(seed)
    n = sum(map(len, members))
    for _ in range(RESAMPLES):
        drawn = np.concatenate([g[rng.integers(len(g), size=len(g))] for g in members])
        yield np.bincount(drawn, minlength=n)


def _percentiles(values: ArrayLike) -> tuple[float, float]:
    low, high = np.percentile(np.asarray(values, dtype=np.float64), (2.5, 97.5))
    return float(low), float(high)


def reliability(confidences: ArrayLike, correct: ArrayLike) -> list[ReliabilityBin]:
    """The reliability curve: bins of equal width in confidence; empty ones are left out.

    Args:
        confidences: 0 to 1, shape (n,).
        correct: whether each answer is right, shape (n,).
    """
    c, right = np.asarray(confidences, dtype=np.float64), np.asarray(correct, dtype=bool)
    which = np.minimum((c * RELIABILITY_BINS).astype(int), RELIABILITY_BINS - 1)
    curve = []
    for i in np.unique(which):
        hits, count = int(right[which == i].sum()), int((which == i).sum())
        interval = wilson_interval(hits, count)
        curve.append(ReliabilityBin(float(c[which == i].mean()), hits / count, *interval, count))
    return curve


def calibration_error(curve: Sequence[ReliabilityBin]) -> float | None:
    """Mean gap between claimed and true share of right answers, by frame; None without answers.

    The expected calibration error of Naeini et al., "Obtaining well calibrated probabilities using
    Bayesian binning" (2015).
    """
    count = sum(b.answers for b in curve)
    return sum(b.answers * abs(b.confidence - b.share) for b in curve) / count if count else None
