"""Results in BOP's CSV format: `scene_id,im_id,obj_id,score,R,t,time`."""

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inhand.datasets.exact import metres, millimetres, rigid
from inhand.errors import InputError
from inhand.whole_file import write_whole

_HEADER = ["scene_id", "im_id", "obj_id", "score", "R", "t", "time"]


@dataclass(frozen=True, eq=False)
class BopResult:
    """One estimated pose."""

    scene_id: int
    """Number of the scene."""
    image_id: int
    """Number of the image in the scene."""
    object_id: int
    """Number of the object's model."""
    score: float
    """Confidence; larger is better."""
    T_camera_object: NDArray[np.float64]
    """The pose, shape (4, 4)."""
    seconds: float = -1.0
    """Time that all objects of the image took together [s]; -1 if unknown."""


def write_results(path: str | Path, results: Iterable[BopResult]) -> None:
    """Write results; BOP asks for the file name `METHOD_DATASET-test.csv`.

    Numbers are written to the last bit of a float64.

    Raises:
        InputError: the file cannot be written.
    """
    lines = [",".join(_HEADER)]
    for r in results:
        R = " ".join(map(repr, r.T_camera_object[:3, :3].ravel().tolist()))
        t = " ".join(millimetres(r.T_camera_object[:3, 3]))
        lines.append(
            f"{r.scene_id},{r.image_id},{r.object_id},{float(r.score)!r},{R},{t},"
            f"{float(r.seconds)!r}"
        )
    write_whole(Path(path), "\n".join(lines) + "\n")


def read_results(path: str | Path) -> list[BopResult]:
    """Read results.

    Raises:
        InputError: the file is missing, or a line is no result.
    """
    try:
        with Path(path).open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
    except FileNotFoundError as error:
        raise InputError(f"there is no results file {path}") from error
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"cannot read the results {path}: {error}") from error
    if rows and rows[0] == _HEADER:
        rows = rows[1:]
    results = []
    for number, row in enumerate(rows):
        try:
            scene_id, image_id, object_id, score, R, t, seconds = row
            T = rigid([float(x) for x in R.split()], metres(t.split()), "the pose")
            ids = int(scene_id), int(image_id), int(object_id)
            results.append(BopResult(*ids, float(score), T, float(seconds)))
        except ValueError as error:
            raise InputError(
                f"result {number} in {path} is not {','.join(_HEADER)}: {error}"
            ) from error
    return results
