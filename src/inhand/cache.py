"""Derived model data on disk, addressed by the content it was derived from."""

import dataclasses
import hashlib
import os
import zipfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[Any]]
Whole = TypeVar("Whole")

FORMAT_VERSION = 3
"""Raise it when code that builds cached arrays changes its result."""


def cache_folder() -> Path:
    """Environment variable INHAND_CACHE_DIR, else `~/.cache/inhand`."""
    return Path(os.environ.get("INHAND_CACHE_DIR") or Path.home() / ".cache" / "inhand")


def cached(
    key_parts: Iterable[str | bytes | int | float], build: Callable[[], Mapping[str, NDArray[Any]]]
) -> Arrays:
    """The arrays that `build()` returns, from disk when they were built before.

    A cache that cannot be read or written only costs time: the arrays are then built.

    Args:
        key_parts: everything the result depends on; order matters.
        build: makes the arrays by name.
    """
    path = cache_folder() / f"{_key(key_parts)}.npz"
    try:
        with np.load(path, allow_pickle=False) as stored:
            return dict(stored)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        pass
    arrays = dict(build())
    _store(path, arrays)
    return arrays


def taken_apart(**wholes: Any) -> Arrays:
    """The fields of dataclasses as arrays for `cached`, by "name.field"; None is left out."""
    return {
        f"{name}.{field.name}": np.asarray(value)
        for name, whole in wholes.items()
        for field in dataclasses.fields(whole)
        if (value := getattr(whole, field.name)) is not None
    }


def put_together(kind: type[Whole], name: str, arrays: Arrays) -> Whole:
    """The dataclass of which `taken_apart` made the arrays of this name."""
    names = (f"{name}.{field.name}" for field in dataclasses.fields(kind))  # type: ignore[arg-type]
    found = (arrays.get(key) for key in names)
    return kind(*(a if a is None or a.ndim else a.item() for a in found))


def _key(parts: Iterable[str | bytes | int | float]) -> str:
    digest = hashlib.sha256(f"inhand cache {FORMAT_VERSION}".encode())
    for part in parts:
        raw = part if isinstance(part, bytes) else repr(part).encode()
        digest.update(f"|{type(part).__name__}:{len(raw)}:".encode() + raw)
    return digest.hexdigest()


def _store(path: Path, arrays: Arrays) -> None:
    """Write beside the final name, then rename: a reader never meets half a file."""
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as file:
            temporary = Path(file.name)
            np.savez(file, **arrays)  # type: ignore[arg-type]
        temporary.replace(path)
    except OSError:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
