"""Numbers that survive writing and reading unchanged."""

import json
from collections.abc import Iterable
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.errors import InputError
from inhand.geometry.se3 import check_rigid


def millimetres(lengths: Iterable[float]) -> list[str]:
    """Lengths [m] as decimal numbers in millimetres, which `metres` turns into the same float64.

    The decimal point is moved in the shortest text that stands for the number; a multiplication
    by 1000 would round.
    """
    return [format(Decimal(repr(float(x))).scaleb(3), "f") for x in lengths]


def metres(lengths: Iterable[Any]) -> NDArray[np.float64]:
    """Lengths [m], shape (n,), of decimal numbers (text, int or `Decimal`) in millimetres.

    Raises:
        ValueError: one is no finite number.
    """
    try:
        return np.array([float(Decimal(x).scaleb(-3)) for x in lengths], dtype=np.float64)
    except (InvalidOperation, TypeError) as error:
        raise ValueError(f"expected lengths in mm, got {lengths!r:.80}") from error


def rigid(R: Any, t: Any, name: str) -> NDArray[np.float64]:
    """The transform, (4, 4), of 9 elements of a rotation matrix, row by row, and a translation.

    Numbers that are a rotation to within 1e-9 stay as they are; others are made one.

    Raises:
        InputError: they are no rigid transform.
    """
    try:
        T = np.eye(4)
        T[:3, :3] = np.array(R, dtype=np.float64).reshape(3, 3)
        T[:3, 3] = t
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be 9 and 3 numbers, got {R!r:.80} and {t!r:.80}") from error
    checked = check_rigid(T, name)
    return T if np.allclose(T, checked, rtol=0, atol=1e-9) else checked


def read_json(path: Path) -> dict[str, Any]:
    """The object in a JSON file; numbers with a fraction are `Decimal`.

    Raises:
        InputError: the file is missing, is not JSON, or holds something else.
    """
    try:
        fields = json.loads(path.read_text(encoding="utf-8"), parse_float=Decimal)
    except FileNotFoundError as error:
        raise InputError(f"there is no file {path}") from error
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not complete JSON: {error}") from error
    if not isinstance(fields, dict):
        raise InputError(f"{path} must hold a JSON object")
    return fields
