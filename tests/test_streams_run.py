"""`inhand run` on the command line: real recordings in, results out."""

import json
import os
import signal
import socket
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from any_stream import found
from ros_recording import MS, OPTICAL, Messages, Sent, storage_file, write_recording
from rosbags import rosbag1, rosbag2

from inhand import Camera, PoseEstimate, PoseEstimator
from inhand.builtin.hand import write_hand
from inhand.cli import main
from inhand.datasets.bop import HandInfo
from inhand.datasets.bop_models import write_models
from inhand.datasets.bop_writer import finish_scene, write_image
from inhand.evaluation.hand_errors import wrist_error
from inhand.evaluation.metrics import ObjectMetric
from inhand.geometry.mesh import TriangleMesh
from inhand.streams.bag import BagKind
from inhand.synth.dataset import annotated
from inhand.synth.scene import Scene
from inhand.urdf import read_urdf
from inhand.viewer.frames import ViewedFrame
from inhand.viewer.live import LiveView

START = 1_700_000_000 * 1000 * MS
FRAMES = 4


def write_mesh(path: Path, mesh: TriangleMesh) -> Path:
    lines = ["v {} {} {}".format(*vertex) for vertex in mesh.vertices]
    lines += ["f {} {} {}".format(*face) for face in mesh.faces + 1]
    path.write_text("\n".join(lines))
    return path


@pytest.fixture
def models(tmp_path: Path, scenes: list[Scene]) -> list[str]:
    """Options that name the hand and the object of the first scene."""
    hand = write_hand(tmp_path / "hand")
    mesh = write_mesh(tmp_path / "cylinder.obj", scenes[0].obj.mesh)
    return ["--hand", str(hand), "--object", str(mesh), "--device", "cpu"]


def recording_of(scene: Scene, root: str, make: Messages, encoding: str = "32FC1") -> list[Sent]:
    """The scene's image several times, and a wrist that tf tells of before and after it."""
    depth = scene.depth if encoding == "32FC1" else np.round(scene.depth * 1000).astype(np.uint16)
    sent = [Sent("/camera/camera_info", START, make.camera_info(scene.camera))]
    for i in range(-1, FRAMES + 1):
        time_ns = START + 33 * MS * i
        wrist = make.transforms((OPTICAL, root, scene.T_camera_hand_given, time_ns + 5 * MS))
        sent.append(Sent("/tf", time_ns + 10 * MS, wrist))
        if 0 <= i < FRAMES:
            image = make.image(depth, time_ns, encoding)
            sent.append(Sent("/camera/image_rect", time_ns, image))
    return sent


def lines_of(path: Path) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """The results, and the summary."""
    *results, last = [json.loads(line) for line in path.read_text().splitlines()]
    return results, last["summary"]


