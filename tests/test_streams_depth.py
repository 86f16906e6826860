"""Depth images in ROS messages: encodings, packers, damage."""

import struct
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from ros_recording import Messages, compressed_depth, png

from inhand.errors import InputError
from inhand.streams.depth_messages import decode_depth, find_encoding
from inhand.streams.rvl import decode_rvl

COUNTS = np.array([[0, 1, 400], [65535, 401, 399]], dtype=np.uint16)
MAKE = Messages("mcap")


def rvl(pixels: NDArray[np.uint16]) -> bytes:
    """Wilson's code, one number after the other as in his article."""
    nibbles: list[int] = []

    def write(number: int) -> None:
        while True:
            nibbles.append((number & 7) | (8 if number > 7 else 0))
            number >>= 3
            if not number:
                return

    values, at, last = [int(v) for v in pixels.ravel()], 0, 0
    while at < len(values):
        for wanted in (True, False):
            run = at
            while run < len(values) and (values[run] == 0) == wanted:
                run += 1
            write(run - at)
            if not wanted:
                for value in values[at:run]:
                    delta = value - last
                    write(2 * delta if delta >= 0 else -2 * delta - 1)
                    last = value
            at = run
    nibbles += [0] * (-len(nibbles) % 8)
    words = ["".join(f"{n:x}" for n in nibbles[i : i + 8]) for i in range(0, len(nibbles), 8)]
    return b"".join(struct.pack("<I", int(word, 16)) for word in words)


def rvl_image(pixels: NDArray[np.uint16]) -> bytes:
    height, width = pixels.shape
    return compressed_depth(struct.pack("<II", width, height) + rvl(pixels))


@pytest.mark.parametrize("encoding", ["16UC1", "mono16"])
def test_counts_become_metres(encoding: str) -> None:
    depth = decode_depth(MAKE.image(COUNTS, 0, encoding), 0.001)
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, COUNTS * 0.001, rtol=1e-6)


def test_floats_are_metres_and_nan_is_no_reading() -> None:
    metres = np.array([[0.5, np.nan], [np.inf, 1.25]], dtype=np.float32)
    depth = decode_depth(MAKE.image(metres, 0, "32FC1"), 0.001)
    np.testing.assert_array_equal(depth, np.array([[0.5, 0], [0, 1.25]], dtype=np.float32))


def test_padded_rows_and_big_endian() -> None:
    message = MAKE.image(COUNTS, 0)
    rows = np.zeros((2, 10), dtype=np.uint8)
    rows[:, :6] = COUNTS.astype(">u2").view(np.uint8)
    message.step, message.is_bigendian, message.data = 10, 1, rows.ravel()
    np.testing.assert_allclose(decode_depth(message, 0.001), COUNTS * 0.001, rtol=1e-6)


@pytest.mark.parametrize("words", ["compressedDepth", "compressedDepth png"])
def test_compressed_counts(words: str) -> None:
    message = MAKE.compressed(compressed_depth(png(COUNTS)), 0, f"16UC1; {words}")
    np.testing.assert_allclose(decode_depth(message, 0.0001), COUNTS * 0.0001, rtol=1e-6)


def test_compressed_floats_are_inverse_depth() -> None:
    """As the ROS codec: q = a / z + b in 16 bits, a = z0 (z0 + 1), b = 1 - a / z_max."""
    z = np.linspace(0.3, 3.0, 12, dtype=np.float32).reshape(3, 4)
    a = 100.0 * 101.0
    b = 1 - a / 10.0
    quantised = (a / z + b).astype(np.uint16)
    quantised[0, 0] = 0
    packed = compressed_depth(png(quantised), a, b)
    depth = decode_depth(MAKE.compressed(packed, 0, "32FC1; compressedDepth png"), 0.001)
    assert depth[0, 0] == 0
    # One step of the quantisation is z^2 / a.
    assert np.all(np.abs(depth - z).ravel()[1:] <= (z**2 / a * 1.01).ravel()[1:])


def test_rvl_image() -> None:
    message = MAKE.compressed(rvl_image(COUNTS), 0, "16UC1; compressedDepth rvl")
    np.testing.assert_allclose(decode_depth(message, 0.001), COUNTS * 0.001, rtol=1e-6)


pixel_runs = st.lists(
    st.one_of(st.just(0), st.integers(0, 65535), st.integers(400, 420)), min_size=1, max_size=200
)


@given(pixel_runs)
def test_rvl_gives_back_what_was_coded(values: list[int]) -> None:
    pixels = np.array(values, dtype=np.uint16)
    np.testing.assert_array_equal(decode_rvl(rvl(pixels), len(pixels)), pixels)


@given(st.binary(max_size=64), st.integers(1, 100))
def test_rvl_of_anything_is_an_image_or_refused(data: bytes, size: int) -> None:
    with suppress(ValueError):
        assert decode_rvl(data, size).shape == (size,)


@pytest.mark.parametrize(
    "encoding", ["rgb8", "8UC1", "jpeg", "16UC1; compressedDepth zip", "16UC1; png", "16UC3", ""]
)
def test_other_encodings_are_refused_by_name(encoding: str) -> None:
    for message in (MAKE.image(COUNTS, 0, encoding), MAKE.compressed(b"", 0, encoding)):
        with pytest.raises(InputError, match=r"expected 16UC1.*32FC1.*compressedDepth") as raised:
            find_encoding(message)
        assert f'"{encoding}"' in str(raised.value)


def short_image() -> Any:
    message = MAKE.image(COUNTS, 0)
    message.data = message.data[:-1]
    return message


@pytest.mark.parametrize(
    "message",
    [
        short_image(),
        MAKE.compressed(b"12", 0, "16UC1; compressedDepth png"),
        MAKE.compressed(compressed_depth(png(COUNTS)[:40]), 0, "16UC1; compressedDepth png"),
        MAKE.compressed(compressed_depth(b"no png"), 0, "16UC1; compressedDepth png"),
        MAKE.compressed(rvl_image(COUNTS)[:-8], 0, "16UC1; compressedDepth rvl"),
        MAKE.compressed(
            compressed_depth(struct.pack("<II", 1 << 31, 1 << 31)), 0, "16UC1; compressedDepth rvl"
        ),
    ],
    ids=["short", "no header", "half a png", "no png", "half an rvl", "huge"],
)
def test_damaged_images_are_refused(message: Any) -> None:
    with pytest.raises(InputError, match="damaged"):
        decode_depth(message, 0.001)
