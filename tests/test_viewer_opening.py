"""What `inhand view` takes, and what it says about what it does not take."""

import json
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tiny_urdf
from PIL import Image

from inhand.cli import main
from inhand.errors import InputError
from inhand.estimate import PoseEstimate
from inhand.evaluation.results import FrameResult, Ledger
from inhand.geometry.mesh import box
from inhand.io import write_result
from inhand.viewer.opening import (
    FrameFiles,
    open_datasets,
    open_demo,
    open_frame,
    open_results,
)

T_HAND = np.eye(4)
T_HAND[2, 3] = 0.4


def write_mesh(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh = box((0.03, 0.05, 0.02))
    lines = ["v {} {} {}".format(*vertex) for vertex in mesh.vertices]
    path.write_text("\n".join(lines + ["f {} {} {}".format(*face) for face in mesh.faces + 1]))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames with their hand and objects, as data sets of .npz frames come."""
    folder = tmp_path_factory.mktemp("data")
    parts = (
        tiny_urdf.link("palm"),
        tiny_urdf.link("finger"),
        tiny_urdf.joint("bend", "palm", "finger"),
    )
    tiny_urdf.write(folder, *parts).rename(folder / "hand.urdf")
    write_mesh(folder / "objects" / "box.obj")
    (folder / "frames").mkdir()
    for i in range(2):
        depth = np.full((48, 64), 4000 + 10 * i, np.uint16)
        np.savez_compressed(
            folder / "frames" / f"box_{i}.npz",
            obj="box",
            depth=depth,
            K=np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]),
            T_camera_hand_given=T_HAND,
            T_camera_hand=T_HAND,
            T_camera_object=T_HAND,
            q=np.array([0.1]),
            joints=np.array(["bend"]),
            label=np.zeros((48, 64), np.uint8),
            visib=np.array(0.4),
        )
    return folder


def test_a_folder_of_frames(folder: Path) -> None:
    source = open_datasets([folder / "frames"], folder / "hand.urdf", None, {}).source
    assert source.names == ["frames/box_0", "frames/box_1"]
    assert source.object_names == ["box", "box"]
    frame, obj = source.read(1)
    assert frame.depth[0, 0] == pytest.approx(0.401)
    assert obj.name == "box"
    truth = frame.truth(source.hand)
    assert truth is not None
    np.testing.assert_array_equal(truth.joint_vector, [0.1])


def test_a_broken_frame_is_listed_and_says_so_when_read(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "cut.npz").write_bytes((folder / "frames" / "box_0.npz").read_bytes()[:500])
    source = open_datasets([tmp_path], folder / "hand.urdf", folder / "objects", {}).source
    assert source.object_names == [""]
    with pytest.raises(InputError, match=r"cut\.npz"):
        source.read(0)


def test_unknown_kinds_of_data_are_named_with_the_known_ones(tmp_path: Path) -> None:
    (tmp_path / "video.mp4").touch()
    with pytest.raises(InputError, match=r"video.mp4 is no data set of a known kind.*\.npz.*BOP"):
        open_datasets([tmp_path / "video.mp4"], None, None, {})
    with pytest.raises(InputError, match="no folder of frames"):
        open_datasets([tmp_path / "nothing"], None, None, {})
    with pytest.raises(InputError, match="holds no frames"):
        open_datasets([tmp_path], None, None, {})


def test_a_missing_hand_or_object_is_asked_for(folder: Path, tmp_path: Path) -> None:
    frame = tmp_path / "box_0.npz"
    frame.write_bytes((folder / "frames" / "box_0.npz").read_bytes())
    with pytest.raises(InputError, match="give --objects"):
        open_datasets([frame], folder / "hand.urdf", None, {})
    with pytest.raises(InputError, match="give --hand"):
        open_datasets([frame], None, folder / "objects", {})


def test_a_benchmarks_results_bring_their_frames(folder: Path, tmp_path: Path) -> None:
    frames = sorted((folder / "frames").glob("*.npz"))
    settings = {"hand": str(folder / "hand.urdf"), "objects": str(folder / "objects"), "seed": 7}
    ledger = Ledger(tmp_path / "results.jsonl", settings)
    for file in frames:
        for method, handicap in (("paper", {"noise": 2.0}), ("paper", {}), ("fgr", {})):
            name = f"frames/{file.stem}"
            ledger.append(
                FrameResult(name, str(file), "answer", method=method, perturbation=handicap)
            )
    opened = open_results(tmp_path / "results.jsonl", {})
    assert opened.source.names == ["frames/box_0", "frames/box_1"]
    known = opened.results["frames/box_1"]
    assert isinstance(known, FrameResult)
    assert (known.method, known.perturbation) == ("paper", {})
    assert opened.config is not None
    assert (opened.config.seed, opened.config.hypotheses.method) == (7, "congruent_sets")


@pytest.mark.parametrize(
    ("results", "settings", "words"),
    [
        ([], {}, "no results of frames as they were"),
        ([FrameResult("a", "gone.npz", "answer")], {}, "gone.npz, which is not there"),
    ],
)
def test_results_that_cannot_be_shown(
    tmp_path: Path, results: list[FrameResult], settings: dict[str, Any], words: str
) -> None:
    ledger = Ledger(tmp_path / "results.jsonl", settings)
    for result in results:
        ledger.append(result)
    with pytest.raises(InputError, match=words):
        open_results(tmp_path / "results.jsonl", {})


def test_results_of_something_else(folder: Path, tmp_path: Path) -> None:
    file = str(folder / "frames" / "box_0.npz")
    Ledger(tmp_path / "r.jsonl", {"hand": "x"}).append(FrameResult("a", file, "answer"))
    with pytest.raises(InputError):
        open_results(tmp_path / "r.jsonl", {})
    (tmp_path / "other.jsonl").write_text('{"a": 1}\n')
    with pytest.raises(InputError, match="not a results file"):
        open_results(tmp_path / "other.jsonl", {})


def test_one_frame_with_its_result(folder: Path, tmp_path: Path) -> None:
    Image.fromarray(np.full((48, 64), 400, np.uint16)).save(tmp_path / "depth.png")
    camera = {"fx": 60, "fy": 60, "cx": 31.5, "cy": 23.5, "width": 64, "height": 48}
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    (tmp_path / "pose.json").write_text(json.dumps({"T_camera_hand": T_HAND.tolist()}))
    estimate = PoseEstimate(False, "the object is hidden", None, {}, None, 0.0)
    write_result(tmp_path / "result.json", estimate)
    files = FrameFiles(
        depth=tmp_path / "depth.png",
        camera=tmp_path / "camera.json",
        hand_pose=tmp_path / "pose.json",
        hand=folder / "hand.urdf",
        object=folder / "objects" / "box.obj",
        result=tmp_path / "result.json",
    )
    opened = open_frame(files, {})
    frame, _ = opened.source.read(0)
    assert frame.depth.max() == pytest.approx(0.4)
    np.testing.assert_array_equal(frame.T_camera_hand, T_HAND)
    assert frame.truth(opened.source.hand) is None
    assert opened.results["depth"].reason == "the object is hidden"


def test_the_built_in_scene_has_its_truth() -> None:
    source = open_demo().source
    frame, obj = source.read(0)
    assert (len(source.names), obj.name) == (1, "industrial_part")
    truth = frame.truth(source.hand)
    assert truth is not None
    assert truth.T_camera_object is not None


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["--depth", "d.png"], "missing: --camera, --hand-pose, --hand, --object"),
        (["--hand", "h.urdf"], "missing: --depth, --camera, --hand-pose, --object"),
        (["frames", "--depth", "d.png", "--rgb", "c.png"], "not both: frames and --depth, --rgb"),
        (["no-such-folder"], "no folder of frames no-such-folder"),
        (["no-such.jsonl"], "no results file no-such.jsonl"),
        (["--port", "70000"], "no port 70000"),
    ],
)
def test_bad_arguments_end_with_a_line(
    words: list[str],
    problem: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("inhand.cli.view.load_kernels", lambda device, console: None)
    port = [] if "--port" in words else ["--port", "0"]
    assert main(["view", *words, *port, "--device", "cpu"]) == 2
    error = capsys.readouterr().err
    assert problem in error
    assert error.count("\n") == 1


def test_it_serves_until_it_is_interrupted(interruptible: None) -> None:
    code = "import sys; from inhand.cli import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", code, "view", "--port", "0", "--device", "cpu"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        line = next(line for line in program.stdout if line.startswith("Open "))
        where = line.split()[1]
        assert urllib.request.urlopen(where, timeout=30).status == 200
        program.send_signal(signal.SIGINT)
        assert program.wait(30) == 0
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(where, timeout=10)
