"""Answers in BOP's CSV format: what is written is read back, broken lines are named."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bop_nonsense import assert_same, write_dataset

from inhand.datasets.bop_results import BopResult, read_results, write_results
from inhand.datasets.frames import find_frames
from inhand.errors import InputError
from inhand.evaluation.bop_export import write_bop_results
from inhand.evaluation.results import FrameResult
from inhand.geometry.se3 import exp


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "nonsense")


def test_results_come_back_as_they_were(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    results = [
        BopResult(1, i, 2, float(rng.normal()), exp(rng.normal(size=6)), float(rng.random()))
        for i in range(20)
    ]
    path = tmp_path / "new" / "inhand_set-test.csv"
    write_results(path, results)
    lines = path.read_text().splitlines()
    assert lines[0] == "scene_id,im_id,obj_id,score,R,t,time"
    fields = lines[3].split(",")
    assert [len(field.split()) for field in fields] == [1, 1, 1, 1, 9, 3, 1]
    np.testing.assert_allclose(
        [float(x) for x in fields[5].split()], results[2].T_camera_object[:3, 3] * 1000
    )
    again = read_results(path)
    assert len(again) == len(results)
    for one, other in zip(again, results, strict=True):
        assert_same(vars(one), vars(other))
    (tmp_path / "headless.csv").write_text("1,2,3,0.5,1 0 0 0 1 0 0 0 1,0 0 500,-1\n")
    (result,) = read_results(tmp_path / "headless.csv")
    assert result.T_camera_object[2, 3] == 0.5


@pytest.mark.parametrize(
    "line",
    [
        "1,2,3,0.5",
        "1,2,3,high,1 0 0 0 1 0 0 0 1,0 0 500,-1",
        "1,2,3,0.5,1 0 0 0 1 0 0 0,0 0 500,-1",
        "1,2,3,0.5,2 0 0 0 1 0 0 0 1,0 0 500,-1",
        "1,2,3,0.5,1 0 0 0 1 0 0 0 1,0 0,-1",
        "1,2,3,0.5,1 0 0 0 1 0 0 0 1,0 0 far,-1",
        "1,2,3,0.5,1 0 0 0 1 0 0 0 1,0 0 nan,-1",
    ],
)
def test_a_line_that_is_no_result_is_named(tmp_path: Path, line: str) -> None:
    (tmp_path / "bad.csv").write_text(line + "\n")
    with pytest.raises(InputError, match=r"result 0 in .*bad\.csv"):
        read_results(tmp_path / "bad.csv")
    with pytest.raises(InputError, match=r"gone\.csv"):
        read_results(tmp_path / "gone.csv")


def test_a_benchmarks_answers_become_a_csv_file(dataset: Path, tmp_path: Path) -> None:
    path = find_frames([dataset])[-1]
    T = exp(np.array([0.1, 0.2, 0.3, 0.01, 0.02, 0.5]))
    answer = FrameResult(
        "f", str(path), "answer", T_camera_object=T.tolist(), confidence=0.75, seconds=0.25
    )
    no_answer = FrameResult("g", str(path), "no answer")
    other = replace(answer, file=str(tmp_path / "a.npz"))
    (written,) = write_bop_results(tmp_path, "in-hand", [answer, no_answer, other])
    assert written.name == "inhand_nonsense-test.csv"
    (result,) = read_results(written)
    assert (result.scene_id, result.image_id, result.score, result.seconds) == (2, 11, 0.75, 0.25)
    assert_same(result.T_camera_object, T)
    assert not write_bop_results(tmp_path, "inhand", [other])
