"""The benchmark on a tiny rendered set, with an estimator that does as it is told."""

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from rich.console import Console

from inhand.baselines.method import View
from inhand.camera import Camera
from inhand.cli import main
from inhand.datasets.frames import find_frames, read_frame
from inhand.errors import InputError
from inhand.evaluation.benchmark import Benchmark, peak_memory, pick_frames
from inhand.evaluation.contact_sheet import TILE, ContactSheet, worst_frames
from inhand.evaluation.diagnosis import SegmentQuality, stage_to_blame
from inhand.evaluation.metrics import PoseError
from inhand.evaluation.printing import print_comparison, print_summary
from inhand.evaluation.results import FrameResult, Ledger, read_results
from inhand.evaluation.shards import Shard
from inhand.evaluation.summary import summarise
from inhand.evaluation.sweeps import SWEEPS, Perturbation
from inhand.geometry import mesh as meshes
from inhand.geometry.distance_field import build_distance_field
from inhand.geometry.se3 import exp
from inhand.hand import Hand
from inhand.kernels.depth import DepthRenderer
from inhand.object_symmetry import Symmetry

CAMERA = Camera(150.0, 150.0, 79.5, 59.5, 160, 120)
URDF = """
<robot name="pincher">
  <link name="palm"><visual><geometry><box size="0.06 0.04 0.02"/></geometry></visual></link>
  <link name="left"><visual><origin xyz="0 0 0.03"/>
    <geometry><box size="0.01 0.02 0.06"/></geometry></visual></link>
  <link name="right"><visual><origin xyz="0 0 0.03"/>
    <geometry><box size="0.01 0.02 0.06"/></geometry></visual></link>
  <joint name="left_joint" type="revolute"><parent link="palm"/><child link="left"/>
    <origin xyz="0.025 0 0.01"/><axis xyz="0 1 0"/><limit lower="-1" upper="1"/></joint>
  <joint name="right_slide" type="prismatic"><parent link="palm"/><child link="right"/>
    <origin xyz="-0.025 0 0.01"/><axis xyz="1 0 0"/><limit lower="-0.02" upper="0.02"/></joint>
</robot>
"""
JOINTS = {"left_joint": 0.2, "right_slide": 0.005}
STAGE_FIELDS = [
    "observation",
    "wrist",
    "hand_state",
    "segment",
    "hypotheses",
    "clustered",
    "refined",
    "pruned",
    "selection",
]


@pytest.fixture(scope="module")
def urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("hand") / "pincher.urdf"
    path.write_text(URDF)
    return path


@pytest.fixture(scope="module")
def hand(urdf: Path) -> Hand:
    return Hand.from_urdf(urdf)


@pytest.fixture(scope="module")
def load_object() -> Callable[[str], Any]:
    mesh = meshes.box((0.03, 0.04, 0.06))
    model = SimpleNamespace(
        mesh=mesh,
        symmetry=Symmetry.none(np.zeros(3)),
        distance_field=build_distance_field(mesh, 0.002, 0.02),
    )

    def load(name: str) -> Any:
        if name != "box":
            raise InputError(f"no object {name}")
        return model

    return load


@pytest.fixture(scope="module")
def frames(
    tmp_path_factory: pytest.TempPathFactory, hand: Hand, load_object: Callable[[str], Any]
) -> Path:
    """Six rendered frames."""
    folder = tmp_path_factory.mktemp("data") / "tiny"
    folder.mkdir()
    renderer = DepthRenderer([*(link.mesh for link in hand.links), load_object("box").mesh])
    rng = np.random.default_rng(0)
    for i in range(6):
        T_camera_hand = exp(np.array([0.3, 0.2 * i, 0.1, 0, 0, 0.3]))
        T_camera_object = T_camera_hand @ exp(np.array([0.1 * i, 0.2, 0.3, 0, 0, 0.07]))
        links = T_camera_hand @ hand.forward_kinematics(hand.joint_vector(JOINTS))
        depth, index = renderer.render(CAMERA, np.concatenate([links, T_camera_object[None]]))
        np.savez_compressed(
            folder / f"box_{i:03d}.npz",
            obj="box",
            depth=np.rint(depth * 1e4).astype(np.uint16),
            K=CAMERA.matrix,
            T_camera_hand_given=T_camera_hand @ exp(rng.normal(size=6) * 0.002),
            T_camera_hand=T_camera_hand,
            T_camera_object=T_camera_object,
            q=np.array(list(JOINTS.values())),
            joints=np.array(list(JOINTS)),
            label=np.where(index < 0, 0, np.where(index == len(hand.links), 2, 1)).astype(np.uint8),
            visib=np.array(0.05 + 0.18 * i),
        )
    return folder


