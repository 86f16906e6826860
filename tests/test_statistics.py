"""Intervals, areas and reliability against closed forms and independent implementations."""

import numpy as np
import pytest
from scipy import stats
from scipy.stats import binomtest, mannwhitneyu

from inhand.errors import InputError
from inhand.evaluation import statistics

RNG = np.random.default_rng(7)


@pytest.mark.parametrize(("hits", "trials"), [(0, 10), (3, 10), (10, 10), (1, 1), (117, 132)])
def test_wilson_interval_against_scipy(hits: int, trials: int) -> None:
    expected = binomtest(hits, trials).proportion_ci(0.95, method="wilson")
    assert statistics.wilson_interval(hits, trials) == pytest.approx(tuple(expected), abs=1e-4)


def test_wilson_interval_of_nothing() -> None:
    assert statistics.wilson_interval(0, 0) == (0.0, 1.0)
    with pytest.raises(InputError, match="3 successes of 2"):
        statistics.wilson_interval(3, 2)


def test_auroc_closed_forms() -> None:
    assert statistics.auroc([0.1, 0.9], [False, True]) == 1.0
    assert statistics.auroc([0.9, 0.1], [False, True]) == 0.0
    assert statistics.auroc([0.5, 0.5], [False, True]) == 0.5
    assert statistics.auroc([0.5, 0.7], [True, True]) is None
    assert statistics.auroc([], []) is None


def test_auroc_against_the_rank_test() -> None:
    scores = RNG.integers(0, 12, size=200) / 12
    correct = RNG.random(200) < 0.2 + 0.6 * scores
    u = mannwhitneyu(scores[correct], scores[~correct]).statistic
    expected = u / (correct.sum() * (~correct).sum())
    assert statistics.auroc(scores, correct) == pytest.approx(expected)


def test_mean_and_its_interval_against_scipy() -> None:
    values = RNG.gamma(2.0, size=80)
    found = statistics.mean(values)
    expected = stats.bootstrap(
        (values,), np.mean, n_resamples=4000, method="percentile", rng=1
    ).confidence_interval
    assert found.value == pytest.approx(values.mean())
    assert (found.low, found.high) == pytest.approx(tuple(expected), abs=0.05)
    assert statistics.mean(values) == found, "one seed, one answer"
    assert statistics.mean(values, seed=1) != found


def test_class_mean_weighs_every_group_alike() -> None:
    values = np.array([1.0] * 90 + [0.0] * 10)
    groups = ["many"] * 90 + ["few"] * 10
    assert statistics.mean(values, groups) == pytest.approx((0.5, 0.5, 0.5))
    assert statistics.mean(values).value == pytest.approx(0.9)


def test_interval_of_a_class_mean_against_its_standard_error() -> None:
    groups = np.repeat(["a", "b", "c"], [400, 100, 200])
    values = RNG.random(700) + (groups == "b")
    parts = [values[groups == g] for g in "abc"]
    error = np.sqrt(sum(p.var() / len(p) for p in parts)) / 3
    found = statistics.mean(values, list(groups))
    middle = np.mean([p.mean() for p in parts])
    assert found == pytest.approx((middle, middle - 1.96 * error, middle + 1.96 * error), abs=4e-3)


def test_means_of_nothing_and_of_one() -> None:
    assert statistics.mean([]) == (None, None, None)
    assert statistics.mean([0.25]) == (0.25, 0.25, 0.25)


def test_bootstrap_of_a_statistic() -> None:
    scores = RNG.random(300)
    correct = RNG.random(300) < scores
    value, low, high = statistics.bootstrap(statistics.auroc, scores, correct)
    assert value is not None
    assert low is not None
    assert high is not None
    assert value == statistics.auroc(scores, correct)
    # Hanley and McNeil's standard error of an area under the curve (1982).
    q1, q2 = value / (2 - value), 2 * value**2 / (1 + value)
    hits, misses = correct.sum(), (~correct).sum()
    variance = value * (1 - value) + (hits - 1) * (q1 - value**2) + (misses - 1) * (q2 - value**2)
    error = np.sqrt(variance / hits / misses)
    assert (low, high) == pytest.approx((value - 1.96 * error, value + 1.96 * error), abs=0.02)
    assert statistics.bootstrap(statistics.auroc, [0.5], [True]) == (None, None, None)


def test_reliability_curve_by_hand() -> None:
    confidences = [0.04, 0.06, 0.55, 0.55, 0.58, 1.0]
    curve = statistics.reliability(confidences, [False, False, True, True, False, True])
    assert [b.answers for b in curve] == [2, 3, 1]
    assert [b.confidence for b in curve] == pytest.approx([0.05, 0.56, 1.0])
    assert [b.share for b in curve] == pytest.approx([0, 2 / 3, 1])
    assert (curve[1].low, curve[1].high) == statistics.wilson_interval(2, 3)
    expected = (2 * 0.05 + 3 * (2 / 3 - 0.56) + 0) / 6
    assert statistics.calibration_error(curve) == pytest.approx(expected)
    assert statistics.calibration_error(statistics.reliability([], [])) is None


def test_a_calibrated_confidence_has_no_calibration_error() -> None:
    confidences = RNG.random(40000)
    curve = statistics.reliability(confidences, RNG.random(40000) < confidences)
    assert statistics.calibration_error(curve) == pytest.approx(0, abs=0.01)
