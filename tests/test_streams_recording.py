"""ROS 1 and ROS 2 recordings as sources: topics, cameras, wrist poses."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from camera_on_a_robot import (
    CAMERA,
    CONFIG,
    DEPTH,
    FRAMES,
    INFO,
    LATE,
    START,
    T_WORLD_HAND,
    camera_info,
    check_wrist,
    everything,
    frames,
    image_time,
    images,
    pixels,
    tf,
    true_pose,
)
from ros_recording import (
    KINDS,
    MS,
    OPTICAL,
    Messages,
    Sent,
    compressed_depth,
    png,
    storage_file,
    write_recording,
)
from rosbags.rosbag2 import CompressionMode

from inhand.camera import Camera
from inhand.errors import InputError
from inhand.geometry.se3 import exp
from inhand.streams.bag import BagKind
from inhand.streams.config import StreamConfig
from inhand.streams.open_source import open_source


@pytest.mark.parametrize("kind", KINDS)
def test_everything_comes_from_the_recording(tmp_path: Path, kind: BagKind) -> None:
    source = open_source(str(write_recording(tmp_path, kind, everything)), CONFIG)
    assert source.count == FRAMES
    assert source.kind == kind
    assert DEPTH in source.description[0]
    assert INFO in source.description[1]
    assert "palm" in source.description[2]
    assert [a.time_ns for a in source.arrivals()] == [
        image_time(i) + LATE for i in range(FRAMES)
    ]  # when it arrived
    found = frames(source)
    assert [f.time_ns for f in found] == [image_time(i) for i in range(FRAMES)]  # when it was taken
    assert {f.frame_id for f in found} == {OPTICAL}
    assert found[0].camera == CAMERA
    for number, frame in enumerate(found):
        assert frame.depth is not None
        np.testing.assert_allclose(frame.depth, pixels(number) * 0.001, rtol=1e-6)
    check_wrist(found)
    source.close()


def test_a_single_file_of_a_ros2_recording(tmp_path: Path) -> None:
    for kind in KINDS[1:]:
        file = storage_file(write_recording(tmp_path, kind, everything, name=kind))
        assert len(frames(open_source(str(file), CONFIG))) == FRAMES


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_wrist_from_a_topic_of_poses(tmp_path: Path, kind: BagKind) -> None:
    """In the world's frame, so that tf still tells where the camera is."""

    def make(m: Messages) -> list[Sent]:
        static = tf(m)[0]
        times = range(START, START + 201 * MS, 50 * MS)
        poses = [Sent("/wrist", t, m.pose(true_pose(t), t, "world")) for t in times]
        return [*images(m), *camera_info(m), static, *poses]

    path = str(write_recording(tmp_path, kind, make))
    for config in (CONFIG, replace(CONFIG, pose_topic="/wrist")):
        source = open_source(path, config)
        assert "/wrist" in source.description[2]
        check_wrist(frames(source))


def test_mount_between_tf_and_the_hand(tmp_path: Path) -> None:
    path = str(write_recording(tmp_path, "mcap", lambda m: everything(m)))
    T = exp(np.array([0.1, 0.2, 0.3, 0.01, 0.02, 0.03]))
    plain = frames(open_source(path, CONFIG))
    mounted = frames(open_source(path, replace(CONFIG, T_frame_hand=T)))
    for a, b in zip(plain, mounted, strict=True):
        assert a.T_camera_hand is not None
        assert b.T_camera_hand is not None
        np.testing.assert_allclose(b.T_camera_hand, a.T_camera_hand @ T, atol=1e-9)


def test_frame_of_another_name(tmp_path: Path) -> None:
    make = lambda m: [*images(m), *camera_info(m), *tf(m, hand="tool0")]  # noqa: E731
    path = str(write_recording(tmp_path, "mcap", make))
    check_wrist(frames(open_source(path, replace(CONFIG, hand_frame="tool0"))))
    with pytest.raises(InputError, match=r"--hand-frame FRAME.*tf: .*tool0, world"):
        open_source(path, CONFIG)
    with pytest.raises(InputError, match=r"does not connect wrist with .*tool0, world"):
        open_source(path, replace(CONFIG, hand_frame="wrist"))


