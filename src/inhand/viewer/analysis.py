"""Everything there is to know about one frame: its estimate, what led to it, and how good it is."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from inhand.config import EstimatorConfig
from inhand.datasets.frame import LABEL_HAND, LABEL_OBJECT
from inhand.estimate import PoseEstimate
from inhand.estimator import PoseEstimator, StageResults
from inhand.evaluation.metrics import ObjectMetric
from inhand.evaluation.results import FrameResult
from inhand.evaluation.scoring import Scorer
from inhand.geometry.se3 import Array, transform
from inhand.hand import Hand
from inhand.object_model import ObjectModel
from inhand.overlay import ModelRenderer, Placement, Window
from inhand.stages.evidence import gather_evidence, score_with_contact
from inhand.viewer.clouds import reach_sphere
from inhand.viewer.frames import ViewedFrame
from inhand.viewer.silhouettes import Pictures
from inhand.viewer.stages import StageView, stage_views

REACH_MARGIN = 0.05
"""Shown around the hand's reach and half the object [m]."""
ALONE = 0.25
"""Radius [m] of what is shown around an object whose hand is unknown."""


class Tools(NamedTuple):
    """What frames of one object are analysed with."""

    estimator: PoseEstimator
    metric: ObjectMetric
    models: ModelRenderer


@dataclass(frozen=True, eq=False)
class Analysis:
    """A frame with its estimate."""

    frame: ViewedFrame
    tools: Tools
    estimate: PoseEstimate
    results: StageResults | None
    """What the stages returned; None for an estimate that came without."""
    verdict: FrameResult | None
    """The errors of the estimate; None without ground truth of hand and object."""
    stages: tuple[StageView, ...]
    """What there is to see after each stage."""
    truth: Placement | None
    """Where hand and object truly are; None if unknown."""

    @property
    def obj(self) -> ObjectModel:
        """The object."""
        return self.tools.metric.model

    @cached_property
    def sphere(self) -> tuple[Array, float]:
        """Centre [m], camera frame, and radius [m] of what is worth looking at."""
        hand = self.tools.estimator.hand.hand
        if self.frame.T_camera_hand is not None:
            margin = REACH_MARGIN + self.obj.diameter / 2
            return reach_sphere(hand, self.frame.T_camera_hand, margin)
        if self.truth is not None and self.truth.T_camera_object is not None:
            return transform(self.truth.T_camera_object, self.obj.centre[None])[0], ALONE
        return np.array([0, 0, 0.5]), np.inf

    @cached_property
    def pictures(self) -> Pictures:
        """The pictures of the frame, of the part of the image that shows hand and object."""
        frame = self.frame
        placement = Placement.of_estimate(self.estimate, self.tools.estimator.hand.hand)
        rendering = self.tools.models.render(frame.camera, placement)
        shown = rendering.is_hand | rendering.silhouette
        if frame.labelled is not None:
            shown |= np.isin(frame.labelled.truth.label, (LABEL_HAND, LABEL_OBJECT))
        window = Window.around(shown)
        return Pictures(self.tools.models, frame.depth, frame.camera, window, frame.colour)

    def adi(self, T_camera_object: Array | None) -> float | None:
        """ADI [m] of a pose of the object, shape (4, 4); None where there is nothing to compare."""
        truth = None if self.truth is None else self.truth.T_camera_object
        if truth is None or T_camera_object is None:
            return None
        return self.tools.metric.adi(T_camera_object, truth)

    def score(self, placement: Placement) -> float | None:
        """The selection's score of hand and object anywhere, before it places hidden fingers.

        None where the object has no place, or where the estimate did not get to a segment.
        """
        r, estimator = self.results, self.tools.estimator
        if r is None or r.observation is None or r.hand_state is None or r.segment is None:
            return None
        if placement.T_camera_object is None:
            return None
        state = r.hand_state
        if placement.T_camera_hand is not None and placement.joint_vector is not None:
            q, T = placement.joint_vector, placement.T_camera_hand
            links = estimator.hand.link_poses(q[None], T[None])[0]
            state = replace(state, joint_vector=q, T_camera_hand=T, T_camera_link=links)
        config = estimator.config
        evidence = gather_evidence(r.observation, state, r.segment, estimator.hand, config.evidence)
        T_camera_object = placement.T_camera_object[None]
        return float(
            score_with_contact(evidence, estimator.object, T_camera_object, config.selection)[0]
        )


class Analyst:
    """Analyses frames of one hand.

    Args:
        hand: the hand.
        config: of the estimator.
        device: Warp device name.
    """

    def __init__(self, hand: Hand, config: EstimatorConfig, device: str = "cpu") -> None:
        self.hand = hand
        self._config, self._device = config, device
        self._scorer = Scorer(hand, device)
        self._tools: dict[ObjectModel, Tools] = {}

    def analyse(self, frame: ViewedFrame, obj: ObjectModel) -> Analysis:
        """Run the estimator on a frame.

        Raises:
            InputError: the frame's depth image or wrist pose makes no sense.
        """
        if frame.T_camera_hand is None:
            reason = "the frame says nothing about a hand, so there is no wrist pose to start from"
            return self.of_estimate(frame, obj, no_estimate(reason))
        estimator = self._tools_for(obj).estimator
        estimate, results = estimator.run(frame.depth, frame.camera, frame.T_camera_hand)
        return self.of_estimate(frame, obj, estimate, results)

    def of_estimate(
        self,
        frame: ViewedFrame,
        obj: ObjectModel,
        estimate: PoseEstimate,
        results: StageResults | None = None,
    ) -> Analysis:
        """The analysis of an estimate that is there already.

        Args:
            frame: the frame.
            obj: the object in it.
            estimate: the estimate.
            results: what the stages returned, if that is known.
        """
        tools = self._tools_for(obj)
        verdict, labelled = None, frame.labelled
        if labelled is not None and labelled.truth.wrist is not None:
            verdict = self._scorer.score(labelled, estimate, results, tools.metric)
        stages = stage_views(frame, estimate, results, tools.estimator.hand, verdict)
        truth = frame.truth(self.hand)
        return Analysis(frame, tools, estimate, results, verdict, stages, truth)

    def _tools_for(self, obj: ObjectModel) -> Tools:
        if obj not in self._tools:
            self._tools[obj] = Tools(
                PoseEstimator(self.hand, obj, self._config, self._device),
                ObjectMetric(obj, self._device),
                ModelRenderer(self.hand, obj, self._device),
            )
        return self._tools[obj]


def no_estimate(reason: str) -> PoseEstimate:
    """An estimate without an answer."""
    return PoseEstimate(False, reason, None, {}, None, 0.0)
