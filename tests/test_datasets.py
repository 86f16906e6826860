"""Reading frames with ground truth."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inhand.datasets.frames import (
    find_frames,
    find_object_mesh,
    find_upwards,
    frame_name,
    read_frame,
)
from inhand.errors import InputError


def frame_fields() -> dict[str, Any]:
    depth = np.zeros((48, 64), np.uint16)
    depth[10:20, 10:30] = 5000
    return {
        "obj": "box",
        "depth": depth,
        "K": np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]),
        "T_camera_hand_given": np.eye(4),
        "T_camera_hand": np.eye(4),
        "T_camera_object": np.eye(4),
        "q": np.array([0.1, 0.2]),
        "joints": np.array(["a", "b"]),
        "label": (depth > 0).astype(np.uint8) * 2,
        "visib": np.array(0.4),
    }


def write(path: Path, **changes: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    fields = {**frame_fields(), **changes}
    np.savez_compressed(path, **{k: v for k, v in fields.items() if v is not None})
    return path


def test_reads_every_field(tmp_path: Path) -> None:
    frame = read_frame(write(tmp_path / "set" / "box_000.npz"))
    assert frame.name == "set/box_000"
    assert frame.object_name == "box"
    assert frame.depth.dtype == np.float32
    assert frame.depth.max() == pytest.approx(0.5)
    assert (frame.camera.width, frame.camera.height, frame.camera.fx) == (64, 48, 60.0)
    assert frame.truth.joint_positions == {"a": 0.1, "b": 0.2}
    assert frame.truth.visible_share == pytest.approx(0.4)
    assert (frame.truth.label == 2).sum() == 200


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"label": None}, "lacks label"),
        ({"depth": np.zeros((48, 64), np.float32)}, "uint16"),
        ({"depth": np.zeros((48, 64, 3), np.uint16)}, "uint16"),
        ({"label": np.zeros((4, 4), np.uint8)}, "label has shape"),
        ({"q": np.array([0.1])}, "one finite angle"),
        ({"q": np.array([0.1, np.nan])}, "one finite angle"),
        ({"q": np.array(["x", "y"])}, "not usable"),
        ({"visib": np.array(np.nan)}, "visib"),
        ({"visib": np.array(40.0)}, "visib"),
        ({"visib": np.array([0.1, 0.2])}, "not usable"),
        ({"T_camera_hand": np.diag([1.0, 1, -1, 1])}, "T_camera_hand"),
        ({"T_camera_object": np.eye(3)}, "T_camera_object"),
        ({"K": np.full((3, 3), np.nan)}, "K "),
        ({"obj": np.array({"pickled": 1})}, "cannot read"),
    ],
)
def test_a_bad_field_is_named_with_its_file(
    tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    path = write(tmp_path / "bad.npz", **changes)
    with pytest.raises(InputError, match=words) as caught:
        read_frame(path)
    assert "bad.npz" in str(caught.value)


@pytest.mark.parametrize("keep", [0, 1, 40, 0.5, 0.98])
def test_a_half_written_file_is_named(tmp_path: Path, keep: float) -> None:
    path = write(tmp_path / "cut.npz")
    data = path.read_bytes()
    path.write_bytes(data[: int(keep if keep >= 1 else keep * len(data))])
    with pytest.raises(InputError, match=r"cut\.npz"):
        read_frame(path)


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    path = write(
        tmp_path / "damaged.npz", depth=np.arange(48 * 64, dtype=np.uint16).reshape(48, 64)
    )
    data = bytearray(path.read_bytes())
    start = data.index(b"depth.npy") + 60
    data[start : start + 200] = bytes(200)
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"damaged\.npz"):
        read_frame(path)


def test_an_archive_of_another_version_is_named(tmp_path: Path) -> None:
    path = write(tmp_path / "newer.npz")
    data = bytearray(path.read_bytes())
    entry = data.index(b"PK\x01\x02")  # a file's entry in the archive's table
    data[entry + 6] = 99  # the version that it takes to read it
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"newer\.npz"):
        read_frame(path)


def test_text_and_missing_files_are_named(tmp_path: Path) -> None:
    (tmp_path / "text.npz").write_text("not an archive")
    with pytest.raises(InputError, match=r"text\.npz"):
        read_frame(tmp_path / "text.npz")
    with pytest.raises(InputError, match=r"no frame file.*gone\.npz"):
        read_frame(tmp_path / "gone.npz")


def test_finds_frames_in_folders_and_folders_of_folders(tmp_path: Path) -> None:
    a = write(tmp_path / "dev" / "one" / "a.npz")
    b = write(tmp_path / "dev" / "two" / "b.npz")
    (tmp_path / "dev" / "one" / "notes.txt").write_text("")
    assert find_frames([tmp_path / "dev"]) == [a, b]
    assert find_frames([tmp_path / "dev" / "two", tmp_path / "dev" / "one"]) == [b, a]
    assert find_frames([tmp_path / "dev", tmp_path / "dev" / "one"]) == [a, b]
    assert find_frames([a]) == [a]
    assert frame_name(a) == "one/a"
    write(tmp_path / "other" / "one" / "a.npz")
    with pytest.raises(InputError, match="2 frames are called one/a"):
        find_frames([tmp_path / "dev", tmp_path / "other"])
    with pytest.raises(InputError, match="no folder of frames"):
        find_frames([tmp_path / "absent"])
    with pytest.raises(InputError, match="at least one folder"):
        find_frames([])
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no frames"):
        find_frames([tmp_path / "empty"])


def test_finds_models_upwards(tmp_path: Path) -> None:
    (tmp_path / "objects").mkdir()
    (tmp_path / "objects" / "box.ply").write_text("")
    frames = tmp_path / "dev" / "clean"
    frames.mkdir(parents=True)
    assert find_upwards(frames, "objects") == tmp_path / "objects"
    assert find_upwards(frames, "nothing/of/this/name") is None
    assert find_object_mesh(tmp_path / "objects", "box") == tmp_path / "objects" / "box.ply"
    with pytest.raises(InputError, match=r'"bix".*holds: box'):
        find_object_mesh(tmp_path / "objects", "bix")
    with pytest.raises(InputError, match="no folder of object meshes"):
        find_object_mesh(tmp_path / "none", "box")


def test_reads_all_development_frames(shared_data: Path) -> None:
    paths = find_frames([shared_data / "dev"])
    assert len(paths) == 132
    for path in paths[::12]:
        frame = read_frame(path)
        assert frame.depth.shape == (480, 640)
        assert 0.2 < frame.depth[frame.truth.label == 2].max() < 1.5
        find_object_mesh(shared_data / "objects", frame.object_name)
