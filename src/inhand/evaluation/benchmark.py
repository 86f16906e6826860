"""Running a method over frames with ground truth."""

import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inhand.baselines.method import Method, PreparedMethod, view_of
from inhand.datasets.frames import LABEL_HAND, Frame, frame_name, read_frame
from inhand.errors import InputError
from inhand.estimate import PoseEstimate
from inhand.estimator import StageResults
from inhand.evaluation.diagnosis import (
    best_adi_by_stage,
    segment_quality,
    stage_to_blame,
    stages_reached,
)
from inhand.evaluation.metrics import ObjectMetric, PoseError, angle_errors, wrist_error
from inhand.evaluation.perturbations import Bodies, scaled
from inhand.evaluation.results import FrameResult, Key, Ledger, result_key
from inhand.evaluation.sweeps import Perturbation
from inhand.hand import Hand
from inhand.kernels.depth import DepthRenderer
from inhand.object_model import ObjectModel

TOP_CANDIDATES = 3
"""How many of the ranked candidates are scored."""


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
        self._renderer = DepthRenderer([link.mesh for link in hand.links], device)
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
        true_joints = self._hand.joint_vector(frame.truth.joint_positions)
        view = view_of(frame)
        started = time.perf_counter()
        estimate, reached = method.run(view)
        seconds = time.perf_counter() - started

        stages = StageResults() if reached is None else reached
        segment = segment_quality(stages, frame)
        wrists = _wrist_errors(estimate, stages, frame)
        result = FrameResult(
            frame=frame.name,
            file=str(file),
            outcome="no answer",
            reason=estimate.reason,
            object_name=frame.object_name,
            visible_share=frame.truth.visible_share,
            T_camera_hand=_listed(estimate.T_camera_hand),
            joint_positions={name: float(q) for name, q in estimate.joint_positions.items()},
            best_adi=best_adi_by_stage(stages, metric, frame),
            segment=list(segment) if segment else None,
            wrist_errors={stage: list(error) for stage, error in wrists.items()},
            joint_errors=self._joint_errors(estimate.joint_positions, frame),
            joint_pixels=self._joint_pixels(true_joints, frame),
            timings={stage: float(s) for stage, s in estimate.timings.items()},
            seconds=seconds,
            peak_memory=peak_memory(),
        )
        if estimate.T_camera_object is not None:
            result = _with_answer(result, estimate, metric, frame)
        if reached is None:
            return result
        lost_at = stage_to_blame(
            result.adi,
            result.best_adi,
            stages_reached(stages),
            segment,
            wrists.get("hand_state", wrists.get("wrist")),
            result.visible_joint_errors,
        )
        return replace(result, lost_at=lost_at)

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

    def _joint_errors(self, angles: Mapping[str, float], frame: Frame) -> dict[str, float]:
        chain = self._hand.chain
        revolute = {
            self._hand.joint_names[source]
            for source, kind in zip(chain.source, chain.kind, strict=True)
            if kind == 0
        }
        errors = angle_errors(angles, frame.truth.joint_positions)
        return {name: error for name, error in errors.items() if name in revolute}

    def _joint_pixels(self, true_joints: NDArray[np.float64], frame: Frame) -> dict[str, int]:
        """Visible pixels of the links that hang on each independent joint directly."""
        T_hand_link = self._hand.forward_kinematics(true_joints)
        link = self._renderer.render(frame.camera, frame.truth.T_camera_hand @ T_hand_link)[1]
        shown = link[(frame.truth.label == LABEL_HAND) & (link >= 0)]
        pixels = np.bincount(shown, minlength=len(self._hand.links))
        chain = self._hand.chain
        joint = np.asarray(chain.link_joint)
        source = np.where(joint >= 0, np.asarray(chain.source)[joint], -1)
        return {n: int(pixels[source == j].sum()) for j, n in enumerate(self._hand.joint_names)}


def _with_answer(
    result: FrameResult, estimate: PoseEstimate, metric: ObjectMetric, frame: Frame
) -> FrameResult:
    """The result with what the estimator answered and how far that is from the truth."""
    T = estimate.T_camera_object
    assert T is not None
    truth = frame.truth.T_camera_object
    best = estimate.candidates[:TOP_CANDIDATES]
    return replace(
        result,
        outcome="answer",
        T_camera_object=_listed(T),
        confidence=float(estimate.confidence),
        candidates_adi=[metric.adi(c.T_camera_object, truth) for c in best],
        **asdict(metric.scores(T, truth, frame.depth, frame.camera)),
    )


def _wrist_errors(
    estimate: PoseEstimate, stages: StageResults, frame: Frame
) -> dict[str, PoseError]:
    poses = {
        "given": frame.T_camera_hand_given,
        "wrist": stages.wrist.T_camera_hand if stages.wrist else None,
        "hand_state": stages.hand_state.T_camera_hand if stages.hand_state else None,
        "answer": estimate.T_camera_hand,
    }
    truth = frame.truth.T_camera_hand
    return {stage: wrist_error(T, truth) for stage, T in poses.items() if T is not None}


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


def _listed(T: NDArray[np.float64] | None) -> list[list[float]] | None:
    return None if T is None else np.asarray(T, dtype=np.float64).tolist()
