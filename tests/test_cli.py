"""The command line: arguments, exit codes, files."""

import io
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tiny_urdf
import warp as wp
from PIL import Image
from rich.console import Console

import inhand
from inhand import Camera, EstimatorConfig, PoseEstimate, PoseEstimator
from inhand.cli import common, main
from inhand.cli.common import waiting
from inhand.geometry.mesh import box
from inhand.io import read_result

T_HAND, T_OBJECT = np.eye(4), np.eye(4)
T_HAND[:3, 3] = -0.03, 0, 0.3
T_OBJECT[:3, 3] = 0.03, 0, 0.3
FOUND = PoseEstimate(True, "", T_OBJECT, {"bend": 0.5}, T_HAND, 0.75, timings={"wrist": 0.012})
NOT_FOUND = PoseEstimate(False, "the object is hidden", None, {"bend": 0.5}, T_HAND, 0.0)


class Calls(list):
    """What the estimator was called with; `answer` is what it returns."""

    answer = FOUND


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Calls:
    """Replaces the estimation, which has its own tests."""
    calls = Calls()

    def estimate(
        self: PoseEstimator, depth: Any, camera: Camera, T_camera_hand: Any
    ) -> PoseEstimate:
        calls.append((self, depth, camera, T_camera_hand))
        return calls.answer

    monkeypatch.setattr(PoseEstimator, "estimate", estimate)
    monkeypatch.setattr("inhand.cli.common.load_kernels", lambda device, console: None)
    return calls


@pytest.fixture
def files(tmp_path: Path) -> dict[str, str]:
    """The five input files by option."""
    depth = np.full((120, 160), 400, dtype=np.uint16)
    Image.fromarray(depth).save(tmp_path / "depth.png")
    camera = {"fx": 300, "fy": 300, "cx": 79.5, "cy": 59.5, "width": 160, "height": 120}
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    (tmp_path / "hand_pose.json").write_text(json.dumps({"T_camera_hand": T_HAND.tolist()}))
    parts = (
        tiny_urdf.link("palm"),
        tiny_urdf.link("finger"),
        tiny_urdf.joint("bend", "palm", "finger"),
    )
    hand = tiny_urdf.write(tmp_path, *parts)
    write_box(tmp_path / "object.obj")
    return {
        "--depth": str(tmp_path / "depth.png"),
        "--camera": str(tmp_path / "camera.json"),
        "--hand": str(hand),
        "--object": str(tmp_path / "object.obj"),
        "--hand-pose": str(tmp_path / "hand_pose.json"),
    }


def write_box(path: Path, scale: float = 1.0) -> None:
    mesh = box((0.03, 0.05, 0.02))
    lines = ["v {} {} {}".format(*vertex) for vertex in scale * mesh.vertices]
    lines += ["f {} {} {}".format(*face) for face in mesh.faces + 1]
    path.write_text("\n".join(lines))


def estimate(files: dict[str, str], *more: str) -> int:
    return main(["estimate", *(word for pair in files.items() for word in pair), *more])