@dataclass
class ToldEstimator:
    """Answers each frame with the truth, changed as told: what to do, by frame name."""

    hand: Hand
    folder: Path
    orders: dict[str, str] = field(default_factory=dict)
    calls: list[str] = field(default_factory=list)

    def run(self, depth: Any, camera: Camera, T_camera_hand: Any) -> tuple[Any, Any]:
        frames = map(read_frame, sorted(self.folder.glob("*.npz")))
        frame = next(f for f in frames if np.array_equal(f.T_camera_hand_given, T_camera_hand))
        order = self.orders.get(frame.name, "right")
        self.calls.append(frame.name)
        if order == "crash":
            raise RuntimeError("division of a cucumber by zero")
        if order == "stop":
            raise KeyboardInterrupt
        v, u = np.nonzero(np.isin(frame.truth.label, (1, 2)))
        z = frame.depth[v, u]
        points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], 1)
        is_object = frame.truth.label[v, u] == 2
        truth = frame.truth.T_camera_object
        right = truth @ exp(np.array([0, 0, 0, 0.001, 0, 0]))
        wrong = truth @ exp(np.array([0, 0, 0, 0.030, 0, 0]))
        both = SimpleNamespace(T_camera_object=np.stack([wrong, right]), score=np.zeros(2))
        wrist = SimpleNamespace(T_camera_hand=frame.truth.T_camera_hand)
        stages = dict.fromkeys(STAGE_FIELDS)
        cloud = SimpleNamespace(points=points)
        observation = SimpleNamespace(camera=camera, step=1, cloud=lambda _step: cloud)
        stages |= {"observation": observation, "wrist": wrist, "hand_state": wrist}
        if order != "hidden":
            kept = points[is_object]
            stages["segment"] = SimpleNamespace(points=kept, weight=np.ones(len(kept)))
            stages |= dict.fromkeys(STAGE_FIELDS[4:], both)
        answer = {"right": right, "wrong": wrong, "hidden": None}[order]
        estimate = SimpleNamespace(
            found=answer is not None,
            reason="the object is hidden" if answer is None else "",
            T_camera_object=answer,
            T_camera_hand=frame.truth.T_camera_hand,
            joint_positions={"left_joint": 0.25, "right_slide": 0.0},
            confidence=0.9 if order == "right" else 0.4,
            candidates=[SimpleNamespace(T_camera_object=T) for T in (wrong, right)]
            if answer is not None
            else [],
            timings={"observation": 0.01, "wrist": 0.02},
        )
        return estimate, SimpleNamespace(**stages)


def benchmark(estimator: ToldEstimator, load_object: Callable[[str], Any]) -> Benchmark:
    def run(view: View) -> tuple[Any, Any]:
        return estimator.run(view.depth, view.camera, view.T_camera_hand)

    method: Any = SimpleNamespace(
        name="told", perturbation={}, prepare=lambda *_: SimpleNamespace(run=run)
    )
    return Benchmark(estimator.hand, load_object, method)