@pytest.mark.parametrize(
    ("kind", "encoding"), [("ros1", "32FC1"), ("sqlite3", "16UC1"), ("mcap", "32FC1")]
)
def test_a_recording_end_to_end(
    tmp_path: Path, scenes: list[Scene], models: list[str], kind: BagKind, encoding: str
) -> None:
    scene = scenes[0]
    root = read_urdf(models[1]).root
    source = write_recording(tmp_path, kind, lambda make: recording_of(scene, root, make, encoding))
    out, bag = tmp_path / "out.jsonl", tmp_path / ("out.bag" if kind == "ros1" else "out")
    args = ["--out", str(out), "--bag", str(bag), "--limit", "2"]
    assert main(["run", str(source), *models, *args]) == 0
    results, summary = lines_of(out)
    assert summary["found"] == summary["processed"] == 2
    assert [r["time_ns"] for r in results] == [START, START + 33 * MS]
    for result in results:
        assert result["frame_id"] == OPTICAL
        adi = ObjectMetric(scene.obj).adi(
            np.array(result["T_camera_object"]), scene.T_camera_object
        )
        assert adi < 0.002
        wrist = wrist_error(np.array(result["T_camera_hand"]), scene.T_camera_hand)
        assert wrist.translation < 0.002
        assert result["joint_positions"].keys() == scene.joint_positions.keys()
        assert result["timings"]
    with rosbag1.Reader(bag) if kind == "ros1" else rosbag2.Reader(bag) as reader:
        counts = {topic: info.msgcount for topic, info in reader.topics.items()}
    assert counts == dict.fromkeys(
        ["/inhand/object_pose", "/inhand/hand_pose", "/inhand/joint_states", "/inhand/detections"],
        2,
    )


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Replaces the estimation, which has its own tests."""
    calls: list[Any] = []

    def estimate(self: Any, depth: Any, camera: Camera, T_camera_hand: Any) -> PoseEstimate:
        calls.append((depth, camera, T_camera_hand))
        return found()

    monkeypatch.setattr(PoseEstimator, "estimate", estimate)
    monkeypatch.setattr("inhand.cli.common.load_kernels", lambda device, console: None)
    return calls


@pytest.fixture
def source(tmp_path: Path, scenes: list[Scene], models: list[str]) -> Path:
    root = read_urdf(models[1]).root
    return write_recording(tmp_path, "mcap", lambda make: recording_of(scenes[0], root, make))


@pytest.fixture
def broken_off(source: Path) -> Path:
    """The recording without its end."""
    file = storage_file(source)
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 6 // 10])
    return source


def test_default_output_and_what_is_said(
    tmp_path: Path,
    models: list[str],
    calls: list[Any],
    source: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["run", str(source), *models]) == 0
    results, summary = lines_of(tmp_path / "out" / "run-recording.jsonl")
    assert len(results) == len(calls) == FRAMES
    assert summary["stopped"] == ""
    said = " ".join(capsys.readouterr().err.split())
    assert "depth: /camera/image_rect, 4 images" in said
    assert "camera: /camera/camera_info" in said
    assert "4 processed, 4 found, 0 dropped" in said
    assert "Results: out/run-recording.jsonl" in said
    assert main(["run", str(source), *models]) == 2
    assert "exists already" in capsys.readouterr().err


def test_nothing_found_is_exit_code_1(
    tmp_path: Path,
    models: list[str],
    calls: list[Any],
    source: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    nothing = PoseEstimate(False, "hidden", None, {}, None, 0.0)
    monkeypatch.setattr(PoseEstimator, "estimate", lambda *args: nothing)
    assert main(["run", str(source), *models, "--out", str(tmp_path / "o.jsonl")]) == 1
    assert "The first without an answer: image 0: hidden" in capsys.readouterr().err


def test_bad_input_leaves_no_output(
    tmp_path: Path,
    models: list[str],
    calls: list[Any],
    source: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "o.jsonl"
    assert main(["run", str(source), *models, "--out", str(out), "--depth-topic", "/d"]) == 2
    said = capsys.readouterr().err
    assert "/camera/image_rect (sensor_msgs/msg/Image, 4)" in said
    assert main(["run", str(source), *models, "--out", str(out), "--rate", "0"]) == 2
    assert "rate must be positive" in capsys.readouterr().err
    assert not out.exists()


def test_a_truncated_recording_is_processed_then_said(
    tmp_path: Path,
    models: list[str],
    calls: list[Any],
    broken_off: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "o.jsonl"
    assert main(["run", str(broken_off), *models, "--out", str(out)]) == 2
    results, summary = lines_of(out)
    assert len(results) == summary["processed"] == 2
    assert "damaged or was never finished" in summary["stopped"]
    assert "damaged or was never finished" in capsys.readouterr().err


def test_the_first_problem_is_said_of_a_recording_that_breaks_off_too(
    tmp_path: Path,
    models: list[str],
    calls: list[Any],
    broken_off: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    args = ["--out", str(tmp_path / "o.jsonl"), "--longest-gap", "0.001"]
    assert main(["run", str(broken_off), *models, *args]) == 2
    assert "could not be estimated: image 0: no wrist pose" in capsys.readouterr().err


def test_ctrl_c_finishes_all_files(
    interruptible: None,
    tmp_path: Path,
    models: list[str],
    calls: list[Any],
    source: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def estimate(*args: Any) -> PoseEstimate:
        if len(calls) == 2:
            os.kill(os.getpid(), signal.SIGINT)
        calls.append(args)
        return found()

    monkeypatch.setattr(PoseEstimator, "estimate", estimate)
    out, bag = tmp_path / "o.jsonl", tmp_path / "bag"
    assert main(["run", str(source), *models, "--out", str(out), "--bag", str(bag)]) == 130
    results, summary = lines_of(out)
    assert len(results) == 2
    assert summary["stopped"] == "interrupted"
    with rosbag2.Reader(bag) as reader:
        assert reader.topics["/inhand/object_pose"].msgcount == 2


def test_options_reach_the_source(
    tmp_path: Path, models: list[str], calls: list[Any], source: Path, scenes: list[Scene]
) -> None:
    T = np.eye(4)
    T[2, 3] = 0.5
    (tmp_path / "pose.json").write_text(json.dumps({"T_camera_hand": T.tolist()}))
    c = scenes[0].camera
    camera = {"fx": 600, "fy": c.fy, "cx": c.cx, "cy": c.cy, "width": c.width, "height": c.height}
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    args = ["--out", str(tmp_path / "o.jsonl"), "--hand-pose", str(tmp_path / "pose.json")]
    args += ["--camera", str(tmp_path / "camera.json"), "--limit", "1", "--rate", "100"]
    assert main(["run", str(source), *models, *args]) == 0
    ((_, given, T_camera_hand),) = calls
    assert given.fx == 600
    np.testing.assert_array_equal(T_camera_hand, T)


def test_followed_from_image_to_image(tmp_path: Path, models: list[str], source: Path) -> None:
    out = tmp_path / "o.jsonl"
    assert main(["run", str(source), *models, "--out", str(out), "--track"]) == 0
    first, *others = lines_of(out)[0]
    assert len(others) == FRAMES - 1
    assert "hypotheses" in first["timings"]
    for result in others:
        assert result["found"]
        assert "hypotheses" not in result["timings"]
        covariance = np.array(result["covariance"])
        assert covariance.shape == (6, 6)
        assert np.linalg.eigvalsh(covariance).min() > 0


@pytest.fixture
def view(tmp_path: Path) -> list[str]:
    """Options for a page on a port that is free."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = str(free.getsockname()[1])
    return ["--out", str(tmp_path / "o.jsonl"), "--view", "--port", port]


