"""Results of a benchmark as a CSV file that BOP's own tools can score."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from inhand.datasets import bop_frames
from inhand.datasets.bop_results import BopResult, write_results
from inhand.evaluation.results import FrameResult


def write_bop_results(folder: Path, method: str, results: Iterable[FrameResult]) -> list[Path]:
    """Write the answers on frames of BOP data sets, `METHOD_DATASET-SPLIT.csv` for every split.

    Args:
        folder: where to.
        method: name of the method.
        results: results on frames of any layout; those of others are left out.

    Returns:
        The files that were written.

    Raises:
        InputError: a frame is not in its data set any more, or a file cannot be written.
    """
    by_split: dict[Path, list[BopResult]] = {}
    for result in results:
        path = Path(result.file).resolve()
        if result.T_camera_object is not None and bop_frames.is_frame(path):
            answer = BopResult(
                *bop_frames.frame_target(path),
                score=result.confidence,
                T_camera_object=np.array(result.T_camera_object),
                seconds=-1.0 if result.seconds is None else result.seconds,
            )
            by_split.setdefault(path.parents[2], []).append(answer)
    written = []
    for split, answers in by_split.items():
        # BOP's names have no other underscore or hyphen.
        names = [n.replace("_", "").replace("-", "") for n in (method, split.parent.name)]
        written.append(folder / f"{names[0]}_{names[1]}-{split.name}.csv")
        write_results(written[-1], answers)
    return written
