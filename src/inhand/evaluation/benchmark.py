"""Running a method over frames with ground truth."""

import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from inhand.baselines.method import Method, PreparedMethod, view_of
from inhand.datasets.frames import Frame, frame_name, read_frame
from inhand.errors import InputError
from inhand.evaluation.metrics import ObjectMetric
from inhand.evaluation.perturbations import Bodies, scaled
from inhand.evaluation.results import FrameResult, Key, Ledger, result_key
from inhand.evaluation.scoring import Scorer
from inhand.evaluation.sweeps import Perturbation
from inhand.hand import Hand
from inhand.object_model import ObjectModel


class Benchmark:
    """Scores a method frame by frame.

    Args:
        hand: the hand in the frames.
        load_object: gives the model of the object of a name.
        method: the method.
        device: Warp device of the method and of the scoring.
        seed: seed of the perturbations.
    """

    def __init__(
        self,
        hand: Hand,
        load_object: Callable[[str], ObjectModel],
        method: Method,
        device: str = "cpu",
        seed: int = 0,
    ) -> None:
        self._hand = hand
        self._load_object = load_object
        self._method = method
        self._device = device
        self._seed = seed
        self._scorer = Scorer(hand, device)
        self._objects: dict[str, tuple[ObjectMetric, Bodies]] = {}
        self._prepared: dict[str, PreparedMethod] = {}
        self._object_scale = 1.0

    def run(self, files: Sequence[Path], ledger: Ledger) -> Iterator[FrameResult]:
        """Results of the frames that `ledger` lacks, each written to it before it is handed on.

        A frame that cannot be read or that the method fails on is a result too.
        """
        return ledger.record(map(self.score, missing(files, self._method, ledger)))

    def score(self, file: Path, perturbation: Perturbation | None = None) -> FrameResult:
        """Run the method on one frame and score it; never raises for what a frame does.

        Args:
            file: the frame.
            perturbation: what to make of it first.
        """
        result = self._score_file(file, perturbation)
        handicap = handicap_of(self._method, perturbation)
        return replace(result, method=self._method.name, perturbation=handicap)

    def _score_file(self, file: Path, perturbation: Perturbation | None) -> FrameResult:
        try:
            frame = read_frame(file)
        except InputError as error:
            return FrameResult(frame_name(file), str(file), "unreadable", str(error))
        try:
            return self._score(file, frame, perturbation)
        except Exception as error:  # whatever a frame sets off, the others are still to come
            return FrameResult(
                frame.name,
                str(file),
                "error",
                f"{type(error).__name__}: {error}",
                frame.object_name,
                frame.truth.visible_share,
                lost_at="error",
            )

    def _score(self, file: Path, frame: Frame, perturbation: Perturbation | None) -> FrameResult:
        metric, bodies = self._models(frame.object_name)
        if perturbation is not None:
            frame = perturbation.apply(frame, bodies, self._seed)
        method = self._ready(frame, perturbation.object_scale if perturbation else 1.0)
        view = view_of(frame)
        started = time.perf_counter()
        estimate, stages = method.run(view)
        seconds = time.perf_counter() - started
        result = self._scorer.score(frame, estimate, stages, metric)
        return replace(result, file=str(file), seconds=seconds, peak_memory=peak_memory())

    def _models(self, name: str) -> tuple[ObjectMetric, Bodies]:
        """What the true object of a name is scored with, and rendered with in the hand."""
        if name not in self._objects:
            model = self._load_object(name)
            metric = ObjectMetric(model, self._device)
            self._objects[name] = metric, Bodies(self._hand, model.mesh, self._device)
        return self._objects[name]

    def _ready(self, frame: Frame, object_scale: float) -> PreparedMethod:
        """The method for the frame's object; when it is new, it runs once to warm up.

        Only methods for models of one scale are kept.
        """
        if object_scale != self._object_scale:
            self._prepared.clear()
            self._object_scale = object_scale
        if frame.object_name not in self._prepared:
            model = self._load_object(frame.object_name)
            model = model if object_scale == 1.0 else scaled(model, object_scale)
            method = self._method.prepare(self._hand, model, self._device)
            method.run(view_of(frame))
            self._prepared[frame.object_name] = method
        return self._prepared[frame.object_name]


def missing(
    files: Sequence[Path],
    method: Method,
    ledger: Ledger,
    perturbation: Perturbation | None = None,
) -> list[Path]:
    """The frames that have no result of the method in the ledger."""
    return [file for file in files if key_of(file, method, perturbation) not in ledger.results]


def key_of(file: Path, method: Method, perturbation: Perturbation | None = None) -> Key:
    """What the ledger knows the method's result on a frame by."""
    return result_key(frame_name(file), method.name, handicap_of(method, perturbation))


def handicap_of(method: Method, perturbation: Perturbation | None) -> dict[str, float]:
    """What a result is handicapped by: the method's own perturbation, and that of the frame."""
    return {**method.perturbation, **dict([perturbation] if perturbation else [])}


def pick_frames(files: Sequence[Path], *, every: int = 1, limit: int | None = None) -> list[Path]:
    """Every `every`-th frame, and at most `limit` of these, spread evenly over them.

    One is drawn from each of `limit` equal parts, always the same: equal steps would skip some
    kinds of frames in data sets where these take turns.

    Raises:
        InputError: a number is not positive.
    """
    if every < 1 or (limit is not None and limit < 1):
        raise InputError(f"every and limit must be at least 1, got {every} and {limit}")
    picked = list(files[::every])
    if limit is None or limit >= len(picked):
        return picked
    edges = np.arange(limit + 1) * len(picked) // limit
    return [picked[i] for i in np.random.default_rng(0).integers(edges[:-1], edges[1:])]


def peak_memory() -> int | None:
    """Largest memory [byte] this process has held so far; None where the system does not tell."""
    try:
        status = Path("/proc/self/status").read_text()
        return int(status.split("VmHWM:")[1].split()[0]) * 1024
    except (OSError, IndexError, ValueError):
        pass
    if os.name != "posix":
        return None
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
