"""Reading images and poses; writing results."""

import json
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest
from PIL import Image

from inhand.camera import Camera
from inhand.errors import InputError
from inhand.estimate import Candidate, PoseEstimate
from inhand.io import read_colour, read_depth, read_result, read_transform, write_result

CAMERA = Camera(60.0, 60.0, 3.5, 2.5, width=8, height=6, depth_unit=0.0001)
METRES = np.linspace(0.3, 0.9, 48, dtype=np.float32).reshape(6, 8)
COUNTS = np.rint(METRES / 0.0001).astype(np.uint16)


def write_exr(path: Path, **channels: np.ndarray) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {name.replace("_", "."): c for name, c in channels.items()}).write(
        str(path)
    )


@pytest.mark.parametrize("name", ["d.png", "d.tif", "d.TIFF", "d.npy"])
def test_integers_count_the_depth_unit(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    if path.suffix == ".npy":
        np.save(path, COUNTS)
    else:
        assert cv2.imwrite(str(path), COUNTS)
    depth = read_depth(path, CAMERA)
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, COUNTS * 0.0001, rtol=1e-6)


def test_micrometres_in_32_bits(tmp_path: Path) -> None:
    np.save(tmp_path / "d.npy", np.rint(METRES * 1e6).astype(np.int32))
    depth = read_depth(tmp_path / "d.npy", Camera(60.0, 60.0, 3.5, 2.5, 8, 6, 1e-6))
    np.testing.assert_allclose(depth, METRES, atol=1e-6)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_floats_are_metres(tmp_path: Path, dtype: type) -> None:
    np.save(tmp_path / "d.npy", METRES.astype(dtype))
    np.testing.assert_allclose(read_depth(tmp_path / "d.npy", CAMERA), METRES, rtol=1e-3)


def test_float_tiff(tmp_path: Path) -> None:
    assert cv2.imwrite(str(tmp_path / "d.tif"), METRES)
    np.testing.assert_array_equal(read_depth(tmp_path / "d.tif", CAMERA), METRES)


@pytest.mark.parametrize(
    "channels",
    [
        {"Z": METRES},
        {"ViewLayer_Depth_Z": METRES, "R": 0 * METRES, "G": 0 * METRES, "B": METRES},
        {"R": METRES, "G": METRES, "B": METRES},
    ],
)
def test_exr(tmp_path: Path, channels: dict[str, np.ndarray]) -> None:
    write_exr(tmp_path / "d.exr", **channels)
    np.testing.assert_array_equal(read_depth(tmp_path / "d.exr", CAMERA), METRES)


@pytest.mark.parametrize("nothing", [np.nan, np.inf, -np.inf, 1e10, 65504.0, 0.0])
def test_marks_of_no_reading_become_zero(tmp_path: Path, nothing: float) -> None:
    image = METRES.copy()
    image[2:] = nothing
    np.save(tmp_path / "d.npy", image)
    depth = read_depth(tmp_path / "d.npy", CAMERA)
    assert (depth[2:] == 0).all()
    np.testing.assert_array_equal(depth[:2], METRES[:2])


def test_counts_of_another_unit_name_the_unit(tmp_path: Path) -> None:
    np.save(tmp_path / "d.npy", COUNTS)
    camera = Camera(60.0, 60.0, 3.5, 2.5, width=8, height=6, depth_unit=1.0)
    with pytest.raises(InputError, match=r"d\.npy \(a count is 1 m\): the median depth is"):
        read_depth(tmp_path / "d.npy", camera)


def test_an_image_without_readings_is_no_bad_input(tmp_path: Path) -> None:
    np.save(tmp_path / "d.npy", np.zeros_like(COUNTS))
    assert not read_depth(tmp_path / "d.npy", CAMERA).any()


def test_real_frame(shared_data: Path) -> None:
    folder = shared_data / "real_frame"
    camera = Camera.from_json(folder / "camera.json")
    depth = read_depth(folder / "depth.png", camera)
    counts = np.asarray(cv2.imread(str(folder / "depth.png"), cv2.IMREAD_UNCHANGED))
    np.testing.assert_allclose(depth, counts * 0.001, rtol=1e-6)
    assert read_colour(folder / "rgb.png", camera).shape == (480, 640, 3)
    T = read_transform(folder / "hand_pose.json")
    assert T[3].tolist() == [0, 0, 0, 1]


def save_png(path: Path, pixels: np.ndarray) -> Path:
    Image.fromarray(pixels).save(path)
    return path


def save_npy(path: Path, array: np.ndarray) -> Path:
    np.save(path, array)
    return path


