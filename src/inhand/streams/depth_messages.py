"""Depth images as ROS messages hold them: sensor_msgs/Image and CompressedImage."""

import io
import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from inhand.errors import InputError
from inhand.streams.rvl import decode_rvl

RAW = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
"""Encodings of sensor_msgs/Image that are depth: counts of the depth unit, or metres."""
PACKERS = {
    "": "",
    "compressedDepth": "png",  # early versions knew PNG only, and did not say so
    "compressedDepth png": "png",
    "compressedDepth rvl": "rvl",
}
"""How pixels are packed, by what sensor_msgs/CompressedImage says after the encoding."""
HEADER = struct.Struct("<iff")
"""Before a compressed image: kind of quantisation, and its two parameters."""
MOST_PIXELS = 1 << 26
"""More than any depth camera has."""

SUPPORTED = "16UC1, mono16, 32FC1, and compressedDepth (PNG or RVL) of 16UC1 and 32FC1"


class Encoding(NamedTuple):
    """How a message holds depth."""

    pixel: str
    """NumPy's name of the pixels' type: u2 (counts of the depth unit) or f4 (metres)."""
    packer: str
    """png or rvl; empty for a raw image."""


def find_encoding(message: Any) -> Encoding:
    """How an Image or CompressedImage message holds depth.

    Raises:
        InputError: it holds no depth, or in a way that is not supported.
    """
    raw = hasattr(message, "encoding")
    name = message.encoding if raw else message.format
    pixels, _, rest = name.partition(";")
    pixel, packer = RAW.get(pixels.strip()), PACKERS.get(rest.strip())
    if pixel is None or packer is None or raw != (packer == ""):
        raise InputError(
            f'the encoding "{name}" is no depth that can be read: expected {SUPPORTED}'
        )
    return Encoding(pixel, packer)


def decode_depth(message: Any, depth_unit: float) -> NDArray[np.float32]:
    """Depth z [m], shape (H, W), 0 where there is no reading.

    Args:
        message: sensor_msgs/Image or sensor_msgs/CompressedImage.
        depth_unit: metres per count of integer images.

    Raises:
        InputError: the encoding is not supported, or the data are damaged.
    """
    encoding = find_encoding(message)
    try:
        if encoding.packer:
            pixels = _unpack(bytes(message.data), encoding)
        else:
            pixels = _raw_pixels(message, encoding)
    except (ValueError, struct.error) as error:
        raise InputError(f"the image is damaged: {error}") from error
    if pixels.dtype.kind == "u":
        return (pixels * depth_unit).astype(np.float32)
    return np.nan_to_num(pixels.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)


def _raw_pixels(message: Any, encoding: Encoding) -> NDArray[Any]:
    dtype = np.dtype(encoding.pixel).newbyteorder(">" if message.is_bigendian else "<")
    height, width, step = message.height, message.width, message.step
    if step < width * dtype.itemsize or len(message.data) < height * step:
        raise ValueError(
            f"{len(message.data)} bytes are too few for {width} x {height} pixels with rows of "
            f"{step} bytes"
        )
    rows = np.asarray(message.data[: height * step], dtype=np.uint8).reshape(height, step)
    return rows[:, : width * dtype.itemsize].copy().view(dtype)


def _unpack(data: bytes, encoding: Encoding) -> NDArray[Any]:
    """The pixels of a compressedDepth image; floats are packed as 16 bits of inverse depth."""
    _, scale, offset = HEADER.unpack_from(data)
    packed = data[HEADER.size :]
    counts = _unpack_rvl(packed) if encoding.packer == "rvl" else _unpack_png(packed)
    if encoding.pixel == "u2":
        return counts
    with np.errstate(divide="ignore"):
        depth = np.float32(scale) / (counts.astype(np.float32) - np.float32(offset))
    return np.where(counts == 0, np.float32(0), depth)


def _unpack_png(packed: bytes) -> NDArray[np.uint16]:
    from PIL import Image

    try:
        with Image.open(io.BytesIO(packed), formats=["PNG"]) as image:
            pixels = np.asarray(image)
    except Exception as error:  # damaged data make Pillow raise nearly anything
        raise ValueError(f"its PNG cannot be read ({error})") from error
    if pixels.ndim != 2 or image.mode == "L":
        raise ValueError(f"its PNG has pixels of the kind {image.mode}, expected 16 bits")
    return pixels.astype(np.uint16)


def _unpack_rvl(packed: bytes) -> NDArray[np.uint16]:
    width, height = struct.unpack_from("<II", packed)
    if not 0 < width * height <= MOST_PIXELS:
        raise ValueError(f"it claims to have {width} x {height} pixels")
    return decode_rvl(packed[8:], width * height).reshape(height, width)
