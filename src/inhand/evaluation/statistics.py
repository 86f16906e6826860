"""How sure a share, a mean or a confidence is."""

from collections.abc import Callable, Hashable, Sequence
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
    """Mean of the group means, every group counting alike; without groups the plain mean.

    The interval is the bootstrap's (Efron 1979, percentiles), resampled within the groups.

    Args:
        values: shape (n,).
        groups: group of each value, length n.
        seed: seed of the resampling.
    """
    v = np.asarray(values, dtype=np.float64)
    if not len(v):
        return Estimate(None, None, None)
    members = _members(len(v), groups)
    weight = np.empty(len(v))
    for group in members:
        weight[group] = 1 / len(members) / len(group)
    weighted = weight * v
    means = weighted[_resamples(members, seed)].sum(axis=1)
    return Estimate(float(weighted.sum()), *_percentiles(means))


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
    picks = _resamples(_members(len(columns[0]), None), seed)
    found = [statistic(*(column[pick] for column in columns)) for pick in picks]
    return Estimate(value, *_percentiles([f for f in found if f is not None]))


def _members(count: int, groups: Sequence[Hashable] | None) -> list[NDArray[np.int64]]:
    """Indices of the members of every group."""
    by_group: dict[Any, list[int]] = {}
    for i in range(count):
        by_group.setdefault(None if groups is None else groups[i], []).append(i)
    return [np.array(indices) for indices in by_group.values()]


def _resamples(members: list[NDArray[np.int64]], seed: int) -> NDArray[np.int64]:
    """Indices drawn with replacement within the groups, shape (RESAMPLES, n)."""
    rng = np.random.default_rng(seed)
    return np.concatenate(
        [group[rng.integers(len(group), size=(RESAMPLES, len(group)))] for group in members], axis=1
    )


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
