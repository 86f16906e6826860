"""RVL, a lossless code for depth images (Wilson, "Fast Lossless Depth Image Compression", 2017).

An image is a row of runs: how many pixels are zero, how many are not, and of each of those the
difference from the one before. All numbers are written three bits to a nibble, the lowest first,
and the fourth bit says that more follow; nibbles fill 32-bit words from the top.
"""

import numpy as np
from numpy.typing import NDArray


def decode_rvl(data: bytes, size: int) -> NDArray[np.uint16]:
    """Decode an image of `size` pixels.

    Raises:
        ValueError: the data are cut short or no RVL.
    """
    numbers = _numbers(data)
    differences = (numbers >> 1) ^ -(numbers & 1)
    pixels = np.zeros(size, dtype=np.int64)
    at, pixel, last = 0, 0, 0
    while pixel < size:  # once a run of readings: a few hundred times an image
        if at + 2 > len(numbers):
            raise ValueError("the RVL data are cut short")
        zeros, readings = int(numbers[at]), int(numbers[at + 1])
        at, pixel = at + 2, pixel + zeros
        if pixel + readings > size or at + readings > len(numbers) or not zeros + readings:
            raise ValueError("the RVL data do not fit the image")
        pixels[pixel : pixel + readings] = last + np.cumsum(differences[at : at + readings])
        at, pixel = at + readings, pixel + readings
        if readings:
            last = int(pixels[pixel - 1])
    if pixels.min(initial=0) < 0 or pixels.max(initial=0) > 0xFFFF:
        raise ValueError("the RVL data hold depths beyond 16 bits")
    return pixels.astype(np.uint16)


def _numbers(data: bytes) -> NDArray[np.int64]:
    """All numbers of the code; padding at the end may add some that mean nothing."""
    words = np.frombuffer(data[: len(data) // 4 * 4], dtype="<u4")
    nibbles = ((words[:, None] >> np.arange(28, -1, -4, dtype=np.uint32)) & 15).ravel()
    ends = np.flatnonzero(nibbles < 8)  # the last nibble of each number
    nibbles = nibbles[: ends[-1] + 1] if len(ends) else nibbles[:0]
    starts = np.concatenate([[0], ends[:-1] + 1]) if len(ends) else ends
    place = np.arange(len(nibbles)) - np.repeat(starts, ends - starts + 1)
    if place.max(initial=0) > 10:
        raise ValueError("the RVL data hold a number beyond 32 bits")
    parts = (nibbles & 7).astype(np.int64) << (3 * place)
    return np.add.reduceat(parts, starts) if len(starts) else parts