def test_images_outside_the_poses_are_reported(tmp_path: Path) -> None:
    """tf breaks off after 100 ms: two images of five come later."""

    def make(m: Messages) -> list[Sent]:
        known = [s for s in tf(m) if s.time_ns <= START + 160 * MS]
        return [*images(m), *camera_info(m), *known]

    found = frames(open_source(str(write_recording(tmp_path, "mcap", make)), CONFIG))
    assert [f.T_camera_hand is not None for f in found] == [True, True, True, False, False]
    assert found[-1].problem == (
        "no wrist pose: the pose of palm in world is last told 0.042 s before this time"
    )
    assert found[-1].depth is not None


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_compressed_depth(tmp_path: Path, kind: BagKind) -> None:
    topic = "/camera/depth/image_raw/compressedDepth"

    def make(m: Messages) -> list[Sent]:
        data = compressed_depth(png(pixels(0)))
        image = m.compressed(data, image_time(0), "16UC1; compressedDepth png")
        colour = m.compressed(b"", image_time(0), "rgb8; jpeg compressed bgr8")
        sent = [Sent(topic, START, image), Sent("/camera/color/compressed", START, colour)]
        return [*sent, *camera_info(m), *tf(m)]

    (frame,) = frames(open_source(str(write_recording(tmp_path, kind, make)), CONFIG))
    assert frame.depth is not None
    np.testing.assert_allclose(frame.depth, pixels(0) * 0.001, rtol=1e-6)


def test_colour_images_are_no_candidates(tmp_path: Path) -> None:
    def make(m: Messages) -> list[Sent]:
        colour = m.image(np.zeros((24, 32, 3), dtype=np.uint8), START, "rgb8")
        return [*everything(m), Sent("/camera/color/image_raw", START, colour)]

    assert len(frames(open_source(str(write_recording(tmp_path, "mcap", make)), CONFIG))) == FRAMES


def test_camera_info_beside_the_images_goes_first(tmp_path: Path) -> None:
    def make(m: Messages) -> list[Sent]:
        other = Camera(600.0, 600.0, 320.0, 240.0, 640, 480)
        colour = Sent("/camera/color/camera_info", START, m.camera_info(other))
        return [colour, *everything(m)]

    path = str(write_recording(tmp_path, "mcap", make))
    assert frames(open_source(path, CONFIG))[0].camera == CAMERA
    with pytest.raises(InputError, match=r"32 x 24 pixels but the camera .*color.* 640 x 480"):
        open_source(path, replace(CONFIG, camera_topic="/camera/color/camera_info"))


def test_camera_as_given(tmp_path: Path) -> None:
    path = str(write_recording(tmp_path, "mcap", lambda m: [*images(m), *tf(m)]))
    given = replace(CAMERA, depth_unit=0.0001)
    frame = frames(open_source(path, replace(CONFIG, camera=given)))[0]
    assert frame.depth is not None
    np.testing.assert_allclose(frame.depth, pixels(0) * 0.0001, rtol=1e-6)


def test_constant_wrist_as_given(tmp_path: Path) -> None:
    path = str(write_recording(tmp_path, "mcap", lambda m: [*images(m), *camera_info(m)]))
    T = T_WORLD_HAND[0]
    for frame in frames(open_source(path, replace(CONFIG, T_camera_hand=T))):
        np.testing.assert_array_equal(frame.T_camera_hand, T)


def test_images_without_time_stamp(tmp_path: Path) -> None:
    def make(m: Messages) -> list[Sent]:
        return [Sent(DEPTH, image_time(1), m.image(pixels(0), 0)), *camera_info(m), *tf(m)]

    source = open_source(str(write_recording(tmp_path, "mcap", make)), CONFIG)
    assert "the images carry none" in source.description[-1]
    (frame,) = frames(source)
    assert frame.time_ns == image_time(1)


