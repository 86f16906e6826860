"""Directions to look at an object from."""

import numpy as np
from numpy.typing import NDArray


def spread_directions(count: int) -> NDArray[np.float64]:
    """Unit vectors (count, 3) spread evenly over the sphere: a Fibonacci spiral."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    width = np.sqrt(1 - z**2)
    return np.stack([width * np.cos(turn), width * np.sin(turn), z], axis=1)