def test_scores_a_right_answer(hand: Hand, frames: Path, load_object: Callable[[str], Any]) -> None:
    estimator = ToldEstimator(hand, frames)
    result = benchmark(estimator, load_object).score(frames / "box_003.npz")
    assert estimator.calls == ["tiny/box_003"] * 2, "once to warm up, once to measure"
    assert (result.outcome, result.object_name, result.lost_at) == ("answer", "box", None)
    assert result.adi is not None
    assert 0 < result.adi < 0.001
    assert result.add == pytest.approx(0.001)
    assert result.translation_error == pytest.approx(0.001)
    assert result.rotation_error == pytest.approx(0.0, abs=1e-6)
    assert result.candidates_adi[0] > 0.005 > result.candidates_adi[1]
    assert result.segment == pytest.approx([1.0, 1.0])
    assert result.wrist_errors["answer"] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert result.wrist_errors["given"][0] > 0
    assert result.joint_errors == pytest.approx({"left_joint": 0.05}), "a slide has no angle"
    assert result.visible_share == pytest.approx(0.59)


def test_joint_pixels_are_those_of_the_joints_link_that_the_label_calls_hand(
    hand: Hand, frames: Path, load_object: Callable[[str], Any]
) -> None:
    result = benchmark(ToldEstimator(hand, frames), load_object).score(frames / "box_000.npz")
    frame = read_frame(frames / "box_000.npz")
    T = frame.truth.T_camera_hand @ hand.forward_kinematics(hand.joint_vector(JOINTS))
    names = [link.name for link in hand.links]
    # Independent of the renderer: project the finger's corners and count inside their hull.
    for joint, name in (("left_joint", "left"), ("right_slide", "right")):
        link = hand.links[names.index(name)]
        corners = link.mesh.vertices @ T[names.index(name), :3, :3].T + T[names.index(name), :3, 3]
        u, v = CAMERA.project(corners).T
        box = np.zeros(frame.truth.label.shape, bool)
        box[int(v.min()) : int(v.max()) + 2, int(u.min()) : int(u.max()) + 2] = True
        inside = int((box & (frame.truth.label == 1)).sum())
        assert 0 < result.joint_pixels[joint] <= inside


def test_names_the_stage_that_chose_wrong(
    hand: Hand, frames: Path, load_object: Callable[[str], Any]
) -> None:
    estimator = ToldEstimator(hand, frames, {"tiny/box_001": "wrong", "tiny/box_002": "hidden"})
    bench = benchmark(estimator, load_object)
    wrong, hidden = (bench.score(frames / f"box_00{i}.npz") for i in (1, 2))
    assert (wrong.outcome, wrong.lost_at) == ("answer", "selection")
    assert wrong.best_adi["pruning"] is not None
    assert wrong.best_adi["pruning"] < 0.005
    assert (hidden.outcome, hidden.lost_at) == ("no answer", "segmentation")
    assert hidden.reason == "the object is hidden"
    assert hidden.adi is None


def test_bad_frames_are_counted_and_never_end_the_run(
    hand: Hand, frames: Path, load_object: Callable[[str], Any], tmp_path: Path
) -> None:
    folder = tmp_path / "tiny"
    folder.mkdir()
    for file in frames.glob("*.npz"):
        (folder / file.name).write_bytes(file.read_bytes())
    (folder / "box_001.npz").write_bytes((frames / "box_001.npz").read_bytes()[:300])
    changed = dict(np.load(frames / "box_002.npz")) | {"obj": "sock"}
    np.savez(folder / "box_002.npz", **changed)
    estimator = ToldEstimator(hand, frames, {"tiny/box_004": "crash"})
    ledger = Ledger(tmp_path / "results.jsonl", {})
    results = list(benchmark(estimator, load_object).run(find_frames([folder]), ledger))
    outcomes = ["answer", "unreadable", "error", "answer", "error", "answer"]
    assert [r.outcome for r in results] == outcomes
    summary = summarise(results)
    assert summary["frames"] == {"answer": 3, "no answer": 0, "error": 2, "unreadable": 1}
    assert summary["recall"]["all"]["5 mm"]["frames"] == 5, "a failure is a miss"
    assert summary["recall"]["all"]["5 mm"]["share"] == pytest.approx(3 / 5)
    text = printed(summary)
    for words in ("box_001", "complete .npz", "no object sock", "cucumber"):
        assert words in text
    beside = StringIO()
    print_comparison({"one": summary, "other": summary}, Console(file=beside, width=120))
    assert "other: 3 answer, 2 error, 1 unreadable" in beside.getvalue()


