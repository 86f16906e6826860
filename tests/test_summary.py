"""What a benchmark's summary says of made-up results."""

from dataclasses import replace

import pytest
from made_up_results import result

from inhand.evaluation.summary import summarise


def test_measures_of_a_summary_by_hand() -> None:
    results = [result(i, adi=adi) for i, adi in enumerate([0.001, 0.004, 0.010, None])]
    measures = {k: v["frames"]["value"] for k, v in summarise(results)["measures"].items()}
    assert measures["recall"] == 0.5
    assert measures["area"] == pytest.approx((0.95 + 0.8 + 0.5 + 0) / 4)
    assert measures["recall from truth"] == 0.5
    assert measures["recall ADD"] == 0.25
    assert measures["MSSD"] == measures["MSPD"] == pytest.approx(0.5 * 3 / 4)
    assert measures["VSD"] == pytest.approx(0.25 * 3 / 4)
    assert measures["BOP"] == pytest.approx((0.375 + 0.375 + 0.1875) / 3)


def test_area_is_that_under_the_recall_curve() -> None:
    errors = [0.0005 * k for k in range(60)]
    results = [result(i, adi=adi) for i, adi in enumerate(errors)]
    limits = [0.020 * (k + 0.5) / 4000 for k in range(4000)]
    recall = [sum(e < limit for e in errors) / len(errors) for limit in limits]
    area = summarise(results)["measures"]["area"]["frames"]["value"]
    assert area == pytest.approx(sum(recall) / len(recall), abs=1e-3)


def test_mean_of_objects_weighs_them_alike() -> None:
    results = [result(0, adi=0.001), *(result(i, adi=0.02) for i in (1, 3, 5))]
    recall = summarise(results)["measures"]["recall"]
    assert recall["frames"]["value"] == 0.25
    assert recall["objects"]["value"] == 0.5


def test_times_have_all_quantiles() -> None:
    results = [result(i, seconds=(i + 1) / 100) for i in range(100)]
    time = summarise(results)["time"]["whole estimate"]
    assert time["mean"] == pytest.approx(0.505)
    assert time["median"] == pytest.approx(0.505)
    assert (time["p95"], time["p99"]) == pytest.approx((0.9505, 0.9901))
    assert time["deviation"] == pytest.approx(0.288661, rel=1e-4)


def test_a_frame_of_unknown_visibility_is_in_no_bin() -> None:
    summary = summarise([replace(result(0), visible_share=None), result(1)])
    assert list(summary["recall"]["visible share"]) == ["30-60 %"]
