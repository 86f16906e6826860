"""Results as JSON lines: one object an image, and a summary as the last line."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.errors import InputError
from inhand.streams.new_file import check_new
from inhand.streams.runner import Result, Summary


class JsonLines:
    """Writes a file line by line; every line is on its way to the disk before the next image.

    Args:
        path: a file that does not exist yet; its folder is made where it is missing.

    Raises:
        InputError: it exists, or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._whole = 0
        """Bytes of whole lines."""
        check_new(path)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("xb", buffering=0)
        except OSError as error:
            raise InputError(f"cannot write {path}: {error.strerror or error}") from error

    def write(self, result: Result) -> None:
        """See `runner.Output.write`."""
        self._append(as_dict(result))

    def finish(self, summary: Summary) -> None:
        """See `runner.Output.finish`."""
        try:
            self._append({"summary": summary.as_dict()})
        finally:
            self._file.close()

    def _append(self, fields: dict[str, Any]) -> None:
        left = memoryview(json.dumps(fields, allow_nan=False).encode() + b"\n")
        size = len(left)
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError as error:
            self._file.truncate(self._whole)
            raise InputError(
                f"cannot write {self._path}: {error.strerror or error}; its {self._whole} bytes "
                "until then are whole lines"
            ) from error
        self._whole += size


def as_dict(result: Result) -> dict[str, Any]:
    """A result in JSON's types."""
    frame, estimate = result.frame, result.estimate
    return {
        "frame": frame.name,
        "time_ns": frame.time_ns,
        "frame_id": frame.frame_id,
        "dropped_before": result.dropped,
        "found": estimate.found,
        "reason": estimate.reason,
        "confidence": float(estimate.confidence),
        "T_camera_object": _rows(estimate.T_camera_object),
        "T_camera_hand": _rows(estimate.T_camera_hand),
        "covariance": _rows(estimate.covariance),
        "joint_positions": {name: float(q) for name, q in estimate.joint_positions.items()},
        "timings": {stage: round(float(t), 6) for stage, t in estimate.timings.items()},
    }


def _rows(T: NDArray[np.float64] | None) -> list[list[float]] | None:
    return None if T is None else np.asarray(T, dtype=np.float64).tolist()
