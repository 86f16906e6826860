"""Results as JSON lines and as ROS recordings; full disks."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from any_stream import START, T_HAND, T_OBJECT, FakeSource, found, not_found
from full_disk import largest_file
from ros_recording import KINDS, recording_path
from rosbags import rosbag1, rosbag2
from rosbags.typesys.store import Typestore
from scipy.spatial.transform import Rotation

from inhand.errors import InputError
from inhand.geometry.se3 import exp
from inhand.streams.bag import BagKind
from inhand.streams.bag_files import open_bag
from inhand.streams.json_lines import JsonLines
from inhand.streams.results_bag import ResultsBag
from inhand.streams.ros_types import standard_types
from inhand.streams.runner import Counts, Output, Summary, run
from inhand.streams.source import Frame
from inhand.streams.vision_messages import DETECTIONS, add_vision_messages
from inhand.synth.demo import builtin_object

OBJECT = builtin_object("bottle")


def lines_of(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_json_lines(tmp_path: Path) -> None:
    path = tmp_path / "new" / "results.jsonl"
    source = FakeSource([0, 33, 66], without_wrist=[1])
    run(source, found, [JsonLines(path)])
    first, second, third, last = lines_of(path)
    assert first == {
        "frame": "0",
        "time_ns": START,
        "frame_id": "camera",
        "dropped_before": 0,
        "found": True,
        "reason": "",
        "confidence": 0.75,
        "T_camera_object": T_OBJECT.tolist(),
        "T_camera_hand": T_HAND.tolist(),
        "covariance": None,
        "joint_positions": {"bend": 0.5, "twist": -0.1},
        "timings": {"wrist": 0.0123},
    }
    assert not second["found"]
    assert second["reason"] == "no wrist pose: it is never told"
    assert second["T_camera_object"] is None
    assert third["time_ns"] == START + 66_000_000
    assert last == {
        "summary": {
            "source": "fake",
            "processed": 3,
            "found": 2,
            "dropped": 0,
            "without_wrist": 1,
            "refused": 0,
            "stopped": "",
            "first_problem": "image 1: no wrist pose: it is never told",
            "first_not_found": "",
        }
    }


def test_json_lines_are_there_before_the_end(tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    seen = []
    run(
        FakeSource(range(3)),
        found,
        [JsonLines(path)],
        report=lambda counts: seen.append(len(lines_of(path))),
    )
    assert seen == [1, 2, 3]


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    path.write_text("precious")
    with pytest.raises(InputError, match="exists already"):
        JsonLines(path)
    assert path.read_text() == "precious"
    for kind in KINDS:
        place = recording_path(tmp_path, kind, name=kind)
        place.mkdir() if kind != "ros1" else place.write_text("precious")
        with pytest.raises(InputError, match="exists already"):
            ResultsBag(place, kind, OBJECT)


def test_folders_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write"):
        JsonLines(tmp_path / "file" / "results.jsonl")
    with pytest.raises(InputError, match="cannot write"):
        ResultsBag(tmp_path / "file" / "results", "mcap", OBJECT)
    with pytest.raises(InputError, match=r"ends in \.bag"):
        ResultsBag(tmp_path / "results", "ros1", OBJECT)


def test_full_disk_leaves_whole_lines(tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    output = JsonLines(path)
    with largest_file(2500), pytest.raises(InputError, match=r"cannot write .*whole lines"):
        run(FakeSource(range(50)), found, [output])
    lines = lines_of(path)
    assert 3 <= len(lines) < 10
    assert all(line["found"] for line in lines)
    assert path.read_bytes().endswith(b"\n")


def types_of(kind: BagKind) -> Typestore:
    types = standard_types(kind)
    add_vision_messages(types, kind)
    return types


def read_back(path: Path, kind: BagKind) -> list[tuple[str, int, Any]]:
    """Topic, time and message, read by `rosbags` itself with the definitions in the file."""
    types = types_of(kind)
    read = types.deserialize_ros1 if kind == "ros1" else types.deserialize_cdr
    reader = rosbag1.Reader(path) if kind == "ros1" else rosbag2.Reader(path)
    with reader:
        return [(c.topic, t, read(data, c.msgtype)) for c, t, data in reader.messages()]


@pytest.mark.parametrize("kind", KINDS)
def test_results_bag(tmp_path: Path, kind: BagKind) -> None:
    T = exp(np.array([0.4, -0.9, 2.0, 0.01, -0.02, 0.5]))
    path = recording_path(tmp_path, kind)

    def estimate(frame: Frame) -> Any:
        return replace(found(), T_camera_object=T) if frame.name == "0" else not_found(frame)

    run(FakeSource([0, 33, 66], without_wrist=[2]), estimate, [ResultsBag(path, kind, OBJECT)])
    messages = read_back(path, kind)
    times = {t for _, t, _ in messages}
    assert times == {START, START + 33_000_000, START + 66_000_000}
    for _, t, message in messages:
        assert message.header.frame_id == "camera"
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == t
    by_topic: dict[str, list[Any]] = {}
    for topic, _, message in messages:
        by_topic.setdefault(topic, []).append(message)
    (pose,) = by_topic["/inhand/object_pose"]
    check_pose(pose.pose, T)
    assert len(by_topic["/inhand/hand_pose"]) == 2
    check_pose(by_topic["/inhand/hand_pose"][0].pose, T_HAND)
    joints = by_topic["/inhand/joint_states"]
    assert [j.name for j in joints] == [["bend", "twist"], ["bend"]]
    np.testing.assert_array_equal(joints[0].position, [0.5, -0.1])
    first, *others = by_topic["/inhand/detections"]
    assert [len(d.detections) for d in others] == [0, 0]
    check_detection(first.detections[0], T, kind)


def test_covariance_in_the_order_of_ros(tmp_path: Path) -> None:
    """Translation first; ours has rotation first."""
    covariance = np.diag([1.0, 2, 3, 4, 5, 6])
    covariance[0, 5] = covariance[5, 0] = 0.5  # rotation about x with translation along z
    estimate = replace(found(), covariance=covariance)
    run(FakeSource([0]), lambda frame: estimate, [ResultsBag(tmp_path / "bag", "mcap", OBJECT)])
    (message,) = (m for topic, _, m in read_back(tmp_path / "bag", "mcap") if "detec" in topic)
    written = message.detections[0].results[0].pose.covariance.reshape(6, 6)
    np.testing.assert_array_equal(np.diag(written), [4, 5, 6, 1, 2, 3])
    assert written[2, 3] == written[3, 2] == 0.5


def check_pose(pose: Any, T: Any) -> None:
    p, q = pose.position, pose.orientation
    np.testing.assert_allclose((p.x, p.y, p.z), T[:3, 3], atol=1e-12)
    R = Rotation.from_quat((q.x, q.y, q.z, q.w)).as_matrix()
    np.testing.assert_allclose(R, T[:3, :3], atol=1e-9)


def check_detection(detection: Any, T: Any, kind: BagKind) -> None:
    (result,) = detection.results
    score = result.score if kind == "ros1" else result.hypothesis.score
    assert score == 0.75
    check_pose(result.pose.pose, T)
    if kind != "ros1":
        assert result.hypothesis.class_id == detection.id == "bottle"
    # All points of the object are in the box, and its faces touch some.
    size = detection.bbox.size
    p, q = detection.bbox.center.position, detection.bbox.center.orientation
    points = OBJECT.mesh.vertices @ T[:3, :3].T + T[:3, 3]
    in_box = Rotation.from_quat((q.x, q.y, q.z, q.w)).inv().apply(points - (p.x, p.y, p.z))
    half = np.array([size.x, size.y, size.z]) / 2
    np.testing.assert_allclose(in_box.max(axis=0), half, atol=1e-9)
    np.testing.assert_allclose(in_box.min(axis=0), -half, atol=1e-9)


def test_detections_are_those_of_vision_msgs() -> None:
    """The checksum by which ROS 1 tells whether two definitions of a message agree."""
    checksum = types_of("ros1").generate_msgdef(DETECTIONS)[1]
    assert checksum == "05c51d9aea1fb4cfdc8effb94f197b6f"


def test_definitions_come_with_the_recording(tmp_path: Path) -> None:
    """So that tools read it where vision_msgs is not installed."""
    for kind in KINDS:
        path = recording_path(tmp_path, kind, name=kind)
        run(FakeSource([0]), found, [ResultsBag(path, kind, OBJECT)])
        reader = rosbag1.Reader(path) if kind == "ros1" else rosbag2.Reader(path)
        with reader:
            texts = {c.topic: c.msgdef.data for c in reader.connections}
        assert "BoundingBox3D bbox" in texts["/inhand/detections"]


@pytest.mark.parametrize("kind", KINDS)
def test_full_disk_while_writing_a_bag(tmp_path: Path, kind: BagKind) -> None:
    """The JSON lines are whole; chunks of the bag that are written can still be read."""
    path, lines = recording_path(tmp_path, kind), tmp_path / "results.jsonl"
    outputs: list[Output] = [JsonLines(lines), ResultsBag(path, kind, OBJECT)]
    with (
        largest_file(1_600_000),
        pytest.raises(InputError, match=f"cannot write .*{path.name}.*JSON lines"),
    ):
        run(FakeSource(range(2000)), found, outputs)
    whole = lines_of(lines)
    assert "cannot write" in whole[-1]["summary"]["stopped"]
    assert whole[-1]["summary"]["processed"] == len(whole) - 1
    if kind == "sqlite3":  # writes it all in one transaction
        return
    bag = open_bag(path)
    with pytest.raises(InputError, match="damaged or was never finished"):
        list(bag.messages([]))
    assert bag.topics["/inhand/joint_states"].messages > 900


@pytest.mark.parametrize("kind", KINDS)
def test_full_disk_before_the_first_result(tmp_path: Path, kind: BagKind) -> None:
    path = recording_path(tmp_path, kind)
    with largest_file(0), pytest.raises(InputError, match=f"cannot write .*{path.name}"):
        ResultsBag(path, kind, OBJECT).finish(Summary("fake", Counts(), ""))
