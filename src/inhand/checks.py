"""Numbers and paths from the caller, checked before any library meets them."""

import math
from contextlib import suppress
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.errors import InputError


def finite_number(value: Any, name: str) -> float:
    """`value` as a float.

    Raises:
        InputError: it is no number (truth values and text are none), or not finite.
    """
    if isinstance(value, bool) or not isinstance(value, Real):
        raise InputError(f"{name} must be a number, got {value!r:.80}")
    with suppress(OverflowError):
        if math.isfinite(value):
            return float(value)
    raise InputError(f"{name} must be a finite number, got {value!r:.80}")


def whole_number(value: Any, name: str, least: int) -> int:
    """`value` as an int.

    Raises:
        InputError: it is no whole number, or less than `least`.
    """
    number = finite_number(value, name)
    if number % 1 or number < least:
        raise InputError(f"{name} must be a whole number of at least {least}, got {value!r:.80}")
    return int(value)


def number_array(value: Any, name: str, expected: str) -> NDArray[Any]:
    """`value` as an array of integers or floating-point numbers.

    Args:
        value: anything.
        name: what the caller knows it as.
        expected: what it should be, such as "a 4x4 matrix of numbers".

    Raises:
        InputError: it holds something else, or its rows differ in length.
    """
    try:
        array = np.asarray(value)
    except Exception as error:  # arrays of other libraries raise their own
        raise InputError(f"{name} must be {expected}, got {value!r:.80} ({error})") from error
    if array.dtype.kind not in "iuf":
        what = f"an array of {array.dtype}" if isinstance(value, np.ndarray) else f"{value!r:.80}"
        raise InputError(f"{name} must be {expected}, got {what}")
    return array


def file_path(path: Any, what: str) -> Path:
    """`path` as a Path.

    Raises:
        InputError: it is no path.
    """
    if not isinstance(path, str | PathLike):
        raise InputError(f"the {what} must be a path, got {path!r:.80}")
    return Path(path)