def test_an_interrupted_run_goes_on_where_it_stopped(
    hand: Hand, frames: Path, load_object: Callable[[str], Any], tmp_path: Path
) -> None:
    files = find_frames([frames])
    path = tmp_path / "out" / "results.jsonl"
    estimator = ToldEstimator(hand, frames, {"tiny/box_003": "stop"})
    with pytest.raises(KeyboardInterrupt):
        list(benchmark(estimator, load_object).run(files, Ledger(path, {"seed": 1})))
    with path.open("a") as half_written:
        half_written.write('{"frame": "tiny/box_0')

    ledger = Ledger(path, {"seed": 1})
    assert list(ledger.results) == [(f"tiny/box_00{i}", "told") for i in range(3)]
    estimator = ToldEstimator(hand, frames)
    second = list(benchmark(estimator, load_object).run(files, ledger))
    assert [r.frame for r in second] == ["tiny/box_003", "tiny/box_004", "tiny/box_005"]
    assert "tiny/box_000" not in estimator.calls
    assert list(Ledger(path, {"seed": 1}).results.values()) == list(ledger.results.values())
    assert len(ledger.results) == 6

    with pytest.raises(InputError, match="another seed"):
        Ledger(path, {"seed": 2})
    assert not Ledger(path, {"seed": 2}, restart=True).results


def test_a_file_that_holds_no_results_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    for text in ("hello\n", '{"a": 1}\n', '{"settings": {}}\n{"unknown": 1}\n'):
        path.write_text(text)
        with pytest.raises(InputError, match="not a results file"):
            Ledger(path, {})
    with pytest.raises(InputError, match="cannot write the results"):
        Ledger(path / "below_a_file" / "results.jsonl", {})


def test_report_of_a_run(hand: Hand, frames: Path, load_object: Callable[[str], Any]) -> None:
    estimator = ToldEstimator(hand, frames, {"tiny/box_000": "wrong", "tiny/box_005": "hidden"})
    bench = benchmark(estimator, load_object)
    results = [bench.score(file) for file in find_frames([frames])]
    summary = summarise(results)
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    shares = {k: v["share"] for k, v in summary["recall"]["all"].items()}
    assert shares == pytest.approx({"2 mm": 4 / 6, "5 mm": 4 / 6, "10 mm": 4 / 6})
    visible = {k: v["5 mm"]["frames"] for k, v in summary["recall"]["visible share"].items()}
    assert visible == {"< 10 %": 1, "10-30 %": 1, "30-60 %": 2, "> 60 %": 2}
    assert summary["top3_recall"]["share"] == pytest.approx(5 / 6)
    assert summary["confidence"]["auroc"]["value"] == 1.0
    assert summary["stages"]["selection"]["lost"] == 1
    assert summary["stages"]["segmentation"]["lost"] == 1
    assert summary["stages"]["pruning"]["alive"]["share"] == pytest.approx(5 / 6)
    assert summary["time"]["wrist"]["median"] == pytest.approx(0.02)
    assert summary["wrist_error"]["answer"]["translation"]["median"] == pytest.approx(0, abs=1e-6)
    assert summary["peak_memory"] == max(r.peak_memory or 0 for r in results)
    text = printed(summary)
    for words in ("all frames", "67 (30-90)", "> 60 % visible", "selection", "20.0 ms"):
        assert words in text


def test_finger_errors_count_only_visible_joints() -> None:
    errors, pixels = {"a": 0.1, "b": 0.3}, {"a": 501, "b": 500}
    result = FrameResult("f", "", "answer", joint_errors=errors, joint_pixels=pixels)
    assert summarise([result])["finger_error"]["all"]["median"] == pytest.approx(0.1)


def test_report_of_nothing() -> None:
    summary = summarise([])
    assert summary["recall"]["all"]["5 mm"]["share"] is None
    assert "none" in printed(summary)