BAD: dict[str, tuple[Callable[[Messages], list[Sent]], StreamConfig, str]] = {
    "no depth": (
        lambda m: [*camera_info(m), *tf(m)],
        CONFIG,
        r"no topic of depth images; give --depth-topic TOPIC; it has: .*/tf_static "
        r"\(tf2_msgs/msg/TFMessage, 1\)",
    ),
    "several depth topics": (
        lambda m: [*images(m, "/a"), *images(m, "/b"), *camera_info(m), *tf(m)],
        CONFIG,
        r"several topics of depth images; choose one by --depth-topic TOPIC: /a, /b",
    ),
    "unknown depth topic": (
        everything,
        replace(CONFIG, depth_topic="/depth"),
        r"--depth-topic: the recording has no topic /depth; it has: .*/chatter \(std_msgs/msg/Str",
    ),
    "topic of another type": (
        everything,
        replace(CONFIG, depth_topic="/chatter"),
        r"/chatter is of type std_msgs/msg/String, expected sensor_msgs/msg/Image or",
    ),
    "unknown encoding": (
        lambda m: [Sent("/c", START, m.image(pixels(0), 0, "bayer_rggb16")), *camera_info(m)],
        CONFIG,
        r'no depth images: /c: the encoding "bayer_rggb16".*expected 16UC1',
    ),
    "no camera info": (
        lambda m: [*images(m), *tf(m)],
        CONFIG,
        r"no topic of camera info; give --camera-topic TOPIC or --camera FILE; it has: .*image_re",
    ),
    "several camera infos": (
        lambda m: [*images(m), *camera_info(m, "/a/info"), *camera_info(m, "/b/info"), *tf(m)],
        CONFIG,
        r"several topics of camera info; choose one by --camera-topic .*: /a/info, /b/info",
    ),
    "distorted images": (
        lambda m: [
            *images(m, "/camera/depth/image_raw"),
            Sent(INFO, START, m.camera_info(CAMERA, [0.1, 0, 0, 0, 0])),
            *tf(m),
        ],
        CONFIG,
        r"the images are distorted, says /camera/depth/camera_info.*image_rect.*--camera",
    ),
    "camera info is empty": (
        lambda m: [*images(m), Sent(INFO, START, unknown_camera(m)), *tf(m)],
        CONFIG,
        r"says nothing of the camera's intrinsics; give --camera FILE",
    ),
    "no wrist": (
        lambda m: [*images(m), *camera_info(m)],
        CONFIG,
        r'tf has no frame "palm".*no topic of geometry_msgs/msg/PoseStamped.*--hand-pose FILE',
    ),
    "wrist and camera apart": (
        lambda m: [*images(m), *camera_info(m), *tf(m)[1:]],
        CONFIG,
        r"tf does not connect palm with the camera's frame camera_depth_optical_frame",
    ),
    "several poses": (
        lambda m: [
            *images(m),
            *camera_info(m),
            *(Sent(t, START, m.pose(np.eye(4), START, OPTICAL)) for t in ("/p", "/q")),
        ],
        CONFIG,
        r"several topics of poses; choose one by --pose-topic TOPIC or --hand-frame FRAME: /p, /q",
    ),
    "tf in a circle": (
        lambda m: [
            *images(m),
            *camera_info(m),
            *(
                Sent("/tf_static", START, m.transforms((a, b, np.eye(4), START)))
                for a, b in ((OPTICAL, "palm"), ("palm", OPTICAL))
            ),
        ],
        CONFIG,
        r"tf goes in a circle at",
    ),
    "two wrists": (
        everything,
        replace(CONFIG, hand_frame="palm", pose_topic="/p"),
        "--hand-frame or --pose-topic, not both",
    ),
}


def unknown_camera(make: Messages) -> Any:
    info = make.camera_info(CAMERA)
    name = "K" if make.kind == "ros1" else "k"
    setattr(info, name, np.zeros(9))
    return info


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
@pytest.mark.parametrize("case", BAD)
def test_what_is_missing_is_said(tmp_path: Path, kind: BagKind, case: str) -> None:
    make, config, message = BAD[case]
    with pytest.raises(InputError, match=message):
        open_source(str(write_recording(tmp_path, kind, make)), config)


def test_rectified_images_of_a_distorting_lens(tmp_path: Path) -> None:
    def make(m: Messages) -> list[Sent]:
        info = m.camera_info(CAMERA, [0.1, 0, 0, 0, 0])
        info.k = info.k * 1.1
        info.k[8] = 1
        return [*images(m), Sent(INFO, START, info), *tf(m)]

    assert frames(open_source(str(write_recording(tmp_path, "mcap", make)), CONFIG))[0].camera == (
        CAMERA
    )


@pytest.mark.parametrize("kind", ["sqlite3", "mcap"])
@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_compressed_recordings(tmp_path: Path, kind: BagKind, mode: CompressionMode) -> None:
    path = write_recording(tmp_path, kind, everything, mode=mode)
    assert len(frames(open_source(str(path), CONFIG))) == FRAMES


def test_mcap_of_other_software(tmp_path: Path) -> None:
    path = write_recording(tmp_path, "mcap", everything)
    file = storage_file(path)
    file.write_bytes(file.read_bytes().replace(b"ros2", b"ros1", 1))
    with pytest.raises(InputError, match=r"can be read: Profile is not ros2"):
        open_source(str(path), CONFIG)


def test_no_such_source(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no recording"):
        open_source(str(tmp_path / "x.bag"), CONFIG)
    with pytest.raises(InputError, match="there is no file or folder"):
        open_source(str(tmp_path / "x"), CONFIG)
    (tmp_path / "notes.txt").write_text("hello")
    for path in (tmp_path, tmp_path / "notes.txt"):
        with pytest.raises(InputError, match="is no source: expected a folder of depth images"):
            open_source(str(path), CONFIG)


def test_without_the_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("inhand.streams.bag.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'inhand\[streams\]'"):
        open_source(str(tmp_path / "x.bag"), CONFIG)
