"""Damaged recordings: what can be read is read, and then it is said."""

from pathlib import Path

import numpy as np
import pytest
from camera_on_a_robot import (
    CONFIG,
    DEPTH,
    FRAMES,
    INFO,
    LATE,
    START,
    T_WORLD_HAND,
    everything,
    frames,
    image_time,
    images,
    tf,
)
from ros_recording import (
    KINDS,
    MS,
    Messages,
    Sent,
    storage_file,
    write_recording,
)
from rosbags import rosbag1

from inhand.camera import Camera
from inhand.errors import InputError
from inhand.streams.bag import BagKind
from inhand.streams.open_source import open_source
from inhand.streams.source import Frame


def test_one_damaged_image_is_one_problem(tmp_path: Path) -> None:
    def make(m: Messages) -> list[Sent]:
        sent = everything(m)
        broken = next(s for s in sent if s.time_ns == image_time(2) + LATE)
        broken.message.data = broken.message.data[:100]
        return sent

    found = frames(open_source(str(write_recording(tmp_path, "mcap", make)), CONFIG))
    assert [f.depth is not None for f in found] == [True, True, False, True, True]
    assert "damaged: 100 bytes are too few" in found[2].problem


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_a_message_that_is_cut_short_is_one_problem(tmp_path: Path, kind: BagKind) -> None:
    """Also when it is the first of all, and when it is one of tf, which is said at the end."""
    cut = {image_time(0) + LATE: 30, START + 110 * MS: 50}
    source = open_source(str(write_recording(tmp_path, kind, everything, cut=cut)), CONFIG)
    found: list[Frame] = []
    with pytest.raises(InputError, match=r"a message of /tf \(tf2_msgs/msg/TFMessage\) is damaged"):
        found.extend(arrival.decode() for arrival in source.arrivals())
    assert [f.depth is not None for f in found] == [False, True, True, True, True]
    assert "a message of /camera/depth/image_rect_raw" in found[0].problem
    assert all(f.T_camera_hand is not None for f in found[1:])


def long_recording(make: Messages) -> list[Sent]:
    """Several chunks: 40 images of 160 x 120 pixels."""
    camera = Camera(300.0, 300.0, 79.5, 59.5, 160, 120)
    # Steps 8 pixels wide, so that there is something to compress.
    steps = np.random.default_rng(0).integers(300, 900, (120, 20))
    depth = np.repeat(steps, 8, axis=1).astype(np.uint16)
    sent = [Sent(INFO, START, make.camera_info(camera)), tf(make)[0]]
    for i in range(40):
        time_ns = START + 33 * MS * i
        moved = make.transforms(("world", "palm", T_WORLD_HAND[0], time_ns))
        sent += [Sent(DEPTH, time_ns, make.image(depth + i, time_ns)), Sent("/tf", time_ns, moved)]
    return sent


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("share", [0.45, 0.9])
@pytest.mark.parametrize("packed", [False, True])
def test_half_a_recording_is_read_and_then_said(
    tmp_path: Path, kind: BagKind, share: float, packed: bool
) -> None:
    path = write_recording(tmp_path, kind, long_recording, packed=packed)
    file = storage_file(path)
    whole = file.read_bytes()
    file.write_bytes(whole[: int(share * len(whole))])
    source = open_source(str(path), CONFIG)
    found: list[Frame] = []
    with pytest.raises(InputError, match=r"damaged or was never finished.*messages were read"):
        found.extend(arrival.decode() for arrival in source.arrivals())
    assert 40 * share - 2 <= len(found) < 40
    assert all(f.depth is not None and f.T_camera_hand is not None for f in found[:-1])
    assert [f.name for f in found] == [str(i) for i in range(len(found))]


@pytest.mark.parametrize("kind", KINDS)
def test_damage_in_the_middle_of_a_whole_file(tmp_path: Path, kind: BagKind) -> None:
    path = write_recording(tmp_path, kind, long_recording, packed=True)
    file = storage_file(path)
    data = bytearray(file.read_bytes())
    middle = len(data) * 8 // 10
    data[middle : middle + 20_000] = bytes(20_000)
    file.write_bytes(data)
    source = open_source(str(path), CONFIG)
    found: list[Frame] = []
    with pytest.raises(InputError, match="is damaged, and was read up to there"):
        found.extend(arrival.decode() for arrival in source.arrivals())
    assert 20 <= len(found) < 40
    assert [f.name for f in found] == [str(i) for i in range(len(found))]
    assert all(f.depth is not None for f in found)


def test_damage_that_the_library_has_no_words_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its assertions fail without a message."""

    def fails(*_: object) -> None:
        raise AssertionError

    path = write_recording(tmp_path, "ros1", everything)
    monkeypatch.setattr(rosbag1.Reader, "open", fails)
    source = open_source(str(path), CONFIG)
    with pytest.raises(InputError, match=r"\(its parts do not fit together\): its first"):
        list(source.arrivals())


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_of_rubbish(tmp_path: Path, kind: BagKind) -> None:
    path = write_recording(tmp_path, kind, everything)
    storage_file(path).write_bytes(b"rubbish" * 100)
    with pytest.raises(InputError, match=r"nothing in the recording .* can be read"):
        open_source(str(path), CONFIG)


@pytest.mark.parametrize("kind", ["sqlite3", "mcap"])
def test_a_split_recording_without_metadata(tmp_path: Path, kind: BagKind) -> None:
    """Its second file is cut short: the first is read to its end, and as much of the second."""
    path = write_recording(tmp_path, kind, everything)
    second = storage_file(write_recording(tmp_path, kind, long_recording, name="second"))
    data = second.read_bytes()
    (path / second.name.replace("second", "recording_1")).write_bytes(data[: len(data) // 2])
    (path / "metadata.yaml").unlink()
    source = open_source(str(path), CONFIG)
    found: list[Frame] = []
    with pytest.raises(InputError, match="never finished"):
        found.extend(arrival.decode() for arrival in source.arrivals())
    assert FRAMES + 10 <= len(found) < FRAMES + 40
    assert [f.time_ns for f in found[:FRAMES]] == [image_time(i) for i in range(FRAMES)]


def test_recorder_that_was_killed_left_no_metadata(tmp_path: Path) -> None:
    path = write_recording(tmp_path, "mcap", everything)
    (path / "metadata.yaml").unlink()
    source = open_source(str(path), CONFIG)
    found: list[Frame] = []
    with pytest.raises(InputError, match="never finished"):
        found.extend(arrival.decode() for arrival in source.arrivals())
    assert len(found) == FRAMES


def test_too_little_is_left_of_a_recording(tmp_path: Path) -> None:
    """The damage is named with what is missing because of it."""
    make = lambda m: [*everything(m), *images(m, "/z")]  # noqa: E731
    path = write_recording(tmp_path, "ros1", make)
    file = storage_file(path)
    file.write_bytes(file.read_bytes()[:5000])
    with pytest.raises(InputError, match=r"never finished.*could be read of it: .*no topic of dep"):
        open_source(str(path), CONFIG)
