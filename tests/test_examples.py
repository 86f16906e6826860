"""The examples do what they say; each is a script that a newcomer runs as it is."""

import re
from pathlib import Path

import numpy as np
import pytest
from example_runs import EXAMPLES, run_example

from inhand.builtin.hand import write_hand
from inhand.builtin.objects import OBJECTS
from inhand.evaluation.metrics import ObjectMetric


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short_and_says_what_it_is(path: Path) -> None:
    lines = path.read_text().splitlines()
    assert 20 <= len(lines) <= 50
    assert re.fullmatch(r'"""[A-Z].*\.(""")?', lines[0]), lines[0]


def test_examples_are_numbered_without_gaps() -> None:
    assert [int(path.stem[:2]) for path in EXAMPLES] == list(range(1, len(EXAMPLES) + 1))


def test_estimate() -> None:
    run = run_example("01_estimate")
    estimate, scene = run.names["estimate"], run.names["scene"]
    assert estimate.found
    assert ObjectMetric(scene.obj).adi(estimate.T_camera_object, scene.T_camera_object) < 0.002
    assert run.files == ["estimate.png"]


def test_your_own_hand_written_by_the_example() -> None:
    names = run_example("02_your_own_hand").names
    (finger,) = names["hand"].fingers  # one joint drives both sides
    assert len(finger.links) == 2
    truth = names["scene"].joint_positions
    assert names["estimate"].joint_positions == pytest.approx(truth, abs=0.001)


def test_your_own_hand_given_by_path(tmp_path: Path) -> None:
    run = run_example("02_your_own_hand", str(write_hand(tmp_path)))
    assert len(run.names["hand"].fingers) == 2
    assert "finger_2_distal_joint: 0.000 to 1.570" in run.printed
    assert run.files == []


def test_your_own_object_made_by_the_example() -> None:
    run = run_example("03_your_own_object")
    assert 'Try unit="mm"' in run.printed
    assert run.names["obj"].diameter == pytest.approx(np.hypot(0.09, 0.027 + 0.036), rel=1e-3)
    assert abs(run.names["symmetry"].axis) == pytest.approx(np.array([0, 0, 1]), abs=0.02)
    # The pose in the example is a quarter turn about the axis, then a shift.
    assert run.names["least_turned"][:3, :3] == pytest.approx(np.eye(3), abs=0.03)


def test_your_own_object_given_by_path(tmp_path: Path) -> None:
    mesh = OBJECTS["cuboid"]()
    path = tmp_path / "cuboid.obj"
    vertices = "".join(f"v {x} {y} {z}\n" for x, y, z in 100 * mesh.vertices)
    path.write_text(vertices + "".join(f"f {a} {b} {c}\n" for a, b, c in mesh.faces + 1))
    run = run_example("03_your_own_object", str(path), "cm")
    assert run.names["obj"].diameter == pytest.approx(mesh.diameter)
    assert len(run.names["symmetry"].rotations) == 8  # a square prism's
    assert run.files == []


def test_read_the_result() -> None:
    printed = run_example("04_read_the_result").printed
    assert "use it" in printed
    (unseen,) = re.findall(r"object without readings: found True with confidence (\S+)", printed)
    assert float(unseen) < 0.5
    assert printed.count("found False because") == 2
    assert "InputError: the median depth" in printed


def test_tune_the_config() -> None:
    printed = run_example("05_tune_the_config").printed
    solved = dict(re.findall(r"^(.+): (\d+) of 8 solved", printed, re.MULTILINE))
    assert int(solved["rough wrist"]) >= 7
    assert int(solved["default"]) < int(solved["rough wrist"])
    assert "InputError: WristConfig.prior_sd_translation" in printed


def test_data_set() -> None:
    run = run_example("06_data_set")
    assert [result.outcome for result in run.names["results"]] == ["answer"] * 4
    assert run.names["recall"]["share"] == 1
    assert run.files == ["data-set"]


def test_stream() -> None:
    run = run_example("08_stream")
    counts, scene = run.names["summary"].counts, run.names["scene"]
    assert (counts.processed, counts.found, counts.without_wrist) == (3, 2, 1)
    T = np.array(run.names["result"]["T_camera_object"])
    assert ObjectMetric(scene.obj).adi(T, scene.T_camera_object) < 0.002
    assert run.files == ["results.jsonl", "stream"]
