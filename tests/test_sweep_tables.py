"""Results of frames that were made harder step by step, as tables and curves."""

from dataclasses import replace

import pytest
from made_up_results import pipeline, result, study_of_everything

from inhand.evaluation.results import FrameResult
from inhand.evaluation.study import Study
from inhand.evaluation.sweep_tables import sweep_table, sweep_tables
from inhand.evaluation.sweeps import curve


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    return study_of_everything(tmp_path_factory.mktemp("run"))


def swept() -> list[FrameResult]:
    """Six frames as they are; with noise, a third of them is right, and a third has no answer."""
    found = [pipeline(i, 0.001) for i in range(6)]
    for i, (adi, confidence) in enumerate([(0.001, 0.9), (0.02, 0.7), (0.02, 0.3)]):
        made = pipeline(i, adi, perturbation={"noise": 3.0})
        found.append(replace(made, confidence=confidence, seconds=0.1 * (i + 1)))
    found.append(replace(result(3), perturbation={"noise": 3.0}, outcome="unreadable", adi=None))
    found += [pipeline(i, None, perturbation={"noise": 1.0}) for i in range(2)]
    return found + [pipeline(i, 0.001, perturbation={"wall": 0.1}) for i in range(2)]


def test_a_sweep_as_a_table() -> None:
    table = sweep_table("set, method", "noise", swept())
    assert [row[0] for row in table.rows] == ["as it is", "1 x", "3 x"], "the levels in order"
    shown = dict(zip(table.columns[1:], table.rows[2][1:], strict=True))
    assert shown == {
        "frames": "3",
        "recall [%]": "33.3 (6-79)",
        "found [%]": "100",
        "median confidence": "0.70",
        "AUROC": "1.00",
        "sure but wrong [%]": "33",
        "median time [ms]": "200",
        "lost at": "selection 2",
    }
    nothing_found = dict(zip(table.columns[1:], table.rows[1][1:], strict=True))
    assert nothing_found["found [%]"] == "0"
    assert nothing_found["AUROC"] == "-"


def test_a_table_for_every_data_set_and_sweep() -> None:
    found = sweep_tables([*swept(), replace(result(0, data_set="b"), perturbation={"crop": 0.2})])
    assert [t.title for t in found] == [
        "b, inhand: crop",
        "clean, inhand: noise",
        "clean, inhand: wall",
    ]
    assert len(found[0].rows) == 1


def test_a_curve_starts_from_frames_as_they_are_where_they_have_a_place_on_it() -> None:
    noise, wall = curve("noise", swept()), curve("wall", swept())
    assert list(noise) == [0.0, 1.0, 3.0]
    assert [r.frame[-1] for r in noise[0.0]] == ["0", "1", "2", "3"], "the frames of the sweep"
    assert list(wall) == [0.1]
    assert curve("crop", swept()) == {}


def test_sweeps_are_apart_from_perturbed_starts(study: Study) -> None:
    assert list(study.swept) == ["inhand"]
    assert list(study.perturbed) == ["icp"]
    assert all(not r.perturbation for r in study.by_method["inhand"])