def test_contact_sheet_shows_the_worst_first(
    hand: Hand, frames: Path, load_object: Callable[[str], Any], tmp_path: Path
) -> None:
    estimator = ToldEstimator(hand, frames, {"tiny/box_002": "wrong", "tiny/box_004": "hidden"})
    bench = benchmark(estimator, load_object)
    results = [bench.score(file) for file in find_frames([frames])]
    worst = worst_frames([*results, FrameResult("f", "", "unreadable")], 2)
    assert [r.frame for r in worst] == ["tiny/box_004", "tiny/box_002"]
    sheet = ContactSheet(hand, load_object)
    sheet.save(tmp_path / "worst.png", worst)
    assert Image.open(tmp_path / "worst.png").width > 2 * TILE

    pixels = np.asarray(sheet.tile(worst[1])).astype(int)[:TILE]
    green = (pixels == (70, 255, 70)).all(axis=2)
    red = (pixels == (255, 60, 60)).all(axis=2)
    assert green.sum() > 50
    assert red.sum() > 50
    # The estimate is 30 mm to the object's +x; the contours keep that distance in the picture.
    frame = read_frame(frames / "box_002.npz")
    T = frame.truth.T_camera_object
    shift = CAMERA.project(np.stack([T[:3, 3], T[:3, 3] + 0.03 * T[:3, 0]]))
    expected = shift[1] - shift[0]
    moved = np.argwhere(red).mean(axis=0)[::-1] - np.argwhere(green).mean(axis=0)[::-1]
    cosine = moved @ expected / np.linalg.norm(moved) / np.linalg.norm(expected)
    assert cosine > 0.95


def test_command_line_runs_stops_and_goes_on(
    hand: Hand, urdf: Path, frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "objects").mkdir()
    trimesh.creation.box(extents=(0.03, 0.04, 0.06)).export(tmp_path / "objects" / "box.ply")
    told = ToldEstimator(hand, frames, {"tiny/box_003": "stop"})
    monkeypatch.setattr("inhand.baselines.estimators.PoseEstimator", lambda *_, **__: told)
    monkeypatch.setattr("inhand.cli.bench.load_kernels", lambda *_: None)
    out = tmp_path / "out"
    command = ["bench", str(frames), "--hand", str(urdf), "--device", "cpu", "--out", str(out)]
    command += ["--objects", str(tmp_path / "objects")]

    assert main(command) == 130
    assert json.loads((out / "summary.json").read_text())["frames"]["answer"] == 3
    told.orders.clear()
    assert main([*command, "--limit", "2"]) == 0
    assert json.loads((out / "summary.json").read_text())["frames"]["answer"] == 2
    assert main(command) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert summary["frames"]["answer"] == 6
    assert (out / "worst.png").exists()
    assert len((out / "results.jsonl").read_text().splitlines()) == 1 + 1 + 6, "one origin"
    told.calls.clear()
    assert main([*command, "--methods", "inhand,paper"]) == 0, "a method is added to the results"
    assert len(told.calls) == 7, "once to warm up"
    summary = json.loads((out / "summary.json").read_text())
    assert {k: s["frames"]["answer"] for k, s in summary["methods"].items()} == {
        "inhand": 6,
        "paper": 6,
    }
    assert [r.method for r in read_results(out / "results.jsonl").results] == (
        ["inhand"] * 6 + ["paper"] * 6
    )
    assert main([*command, "--shard", "2/3"]) == 0
    assert len(read_results(out / "results-2of3.jsonl").results) == 2
    assert (out / "summary-2of3.json").exists()
    assert main([*command, "--seed", "1"]) == 2, "other settings"
    assert main([*command, "--seed", "1", "--restart"]) == 0


