"""Files in and out: depth and colour images, wrist poses, results."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.checks import file_path
from inhand.errors import InputError
from inhand.estimate import Candidate, PoseEstimate
from inhand.estimator import check_depth
from inhand.geometry.se3 import check_rigid
from inhand.whole_file import whole_file, write_whole

if TYPE_CHECKING:
    from PIL.Image import Image

NOTHING_THERE = 65504.0
"""Renderers mark the empty background by the largest half-precision number, or by 1e10."""

_SIXTEEN_BIT_MODES = ("I;16", "I;16B", "I;16L", "I;16N", "I")
_EXPECTED = "a 16-bit PNG, a 16-bit or float TIFF, an EXR or a .npy file"
_EXR_MAGIC = b"\x76\x2f\x31\x01"


def read_depth(path: str | Path, camera: Camera) -> NDArray[np.float32]:
    """Read a depth image: PNG (16 bit), TIFF (16 bit or float), EXR or .npy.

    Integers count `camera.depth_unit`; floating-point numbers are metres.

    Returns:
        depth z [m], shape (H, W), 0 where there is no reading.

    Raises:
        InputError: the file is missing or unreadable, is no depth image, has another size than the
            camera, or its unit is wrong.
    """
    path = _existing(path, "depth image")
    readers: dict[str, Callable[[Path], NDArray[Any]]] = {
        ".png": _read_grey,
        ".tif": _read_grey,
        ".tiff": _read_grey,
        ".exr": _read_exr,
        ".npy": _read_npy,
    }
    if path.suffix.lower() not in readers:
        raise InputError(f"cannot read depth from {path.name}: expected {_EXPECTED}")
    pixels = readers[path.suffix.lower()](path)
    if pixels.dtype.kind == "f":
        depth = np.nan_to_num(pixels.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
        depth[depth >= NOTHING_THERE] = 0.0
    else:
        depth = (pixels * camera.depth_unit).astype(np.float32)
    try:
        return check_depth(depth, camera)
    except InputError as error:
        counts = "" if pixels.dtype.kind == "f" else f" (a count is {camera.depth_unit:g} m)"
        raise InputError(f"{path}{counts}: {error}") from error


def read_colour(path: str | Path, camera: Camera) -> NDArray[np.uint8]:
    """Read a colour image, shape (H, W, 3), whose pixels are those of the depth image.

    Raises:
        InputError: the file is missing or unreadable, or has another size than the camera.
    """
    path = _existing(path, "colour image")
    pixels = _open_image(path, lambda image: np.asarray(image.convert("RGB")))
    if pixels.shape[:2] != (camera.height, camera.width):
        raise InputError(
            f"{path} is {pixels.shape[1]} x {pixels.shape[0]} pixels but the depth image "
            f"{camera.width} x {camera.height}; align the colour image to depth"
        )
    return pixels


def read_transform(path: str | Path, key: str = "T_camera_hand") -> NDArray[np.float64]:
    """Read the rigid transform, shape (4, 4) [m], that a JSON file holds under `key`.

    Raises:
        InputError: the file is missing, is not JSON, lacks the key, or holds no rigid transform.
    """
    fields = read_json(path)
    if key not in fields:
        raise InputError(
            f'{path} lacks the key "{key}", a 4x4 matrix; it has {", ".join(fields) or "none"}'
        )
    return check_rigid(fields[key], f"{key} in {path}")


def write_result(path: str | Path, estimate: PoseEstimate) -> None:
    """Write an estimate as JSON: poses [m], joints [rad], candidates, confidence, timings [s].

    Raises:
        InputError: the file cannot be written.
    """
    fields = {
        "found": estimate.found,
        "reason": estimate.reason,
        "confidence": estimate.confidence,
        "T_camera_object": estimate.T_camera_object,
        "T_camera_hand": estimate.T_camera_hand,
        "joint_positions": estimate.joint_positions,
        "candidates": [
            {"T_camera_object": c.T_camera_object, "scores": c.scores} for c in estimate.candidates
        ],
        "timings": estimate.timings,
    }
    text = json.dumps(_plain(fields), indent=1, allow_nan=False) + "\n"
    write_whole(path, text)


def read_result(path: str | Path) -> PoseEstimate:
    """Read an estimate that `write_result` wrote.

    Raises:
        InputError: the file is missing, is not JSON or no result.
    """
    fields = read_json(path)
    try:
        return PoseEstimate(
            found=fields["found"],
            reason=fields["reason"],
            confidence=fields["confidence"],
            T_camera_object=_matrix(fields["T_camera_object"]),
            T_camera_hand=_matrix(fields["T_camera_hand"]),
            joint_positions=fields["joint_positions"],
            candidates=tuple(
                Candidate(np.array(c["T_camera_object"]), c["scores"]) for c in fields["candidates"]
            ),
            timings=fields["timings"],
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path} is no result of an estimate: {error!r}") from error


def write_picture(path: str | Path, picture: "Image") -> None:
    """Write a picture, in the format that the file's ending names.

    Raises:
        InputError: the file cannot be written, or its ending names no format.
    """
    try:
        with whole_file(path) as unfinished:
            picture.save(unfinished)
    except ValueError as error:
        raise InputError(f"cannot write {path}: {error}") from error


def _existing(path: str | Path, what: str) -> Path:
    path = file_path(path, what)
    if not path.exists():
        raise InputError(f"there is no {what} {path}")
    if not path.is_file():
        raise InputError(f"the {what} {path} is a folder, expected a file")
    if path.stat().st_size == 0:
        raise InputError(f"the {what} {path} is empty")
    return path


def _open_image(path: Path, read: Callable[[Any], NDArray[Any]]) -> NDArray[Any]:
    from PIL import Image

    try:
        with Image.open(path) as image:
            image.load()
            return read(image)
    except InputError:
        raise
    except Exception as error:  # a damaged image makes Pillow raise nearly anything
        raise InputError(f"cannot read the image {path}: {error}") from error


def _read_grey(path: Path) -> NDArray[Any]:
    def read(image: Any) -> NDArray[Any]:
        if image.mode != "F" and image.mode not in _SIXTEEN_BIT_MODES:
            raise InputError(
                f"{path} is no depth image: it has {len(image.getbands())} channel(s) of 8 bits "
                f"(mode {image.mode}), expected one of 16 bits or float; is it a picture made for "
                "looking at?"
            )
        return np.asarray(image)

    return _open_image(path, read)


def _read_exr(path: Path) -> NDArray[Any]:
    import OpenEXR

    with path.open("rb") as file:
        if file.read(4) != _EXR_MAGIC:
            raise InputError(f"{path} is not an EXR file")
    try:
        with OpenEXR.File(str(path), separate_channels=True) as image:
            channels = {name: np.array(c.pixels) for name, c in image.channels().items()}
    except Exception as error:  # the library raises plain RuntimeError and more
        raise InputError(f"cannot read the image {path}: {error}") from error
    named = [n for n in channels if n.split(".")[-1].lower() in ("z", "v", "y", "depth")]
    if len(channels) == 1:
        return next(iter(channels.values()))
    if len(named) == 1:
        return channels[named[0]]
    first, *others = channels.values()
    if all(np.array_equal(first, other, equal_nan=True) for other in others):
        return first
    raise InputError(
        f"{path} has the channels {', '.join(channels)}: which one is depth? Save it alone, or "
        "name it Z"
    )


def _read_npy(path: Path) -> NDArray[Any]:
    try:
        pixels = np.load(path, allow_pickle=False)
    except Exception as error:  # a damaged file makes numpy raise nearly anything
        raise InputError(f"cannot read the array {path}: {error}") from error
    if not isinstance(pixels, np.ndarray):
        raise InputError(f"{path} is an archive of arrays, expected one array saved by numpy.save")
    kind, size = pixels.dtype.kind, pixels.dtype.itemsize
    if kind not in "iuf" or (kind in "iu" and size < 2):
        raise InputError(
            f"{path} holds {pixels.dtype}, expected integers of 16 bits or more, or floats [m]"
        )
    return pixels


def read_json(path: str | Path) -> dict[str, Any]:
    """The named fields of a JSON file.

    Raises:
        InputError: there is no such file, or it does not hold a JSON object.
    """
    path = _existing(path, "file")
    try:
        fields = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not JSON: {error}") from error
    if not isinstance(fields, dict):
        raise InputError(f"{path} must hold a JSON object with named fields")
    return fields


def _matrix(rows: list[list[float]] | None) -> NDArray[np.float64] | None:
    return None if rows is None else np.array(rows, dtype=np.float64)


def _plain(value: Any) -> Any:
    """`value` in JSON's own types; numbers that are not finite become null."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
