"""How good one estimate is, against the frame's ground truth."""

from collections.abc import Mapping
from dataclasses import asdict, replace

import numpy as np
from numpy.typing import NDArray

from inhand.datasets.frame import LABEL_HAND, Frame
from inhand.estimate import PoseEstimate
from inhand.estimator import StageResults
from inhand.evaluation.diagnosis import (
    best_adi_by_stage,
    segment_quality,
    stage_to_blame,
    stages_reached,
)
from inhand.evaluation.hand_errors import angle_errors, wrist_error
from inhand.evaluation.metrics import ObjectMetric, PoseError
from inhand.evaluation.results import FrameResult
from inhand.hand import Hand
from inhand.kernels.depth import DepthRenderer

TOP_CANDIDATES = 3
"""How many of the ranked candidates are scored."""


class Scorer:
    """Scores estimates of frames of one hand.

    Args:
        hand: the hand.
        device: Warp device of the rendering.
    """

    def __init__(self, hand: Hand, device: str = "cpu") -> None:
        self._hand = hand
        self._renderer = DepthRenderer([link.mesh for link in hand.links], device)

    def score(
        self,
        frame: Frame,
        estimate: PoseEstimate,
        reached: StageResults | None,
        metric: ObjectMetric,
    ) -> FrameResult:
        """The errors of an estimate, and the stage that loses the frame.

        Args:
            frame: the frame; one with a hand.
            estimate: the estimate.
            reached: what the pipeline's stages returned; None for a method without them.
            metric: errors of the frame's object.
        """
        stages = StageResults() if reached is None else reached
        segment = segment_quality(stages, frame)
        wrists = _wrist_errors(estimate, stages, frame)
        result = FrameResult(
            frame=frame.name,
            file="",
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
            joint_pixels=self._joint_pixels(frame),
            timings={stage: float(s) for stage, s in estimate.timings.items()},
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

    def _joint_errors(self, angles: Mapping[str, float], frame: Frame) -> dict[str, float]:
        chain = self._hand.chain
        revolute = {
            self._hand.joint_names[source]
            for source, kind in zip(chain.source, chain.kind, strict=True)
            if kind == 0
        }
        errors = angle_errors(angles, frame.truth.joint_positions)
        return {name: error for name, error in errors.items() if name in revolute}

    def _joint_pixels(self, frame: Frame) -> dict[str, int]:
        """Visible pixels of the links that hang on each independent joint directly."""
        true_joints = self._hand.joint_vector(frame.truth.joint_positions)
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


def _listed(T: NDArray[np.float64] | None) -> list[list[float]] | None:
    return None if T is None else np.asarray(T, dtype=np.float64).tolist()