def test_sweeps_from_the_command_line(
    hand: Hand,
    urdf: Path,
    frames: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "objects").mkdir()
    trimesh.creation.box(extents=(0.03, 0.04, 0.06)).export(tmp_path / "objects" / "box.ply")
    told = ToldEstimator(hand, frames)
    models: list[float] = []

    def prepare(_: Hand, model: Any, **__: Any) -> ToldEstimator:
        models.append(float(model.diameter))
        return told

    monkeypatch.setattr("inhand.baselines.estimators.PoseEstimator", prepare)
    monkeypatch.setattr("inhand.cli.bench.load_kernels", lambda *_: None)
    out = tmp_path / "out"
    command = ["bench", str(frames), "--hand", str(urdf), "--device", "cpu", "--out", str(out)]
    command += ["--objects", str(tmp_path / "objects"), "--limit", "2"]

    assert main([*command, "--sweep", "missing"]) == 0
    assert len(read_results(out / "results.jsonl").results) == 2 * (1 + 4)
    text = (out / "sweeps.md").read_text()
    assert text.count("\n### ") + text.startswith("### ") == 1
    assert "### tiny, inhand: missing" in text
    assert [line.split("|")[1].strip() for line in text.splitlines() if "%" in line[:9]] == (
        ["10 %", "30 %", "50 %", "70 %"]
    )
    assert "missing" in capsys.readouterr().out
    told.calls.clear()
    assert main([*command, "--sweep", "missing"]) == 0
    assert not told.calls, "everything is there"
    models.clear()
    assert main([*command, "--sweep", "object-scale"]) == 0
    true = np.linalg.norm((0.03, 0.04, 0.06))
    expected = true * np.array([0.97, 0.98, 0.99, 1.01, 1.02, 1.03])
    np.testing.assert_allclose(models, expected, rtol=1e-6)
    summary = json.loads((out / "summary.json").read_text())
    assert summary["frames"]["answer"] == 2, "of the frames as they are"


def test_help_names_every_sweep(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["bench", "--help"])
    words = capsys.readouterr().out.replace("│", " ").replace(",", " ").replace(".", " ").split()
    assert set(SWEEPS) <= set(words)


def test_a_perturbed_frame_is_scored_against_the_truth(
    hand: Hand, frames: Path, load_object: Callable[[str], Any]
) -> None:
    bench = benchmark(ToldEstimator(hand, frames), load_object)
    result = bench.score(frames / "box_003.npz", Perturbation("focal-length", 0.02))
    plain = bench.score(frames / "box_003.npz")
    assert result.perturbation == {"focal-length": 0.02}
    assert result.key != plain.key
    assert result.adi == plain.adi, "the told answer does not depend on the image"


