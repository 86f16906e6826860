"""Files that commands write: there completely or as they were before, whatever goes wrong."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from inhand.errors import InputError


@contextmanager
def whole_file(path: str | Path, *, durable: bool = False) -> Iterator[Path]:
    """Gives a place to write a file to, which is renamed to `path` when the block ends well.

    Its folder is made where it is missing. What was at `path` stays until then. A device or a pipe
    such as /dev/stdout is written to as it is.

    Args:
        path: the file.
        durable: whether it is to outlive a power cut too; takes a few milliseconds.

    Raises:
        InputError: the file cannot be written, such as when the disk is full.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists() and not path.is_file():
            yield path
            return
        place = path.resolve()  # a link stays one
        unfinished = place.with_name(f".unfinished-{place.name}")
        try:
            yield unfinished
            if durable:
                with unfinished.open("r+b") as file:
                    os.fsync(file)
            os.replace(unfinished, place)
        except BaseException:
            with suppress(OSError):  # a full disk wants the space back
                unfinished.unlink(missing_ok=True)
            raise
        if durable:
            with suppress(OSError):  # not every system can
                _sync_folder(place.parent)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}") from error


def write_whole(path: str | Path, data: bytes | str, *, durable: bool = False) -> None:
    """Write a file as by `whole_file`; text in UTF-8.

    Raises:
        InputError: it cannot be written.
    """
    with whole_file(path, durable=durable) as unfinished:
        unfinished.write_bytes(data.encode() if isinstance(data, str) else data)


def _sync_folder(folder: Path) -> None:
    """Force the renames in a folder onto the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