def save_bytes(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


GREY, RGB = np.zeros((6, 8), np.uint8), np.zeros((6, 8, 3), np.uint8)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda f: f / "missing.png", r"there is no depth image .*missing\.png"),
        (lambda f: f, "is a folder"),
        (lambda f: save_bytes(f / "d.png", b""), "is empty"),
        (lambda f: save_bytes(f / "d.png", b"no image"), "cannot read the image"),
        (lambda f: save_bytes(f / "d.exr", b"no image"), "is not an EXR"),
        (lambda f: save_bytes(f / "d.exr", b"\x76\x2f\x31\x01 cut"), "cannot read the image"),
        (lambda f: save_bytes(f / "d.npy", b"no array"), "cannot read the array"),
        (lambda f: save_bytes(f / "d.jpg", b"x"), "expected a 16-bit PNG"),
        (lambda f: save_png(f / "d.png", GREY), r"1 channel\(s\) of 8 bits"),
        (lambda f: save_png(f / "d.png", RGB), r"3 channel\(s\) of 8 bits"),
        (lambda f: save_png(f / "d.png", COUNTS[:4]), "8 x 4 pixels but the camera 8 x 6"),
        (lambda f: save_npy(f / "d.npy", COUNTS.T), "6 x 8 pixels but the camera 8 x 6"),
        (lambda f: save_npy(f / "d.npy", METRES[None]), r"shape \(H, W\), got shape \(1, 6, 8\)"),
        (lambda f: save_npy(f / "d.npy", np.zeros((0, 8))), "8 x 0 pixels"),
        (lambda f: save_npy(f / "d.npy", METRES * 1000), "millimetres"),
        (lambda f: save_npy(f / "d.npy", -METRES), "negative"),
        (lambda f: save_npy(f / "d.npy", GREY), "holds uint8"),
        (lambda f: save_npy(f / "d.npy", METRES + 1j), "holds complex"),
        (lambda f: save_npy(f / "d.npy", METRES > 0), "holds bool"),
        (lambda f: save_npy(f / "d.npy", METRES.astype(object)), "cannot read the array"),
    ],
)
def test_bad_depth_files(tmp_path: Path, make: object, message: str) -> None:
    assert callable(make)
    with pytest.raises(InputError, match=message):
        read_depth(make(tmp_path), CAMERA)


def test_a_png_cut_short(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    camera = Camera(60.0, 60.0, 50, 50, width=100, height=100)
    path = save_png(tmp_path / "d.png", rng.integers(300, 900, (100, 100), dtype=np.uint16))
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(InputError, match="cannot read the image"):
        read_depth(path, camera)


def test_an_exr_with_several_candidates(tmp_path: Path) -> None:
    write_exr(tmp_path / "d.exr", R=METRES, G=2 * METRES)
    with pytest.raises(InputError, match=r"channels (G, R|R, G)"):
        read_depth(tmp_path / "d.exr", CAMERA)


def test_an_archive_of_arrays(tmp_path: Path) -> None:
    np.savez(tmp_path / "d.npz", METRES)
    (tmp_path / "d.npz").rename(tmp_path / "d.npy")
    with pytest.raises(InputError, match="archive"):
        read_depth(tmp_path / "d.npy", CAMERA)


def test_colour(tmp_path: Path) -> None:
    path = save_png(tmp_path / "c.png", GREY + 7)
    np.testing.assert_array_equal(read_colour(path, CAMERA), RGB + 7)
    with pytest.raises(InputError, match="align the colour image"):
        read_colour(path, Camera(60.0, 60.0, 3.5, 2.5, width=16, height=12))
    with pytest.raises(InputError, match="no colour image"):
        read_colour(tmp_path / "missing.png", CAMERA)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("{", "is not JSON"),
        ("\xff\xfe", "is not JSON"),
        ("[1, 2]", "named fields"),
        ("{}", 'lacks the key "T_camera_hand"'),
        ('{"pose": 1}', "it has pose"),
        ('{"T_camera_hand": null}', "4x4"),
        ('{"T_camera_hand": [[1, 0], [0, 1]]}', r"got shape \(2, 2\)"),
        ('{"T_camera_hand": [["a"]]}', "matrix of numbers"),
        (json.dumps({"T_camera_hand": np.diag([1, 1, -1, 1]).tolist()}), "left-handed"),
        (json.dumps({"T_camera_hand": np.diag([2, 2, 2, 1]).tolist()}), "not a rotation"),
        (json.dumps({"T_camera_hand": np.full((4, 4), np.nan).tolist()}), "NaN"),
    ],
)
def test_bad_wrist_poses(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "t.json").write_text(text, encoding="latin-1")
    with pytest.raises(InputError, match=message):
        read_transform(tmp_path / "t.json")


def test_missing_wrist_pose(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no file"):
        read_transform(tmp_path / "t.json")


def estimate() -> PoseEstimate:
    T = np.eye(4)
    T[:3, 3] = 0.1, -0.2, 0.5
    return PoseEstimate(
        found=True,
        reason="",
        T_camera_object=T,
        joint_positions={"left": 0.25, "right": 1.5},
        T_camera_hand=np.eye(4),
        confidence=0.75,
        candidates=(Candidate(T, {"score": np.float32(2.5)}), Candidate(np.eye(4), {"score": 1})),  # type: ignore[dict-item]
        timings={"wrist": 0.002},
    )


def test_result_survives_the_file(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "result.json"
    write_result(path, estimate())
    again = read_result(path)
    assert again.found
    assert again.confidence == 0.75
    np.testing.assert_array_equal(again.T_camera_object, estimate().T_camera_object)
    np.testing.assert_array_equal(again.T_camera_hand, np.eye(4))
    assert again.joint_positions == estimate().joint_positions
    assert [c.scores for c in again.candidates] == [{"score": 2.5}, {"score": 1}]
    assert again.timings == {"wrist": 0.002}


def test_no_answer_survives_the_file(tmp_path: Path) -> None:
    nothing = PoseEstimate(False, "the object is hidden", None, {}, None, 0.0)
    write_result(tmp_path / "r.json", nothing)
    assert read_result(tmp_path / "r.json") == nothing


def test_a_result_holds_plain_json(tmp_path: Path) -> None:
    odd = PoseEstimate(True, "", np.eye(4), {}, None, float("nan"), timings={"a": np.inf})
    write_result(tmp_path / "r.json", odd)
    assert "NaN" not in (tmp_path / "r.json").read_text()
    assert json.loads((tmp_path / "r.json").read_text())["confidence"] is None


def test_bad_results(tmp_path: Path) -> None:
    (tmp_path / "r.json").write_text("{}")
    with pytest.raises(InputError, match="no result"):
        read_result(tmp_path / "r.json")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write"):
        write_result(tmp_path / "file" / "r.json", estimate())