def test_missing_ray_is_one_line(
    urdf: Path,
    frames: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "objects").mkdir()
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.setattr("inhand.cli.bench.load_kernels", lambda *_: None)
    command = ["bench", str(frames), "--hand", str(urdf), "--out", str(tmp_path / "out"), "--ray"]
    assert main([*command, "--objects", str(tmp_path / "objects"), "--device", "cpu"]) == 2
    assert capsys.readouterr().err == 'inhand: --ray needs Ray: pip install "inhand[ray]"\n'


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["no/such/folder"], "no folder of frames"),
        (["{frames}"], "--hand"),
        (["{frames}", "--hand", "{urdf}"], "--objects"),
        (["{frames}", "--hand", "{urdf}", "--objects", "none"], "no folder of object meshes"),
        (["{frames}", "--every", "0"], "at least 1"),
        (["{frames}", "--methods", "magic"], 'no method "magic"'),
        (["{frames}", "--sweep", "fog"], 'no sweep "fog"; known: all, wrist-position'),
        (
            ["{frames}", "--sweep", "noise", "--methods", "icp-from-truth@5mm"],
            "icp-from-truth@5mm is a perturbation already",
        ),
        (["{frames}", "--shard", "3/2"], "such as 2/4"),
        (["{frames}", "--shard", "a"], "such as 2/4"),
    ],
)
def test_command_line_says_what_is_missing(
    arguments: list[str],
    words: str,
    frames: Path,
    urdf: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    given = [a.format(frames=frames, urdf=urdf) for a in arguments]
    assert main(["bench", *given, "--out", str(tmp_path / "out")]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


GOOD, POOR = 0.004, 0.030


@pytest.mark.parametrize(
    ("adi", "best", "expected"),
    [
        (GOOD, {}, None),
        (POOR, [GOOD, GOOD, GOOD, GOOD, POOR], "selection"),
        (None, [GOOD, GOOD, GOOD, GOOD, None], "selection"),
        (POOR, [GOOD, GOOD, GOOD, POOR, POOR], "pruning"),
        (POOR, [GOOD, 0.008, 0.008, 0.008, 0.008], "refinement"),
        (POOR, [0.008, POOR, POOR, POOR, POOR], "clustering"),
        (POOR, [POOR, POOR, POOR, POOR, POOR], "hypotheses"),
        (None, [None, None, None, None, None], "hypotheses"),
    ],
)
def test_blame_falls_on_the_stage_after_the_last_good_one(
    adi: float | None, best: Any, expected: str | None
) -> None:
    stages = ("hypotheses", "clustering", "refinement", "pruning", "selection")
    reached = {"observation", "wrist", "hand_state", "segmentation"}
    by_stage = dict(zip(stages, best, strict=False))
    segment = SegmentQuality(0.9, 0.9)
    assert stage_to_blame(adi, by_stage, reached, segment, None, {}) == expected


@pytest.mark.parametrize(
    ("segment", "wrist", "finger", "expected"),
    [
        ((0.2, 0.9), (0.001, 0.01), 0.05, "segmentation"),
        ((0.9, 0.2), (0.001, 0.01), 0.05, "segmentation"),
        ((0.9, 0.2), (0.001, 0.01), 0.50, "hand_state"),
        ((0.9, 0.2), (0.009, 0.01), 0.50, "wrist"),
        ((0.9, 0.2), (0.001, 0.10), 0.05, "wrist"),
        ((0.9, 0.9), (0.009, 0.10), 0.50, "hypotheses"),
        (None, (0.001, 0.01), 0.05, "observation"),
    ],
)
def test_a_bad_segment_is_put_down_to_its_cause(
    segment: Any, wrist: Any, finger: float, expected: str
) -> None:
    reached = {"observation", "wrist", "hand_state", "segmentation"}
    quality = SegmentQuality(*segment) if segment else None
    blamed = stage_to_blame(None, {}, reached, quality, PoseError(*wrist), {"joint": finger})
    assert blamed == expected


@pytest.mark.parametrize("stage", ["observation", "wrist", "hand_state"])
def test_a_stage_that_found_no_answer_is_to_blame(stage: str) -> None:
    stages = ["observation", "wrist", "hand_state", "segmentation"]
    reached = set(stages[: stages.index(stage)])
    assert stage_to_blame(None, {}, reached, None, None, {}) == stage


def test_picks_frames_evenly() -> None:
    files = [Path(str(i)) for i in range(10)]
    assert pick_frames(files) == files
    assert pick_frames(files, every=4) == [files[0], files[4], files[8]]
    assert pick_frames(files, every=5, limit=9) == [files[0], files[5]]
    few = [files.index(file) for file in pick_frames(files, limit=3)]
    assert all(low <= i < high for low, i, high in zip((0, 3, 6), few, (3, 6, 10), strict=True))
    with pytest.raises(InputError, match="at least 1"):
        pick_frames(files, limit=0)


def test_a_part_of_the_frames_has_of_all_kinds() -> None:
    files = [Path(str(i)) for i in range(600)]  # kinds take turns in fours
    kinds = np.bincount([int(str(file)) % 4 for file in pick_frames(files, limit=60)])
    assert len(kinds) == 4
    assert kinds.min() >= 8, "equal steps of 10 would give two kinds of 30"


def test_shards_share_the_frames_evenly() -> None:
    files = [Path(str(i)) for i in range(10)]
    parts = [Shard(i, 3).pick(files) for i in (1, 2, 3)]
    assert sorted(file for part in parts for file in part) == files
    assert [len(part) for part in parts] == [4, 3, 3]
    assert Shard.parse("2/3") == (2, 3)
    assert Shard(2, 3).named("results.jsonl") == "results-2of3.jsonl"
    assert Shard(1, 1).named("results.jsonl") == "results.jsonl"


def test_peak_memory_holds_what_is_in_use() -> None:
    block = np.ones(2_000_000)
    peak = peak_memory()
    assert peak is None or block.nbytes < peak < 2**40


def printed(summary: dict[str, Any]) -> str:
    text = StringIO()
    print_summary(summary, Console(file=text, width=120))
    return text.getvalue()
