"""Where results may be written."""

from pathlib import Path

from inhand.errors import InputError


def check_new(path: Path) -> None:
    """Raise InputError if there is something at `path` already: results replace nothing."""
    if path.exists():
        raise InputError(f"{path} exists already: remove it, or name another (--out, --bag)")