class Waiting:
    """Instead of the event that a run with a page waits for: Ctrl-C, after looking around."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self.summaries: list[Any] = []
        """What the results file ended with when the run began to wait."""

    def wait(self) -> None:
        self.summaries.append(lines_of(self.out)[1])
        raise KeyboardInterrupt


@pytest.fixture
def waiting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Waiting:
    waiting = Waiting(tmp_path / "o.jsonl")
    monkeypatch.setattr("inhand.cli.run.Event", lambda: waiting)
    return waiting


@pytest.fixture
def said_on_page(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    said: list[str] = []
    monkeypatch.setattr(LiveView, "say", lambda self, text: said.append(text))
    return said


def test_a_page_shows_every_result_and_stays_until_ctrl_c(
    tmp_path: Path,
    models: list[str],
    source: Path,
    view: list[str],
    waiting: Waiting,
    said_on_page: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    shown: dict[str, Any] = {}
    monkeypatch.setattr(
        LiveView, "show", lambda self, frame, estimate, stages: shown.update({frame().name: stages})
    )
    assert main(["run", str(source), *models, *view]) == 0
    assert list(shown) == [r["frame"] for r in lines_of(tmp_path / "o.jsonl")[0]]
    assert all(stages.selection is not None for stages in shown.values())
    (summary,) = waiting.summaries
    assert summary["processed"] == FRAMES
    *running, ending = said_on_page
    assert running[0] == "**Running**: 1 processed, 1 found, 0 dropped"
    assert len(running) == FRAMES
    assert "The run has ended" in ending
    assert "4 processed, 4 found, 0 dropped" in ending
    said = " ".join(capsys.readouterr().err.split())
    assert f"Page: http://localhost:{view[-1]}" in said
    assert f"page stays at http://localhost:{view[-1]} until Ctrl-C" in said


@pytest.mark.parametrize("bent", [False, True])
def test_the_page_of_a_scene_shows_its_ground_truth(
    tmp_path: Path,
    scenes: list[Scene],
    models: list[str],
    calls: list[Any],
    view: list[str],
    waiting: Waiting,
    monkeypatch: pytest.MonkeyPatch,
    bent: bool,
) -> None:
    """Unless the hand is another one, which it says."""
    scene, folder = scenes[0], tmp_path / "set" / "test" / "000001"
    image = annotated(scene, 1)
    if bent:
        assert image.hand is not None
        image = replace(image, hand=replace(image.hand, joint_positions={"bend": 0.1}))
    write_image(folder, 3, image)
    finish_scene(folder, HandInfo(Path(models[1]), {}))
    write_models(tmp_path / "set" / "models", {1: scene.obj})
    shown: list[ViewedFrame] = []
    monkeypatch.setattr(
        LiveView, "show", lambda self, frame, estimate, stages: shown.append(frame())
    )
    assert main(["run", str(folder), *models, *view]) == 0
    (frame,) = shown
    truth = frame.truth(scene.hand)
    assert frame.depth.shape == scene.depth.shape
    if bent:
        assert truth is None
        assert "ground truth cannot be shown: unknown joint bend" in frame.remark
        return
    assert frame.colour is not None
    assert frame.labelled is not None
    assert truth is not None
    assert truth.T_camera_object is not None
    assert truth.T_camera_hand is not None
    np.testing.assert_allclose(truth.T_camera_object, scene.T_camera_object, atol=1e-12)
    np.testing.assert_allclose(truth.T_camera_hand, scene.T_camera_hand, atol=1e-12)
    np.testing.assert_array_equal(frame.labelled.wrist, frame.T_camera_hand)


def test_the_page_of_a_run_that_broke_off_stays_and_says_why(
    models: list[str],
    calls: list[Any],
    source: Path,
    view: list[str],
    waiting: Waiting,
    said_on_page: list[str],
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = storage_file(source)
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 6 // 10])
    assert main(["run", str(source), *models, *view, "--track"]) == 2
    assert len(waiting.summaries) == 1
    assert "⚠" in said_on_page[-1]
    assert "damaged or was never finished" in said_on_page[-1]
    assert "The run broke off" in capsys.readouterr().err


def test_the_page_of_an_interrupted_run_closes(
    models: list[str],
    source: Path,
    view: list[str],
    waiting: Waiting,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupted(*args: Any) -> PoseEstimate:
        raise KeyboardInterrupt

    monkeypatch.setattr(PoseEstimator, "run", interrupted)
    assert main(["run", str(source), *models, *view]) == 130
    assert waiting.summaries == []


def test_options_that_would_do_nothing_are_said(
    tmp_path: Path, models: list[str], source: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "o.jsonl"
    assert main(["run", str(source), *models, "--out", str(out), "--port", "8081"]) == 2
    assert "--port is the port of the page: give --view too" in capsys.readouterr().err
    assert main(["run", str(source), *models, "--out", str(out), "--host", "0.0.0.0"]) == 2
    assert "--host is the address of the page: give --view too" in capsys.readouterr().err
    assert main(["run", str(source), *models, "--out", str(out), "--bag-kind", "ros1"]) == 2
    assert "give --bag PATH too" in capsys.readouterr().err
    assert not out.exists()


def test_a_page_for_other_machines(
    models: list[str], calls: list[Any], source: Path, view: list[str], waiting: Waiting
) -> None:
    """What it listens on, for a moment before Ctrl-C; all of 127.0.0.0/8 is this machine."""
    reached = []

    def look() -> None:
        with socket.create_connection(("127.0.0.2", int(view[-1])), timeout=5):
            reached.append(True)
        raise KeyboardInterrupt

    waiting.wait = look  # type: ignore[method-assign]
    assert main(["run", str(source), *models, *view, "--limit", "1", "--host", "0.0.0.0"]) == 0
    assert reached


def test_a_host_that_is_not_this_machine(
    models: list[str],
    calls: list[Any],
    source: Path,
    view: list[str],
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["run", str(source), *models, *view, "--host", "192.0.2.1"]) == 2
    assert 'cannot listen on "192.0.2.1"' in capsys.readouterr().err


def test_a_taken_port_leaves_no_output(
    tmp_path: Path,
    models: list[str],
    calls: list[Any],
    source: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        args = ["--out", str(tmp_path / "o.jsonl"), "--view", "--port", port]
        assert main(["run", str(source), *models, *args]) == 2
    assert f"port {port} is taken" in capsys.readouterr().err
    assert not (tmp_path / "o.jsonl").exists()