def test_found(
    files: dict[str, str], calls: Calls, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, picture = tmp_path / "new" / "result.json", tmp_path / "new" / "picture.png"
    assert estimate(files, "--out", str(out), "--picture", str(picture)) == 0
    ((estimator, depth, camera, T),) = calls
    assert (depth == np.float32(0.4)).all()
    assert camera.fx == 300
    np.testing.assert_array_equal(T, T_HAND)
    assert estimator.hand.hand.joint_names == ("bend",)
    assert estimator.object.model.name == "object"
    np.testing.assert_array_equal(read_result(out).T_camera_object, T_OBJECT)
    assert Image.open(picture).width > 1000
    printed, said = capsys.readouterr()
    assert "object, 62 mm across" in printed
    assert str(picture) in said.replace("\n", "")
    assert "0.75" in printed
    assert "28.6 deg  bend" in printed


def test_not_found_says_why(
    files: dict[str, str], calls: Calls, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calls.answer = NOT_FOUND
    out, picture = tmp_path / "result.json", tmp_path / "picture.png"
    assert estimate(files, "--out", str(out), "--picture", str(picture)) == 1
    assert "the object is hidden" in capsys.readouterr().out
    assert not read_result(out).found
    assert picture.exists()


def test_options_reach_the_estimator(files: dict[str, str], calls: Calls) -> None:
    assert estimate(files, "--preset", "paper", "--seed", "7", "--device", "cpu") == 0
    config = calls[0][0].config
    assert config.seed == 7
    assert config.hypotheses == EstimatorConfig.paper().hypotheses


def test_unit_of_the_mesh(files: dict[str, str], calls: Calls) -> None:
    text = Path(files["--object"]).read_text().splitlines()
    scaled = [
        "v {} {} {}".format(*(1000 * float(x) for x in line.split()[1:]))
        if line[0] == "v"
        else line
        for line in text
    ]
    Path(files["--object"]).write_text("\n".join(scaled))
    assert estimate(files, "--unit", "mm") == 0
    assert calls[0][0].object.model.diameter == pytest.approx(0.0616, abs=1e-3)


BAD = [
    ("--depth", "missing.png", "missing.png"),
    ("--camera", "missing.json", "missing.json"),
    ("--hand", "missing.urdf", "missing.urdf"),
    ("--object", "missing.ply", "missing.ply"),
    ("--hand-pose", "missing.json", "missing.json"),
    ("--depth", "camera.json", "expected a 16-bit PNG"),
    ("--camera", "hand_pose.json", "lacks fx"),
    ("--camera", "depth.png", "not JSON"),
    ("--hand", "camera.json", "not a URDF"),
    ("--object", "camera.json", "camera.json"),
    ("--hand-pose", "camera.json", "lacks the key"),
    ("--rgb", "hand.urdf", "cannot read the image"),
    ("--unit", "=parsec", "parsec"),
    ("--device", "=toaster", "toaster"),
]


@pytest.mark.parametrize(("option", "value", "message"), BAD)
def test_bad_input(
    files: dict[str, str],
    calls: Calls,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    option: str,
    value: str,
    message: str,
) -> None:
    files[option] = value.removeprefix("=") if value[0] == "=" else str(tmp_path / value)
    assert estimate(files) == 2
    *_, complaint = capsys.readouterr().err.splitlines()
    assert complaint.startswith("inhand: ")
    assert message in complaint
    assert "Traceback" not in complaint
    assert not calls


def test_a_log_is_told_what_takes_long(monkeypatch: pytest.MonkeyPatch) -> None:
    text = io.StringIO()
    log = Console(file=text)
    with waiting(log, "Soon done") as say:
        say("Nearly done")
    monkeypatch.setattr(common, "PATIENCE", 0.0)
    with waiting(log, "Building") as say:
        while "Building" not in text.getvalue():
            time.sleep(0.01)
        say("Still building")
    assert text.getvalue() == "Building\n"


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"{inhand.__version__}\n"


def test_result_that_cannot_be_written(
    files: dict[str, str], calls: Calls, capsys: pytest.CaptureFixture[str]
) -> None:
    assert estimate(files, "--out", files["--depth"] + "/result.json") == 2
    assert "cannot write" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", ["", "nonsense", "estimate", "demo --rgb c.png", "bench --limit x"]
)
def test_wrong_arguments(words: str) -> None:
    with pytest.raises(SystemExit) as stop:
        main(words.split())
    assert stop.value.code == 2


@pytest.mark.parametrize("command", ["demo", "estimate", "bench", "synth", "warmup"])
def test_help_of_every_command(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main([command, "--help"])
    assert stop.value.code == 0
    assert f"inhand {command}" in capsys.readouterr().out


def test_bench_without_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", str(tmp_path)]) == 2
    assert "holds no frames" in capsys.readouterr().err


def test_interrupt(files: dict[str, str], calls: Calls, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(PoseEstimator, "estimate", stop)
    assert estimate(files) == 130


def test_warmup(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    devices: list[str] = []
    monkeypatch.setattr("inhand.cli.common.load_kernels", lambda device, _: devices.append(device))
    of_tracker = wp.get_module("inhand.tracking.kernels")
    of_tracker.unload()
    assert not of_tracker.execs
    assert main(["warmup", "--device", "cpu"]) == 0
    assert devices == ["cpu"]
    assert of_tracker.execs, "the tracker's kernels are loaded"
    assert "ready" in capsys.readouterr().out


def test_demo_from_a_shell(tmp_path: Path) -> None:
    """The whole pipeline on the built-in scene, as a user starts it."""
    picture = tmp_path / "demo.png"
    command = [sys.executable, "-c", "import sys, inhand.cli; sys.exit(inhand.cli.main())"]
    done = subprocess.run(
        [*command, "demo", "--out", str(picture)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "Against the truth" in done.stdout
    assert Image.open(picture).width > 1000


def test_real_frame(shared_data: Path, tmp_path: Path) -> None:
    frame, out = shared_data / "real_frame", tmp_path / "result.json"
    files = {
        "--depth": frame / "depth.png",
        "--camera": frame / "camera.json",
        "--hand": shared_data / "hands" / "t42" / "hand_T42b.urdf",
        "--object": shared_data / "objects" / "elliptic_cylinder.ply",
        "--hand-pose": frame / "hand_pose.json",
        "--rgb": frame / "rgb.png",
        "--out": out,
        "--picture": tmp_path / "picture.png",
        "--device": "cpu",
    }
    assert estimate({option: str(path) for option, path in files.items()}) in (0, 1)
    result = read_result(out)
    assert result.T_camera_hand is not None
    reference = json.loads((frame / "reference_fit.json").read_text())["T_camera_hand"]
    assert np.linalg.norm(result.T_camera_hand[:3, 3] - np.array(reference)[:3, 3]) < 0.005
