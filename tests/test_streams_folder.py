"""A folder of depth images as a source."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from inhand.camera import Camera
from inhand.errors import InputError
from inhand.streams.config import StreamConfig
from inhand.streams.open_source import open_source
from inhand.streams.source import Frame

CAMERA = {"fx": 60, "fy": 60, "cx": 15.5, "cy": 11.5, "width": 32, "height": 24}
T_HAND = np.eye(4)
T_HAND[:3, 3] = -0.03, 0.0, 0.45


def counts(number: int) -> Any:
    return np.full((24, 32), 400 + number, dtype=np.uint16)


def write_folder(folder: Path, names: list[str], *, depth_folder: bool = True) -> Path:
    images = folder / "depth" if depth_folder else folder
    images.mkdir(parents=True, exist_ok=True)
    for number, name in enumerate(names):
        if name.endswith(".npy"):
            np.save(images / name, counts(number) * np.float32(0.001))
        else:
            Image.fromarray(counts(number)).save(images / name)
    (folder / "camera.json").write_text(json.dumps(CAMERA))
    return folder


def write_poses(folder: Path, poses: dict[str, Any]) -> None:
    (folder / "hand_poses.json").write_text(json.dumps(poses))


def pose(x: float, **more: Any) -> dict[str, Any]:
    T = T_HAND.copy()
    T[0, 3] = x
    return {"T_camera_hand": T.tolist(), **more}


def frames(folder: Path, config: StreamConfig | None = None) -> list[Frame]:
    source = open_source(str(folder), config or StreamConfig())
    return [arrival.decode() for arrival in source.arrivals()]


@pytest.mark.parametrize("depth_folder", [True, False])
def test_images_in_the_order_of_their_numbers(tmp_path: Path, depth_folder: bool) -> None:
    names = ["frame_2.png", "frame_9.tif", "frame_10.npy", "frame_100.png"]
    folder = write_folder(tmp_path, names, depth_folder=depth_folder)
    write_poses(folder, {Path(n).stem: pose(0.01 * i) for i, n in enumerate(names)})
    found = frames(folder)
    assert [f.name for f in found] == ["frame_2", "frame_9", "frame_10", "frame_100"]
    for number, frame in enumerate(found):
        assert frame.depth is not None
        assert frame.T_camera_hand is not None
        np.testing.assert_allclose(frame.depth, counts(number) * 0.001, rtol=1e-6)
        assert frame.T_camera_hand[0, 3] == pytest.approx(0.01 * number)
    assert found[0].camera.fx == 60
    # 30 images a second, where nothing tells the times.
    assert [f.time_ns for f in found] == [0, 33_333_333, 66_666_667, 100_000_000]


def test_times_and_images_without_pose(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, ["0.png", "1.png", "2.png"])
    write_poses(folder, {"0": pose(0, time=12.5), "1": {"time": 12.6}, "2": pose(0, time=12.75)})
    found = frames(folder)
    assert [f.time_ns for f in found] == [12_500_000_000, 12_600_000_000, 12_750_000_000]
    assert found[1].T_camera_hand is None
    assert found[1].depth is not None
    assert found[1].problem == 'no wrist pose: hand_poses.json has none for "1"'


def test_an_image_that_is_left_out_has_no_pose(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, ["0.png", "1.png"])
    write_poses(folder, {"0": pose(0)})
    assert [f.T_camera_hand is None for f in frames(folder)] == [False, True]


def test_one_pose_for_all_and_camera_as_given(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, ["0.png", "1.png"])
    (folder / "hand_pose.json").write_text(json.dumps(pose(0.07)))
    assert [f.T_camera_hand[0, 3] for f in frames(folder)] == [0.07, 0.07]  # type: ignore[index]
    given = Camera(70, 70, 15.5, 11.5, 32, 24, depth_unit=0.0001)
    found = frames(folder, StreamConfig(camera=given, T_camera_hand=T_HAND, frame_rate=10))
    assert found[1].camera == given
    assert found[1].depth is not None
    assert found[1].depth[0, 0] == pytest.approx(0.0401)
    assert found[1].T_camera_hand is not None
    assert found[1].T_camera_hand[0, 3] == -0.03
    assert found[1].time_ns == 100_000_000


def test_a_broken_image_is_one_problem(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, ["0.png", "1.png"])
    (folder / "hand_pose.json").write_text(json.dumps(pose(0)))
    (folder / "depth" / "0.png").write_bytes(b"no image")
    first, second = frames(folder)
    assert first.depth is None
    assert "cannot read the image" in first.problem
    assert second.depth is not None


def no_camera(folder: Path) -> None:
    (folder / "camera.json").unlink()


def two_of_a_name(folder: Path) -> None:
    np.save(folder / "depth" / "0.npy", counts(0) * np.float32(0.001))


BAD = {
    "no camera": (no_camera, r"there are no intrinsics .*camera\.json: .*--camera FILE"),
    "no pose": (lambda f: None, "tells no wrist pose: expected hand_poses.json or hand_pose.json"),
    "poses of others": (lambda f: write_poses(f, {"x": pose(0)}), 'such as "0"'),
    "no object": (lambda f: write_poses(f, {"0": 1}), '"0" in .* must be an object with "T_camera'),
    "no rigid pose": (
        lambda f: write_poses(f, {"0": {"T_camera_hand": np.zeros((4, 4)).tolist()}}),
        'T_camera_hand of "0"',
    ),
    "no JSON": (lambda f: (f / "hand_poses.json").write_text("{"), "is not JSON"),
    "a list": (lambda f: (f / "hand_poses.json").write_text("[]"), "must hold a JSON object"),
    "no time": (
        lambda f: write_poses(f, {"0": pose(0, time="now"), "1": pose(0, time=1)}),
        "a time in .* must be a number",
    ),
    "some times": (
        lambda f: write_poses(f, {"0": pose(0, time=1), "1": pose(0)}),
        "tells the times of some images, but not of all",
    ),
    "times go back": (
        lambda f: write_poses(f, {"0": pose(0, time=2), "1": pose(0, time=1)}),
        "do not grow",
    ),
    "two of a name": (two_of_a_name, '2 images in .* are called "0"'),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_is_said(tmp_path: Path, case: str) -> None:
    spoil, message = BAD[case]
    folder = write_folder(tmp_path, ["0.png", "1.png"])
    spoil(folder)
    with pytest.raises(InputError, match=message):
        open_source(str(folder), StreamConfig())


@pytest.mark.parametrize("name", ["longest_gap", "frame_rate", "patience"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_times_and_rates_are_positive(name: str, value: float) -> None:
    with pytest.raises(InputError, match=f"{name} must be positive"):
        StreamConfig(**{name: value})  # type: ignore[arg-type]


def test_topics_are_for_recordings(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, ["0.png"])
    with pytest.raises(InputError, match="is no recording, for which alone there is: depth_topic"):
        open_source(str(folder), StreamConfig(depth_topic="/depth"))
