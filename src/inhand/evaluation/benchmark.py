"""Running an estimator over frames with ground truth."""

import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inhand.datasets.frames import LABEL_HAND, Frame, frame_name, read_frame
from inhand.errors import InputError
from inhand.estimate import PoseEstimate
from inhand.estimator import PoseEstimator, StageResults
from inhand.evaluation.diagnosis import (
    best_adi_by_stage,
    segment_quality,
    stage_to_blame,
    stages_reached,
)
from inhand.evaluation.metrics import ObjectMetric, PoseError, angle_errors, wrist_error
from inhand.evaluation.results import FrameResult, Ledger
from inhand.hand import Hand
from inhand.kernels.depth import DepthRenderer
from inhand.object_model import ObjectModel

TOP_CANDIDATES = 3
"""How many of the ranked candidates are scored."""


class Benchmark:
    """Scores an estimator frame by frame.

    Args:
        hand: the hand in the frames.
        load_object: gives the model of the object of a name.
        make_estimator: gives the estimator of an object.
        device: Warp device of the scoring.
    """

    def __init__(
        self,
        hand: Hand,
        load_object: Callable[[str], ObjectModel],
        make_estimator: Callable[[ObjectModel], PoseEstimator],
        device: str = "cpu",
    ) -> None:
        self._hand = hand
        self._load_object = load_object
        self._make_estimator = make_estimator
        self._device = device
        self._renderer = DepthRenderer([link.mesh for link in hand.links], device)
        self._objects: dict[str, tuple[ObjectMetric, PoseEstimator]] = {}

    def run(self, files: Sequence[Path], ledger: Ledger) -> Iterator[FrameResult]:
        """Results of the frames that `ledger` lacks, each written to it before it is handed on.

        A frame that cannot be read or that the estimator fails on is a result too.
        """
        return ledger.record(map(self.score, missing(files, ledger)))

    def score(self, file: Path) -> FrameResult:
        """Run the estimator on one frame and score it; never raises for what a frame does."""
        try:
            frame = read_frame(file)
        except InputError as error:
            return FrameResult(frame_name(file), str(file), "unreadable", str(error))
        try:
            return self._score(file, frame)
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

    def _score(self, file: Path, frame: Frame) -> FrameResult:
        metric, estimator = self._models(frame)
        true_joints = self._hand.joint_vector(frame.truth.joint_positions)
        started = time.perf_counter()
        estimate, stages = estimator.run(frame.depth, frame.camera, frame.T_camera_hand_given)
        seconds = time.perf_counter() - started

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
        lost_at = stage_to_blame(
            result.adi,
            result.best_adi,
            stages_reached(stages),
            segment,
            wrists.get("hand_state", wrists.get("wrist")),
            result.visible_joint_errors,
        )
        return replace(result, lost_at=lost_at)

    def _models(self, frame: Frame) -> tuple[ObjectMetric, PoseEstimator]:
        """Metric and estimator of the frame's object; a new estimator runs once to warm up."""
        if frame.object_name not in self._objects:
            model = self._load_object(frame.object_name)
            estimator = self._make_estimator(model)
            estimator.run(frame.depth, frame.camera, frame.T_camera_hand_given)
            self._objects[frame.object_name] = ObjectMetric(model, self._device), estimator
        return self._objects[frame.object_name]

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


def missing(files: Sequence[Path], ledger: Ledger) -> list[Path]:
    """The frames that have no result in the ledger."""
    return [file for file in files if frame_name(file) not in ledger.results]


def pick_frames(files: Sequence[Path], *, every: int = 1, limit: int | None = None) -> list[Path]:
    """Every `every`-th frame, and at most `limit` of these, spread evenly over them.

    Raises:
        InputError: a number is not positive.
    """
    if every < 1 or (limit is not None and limit < 1):
        raise InputError(f"every and limit must be at least 1, got {every} and {limit}")
    picked = list(files[::every])
    if limit is None or limit >= len(picked):
        return picked
    return [picked[i * len(picked) // limit] for i in range(limit)]


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
