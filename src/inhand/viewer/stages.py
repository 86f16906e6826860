"""What every stage of the pipeline did, as things to draw and words to read."""

from dataclasses import dataclass, replace
from math import degrees

import numpy as np
from numpy.typing import NDArray

from inhand.estimate import PoseEstimate
from inhand.estimator import StageResults
from inhand.evaluation.hand_errors import angle_errors, wrist_error
from inhand.evaluation.results import FrameResult
from inhand.geometry.se3 import Array
from inhand.kinematics import REVOLUTE
from inhand.overlay import Placement
from inhand.packed import PackedHand
from inhand.stages.results import HandState
from inhand.viewer import clouds
from inhand.viewer.clouds import Cloud
from inhand.viewer.frames import ViewedFrame

REGION, WRIST, HAND = "region of interest", "wrist", "hand fit"
SEGMENT, CHOICE = "hand removed", "choice"
POSE_STAGES = {
    "hypotheses": ("hypotheses", "Poses that point pairs of the segment propose, best first."),
    "clusters": ("clustered", "The best pose of every group that looks the same."),
    "survivors": ("pruned", "Poses after refinement that are not physically impossible."),
}
"""Stages that hand on object poses: field of the estimator's stage results, and what they are."""
STAGES = (REGION, WRIST, HAND, SEGMENT, *POSE_STAGES, CHOICE)
"""All stages, in order."""
_BEST = {"hypotheses": "hypotheses", "clusters": "clustering", "survivors": "pruning"}
"""Their names in the diagnosis of a benchmark."""


@dataclass(frozen=True, eq=False)
class StageView:
    """What there is to see after a stage."""

    name: str
    """One of `STAGES`."""
    text: str
    """What the stage does, or why it was not reached, and what came of it; Markdown."""
    reached: bool
    """Whether it was reached."""
    cloud: Cloud | None
    """The points it made or looked at; None: the whole image's."""
    hand: Placement
    """Where the hand is after it; nothing of the object."""
    links: NDArray[np.bool_]
    """Which links are placed, shape (L,)."""
    poses: Array
    """Object poses, best first, shape (m, 4, 4)."""
    scores: NDArray[np.float64]
    """Their scores within the stage, shape (m,)."""

    def placement(self, rank: int) -> Placement:
        """Hand and object, with the pose of this rank (from 0) if there are poses."""
        if not len(self.poses):
            return self.hand
        return replace(self.hand, T_camera_object=self.poses[min(rank, len(self.poses) - 1)])


def stage_views(
    frame: ViewedFrame,
    estimate: PoseEstimate,
    results: StageResults | None,
    hand: PackedHand,
    verdict: FrameResult | None,
) -> tuple[StageView, ...]:
    """One view for each of `STAGES`; of an estimate alone, only the last.

    Args:
        frame: the frame.
        estimate: its estimate.
        results: what the stages returned, if that is known.
        hand: the hand.
        verdict: the errors of the estimate, if the truth is known.
    """
    views = _Views(frame, estimate, results or StageResults(), hand, verdict)
    if results is None:
        return (views.choice(),)
    poses = [views.poses(name) for name in POSE_STAGES]
    return (
        views.region(),
        views.wrist(),
        views.hand_fit(),
        views.segment(),
        *poses,
        views.choice(),
    )


@dataclass(frozen=True, eq=False)
class _Views:
    """Makes the views."""

    frame: ViewedFrame
    estimate: PoseEstimate
    results: StageResults
    hand: PackedHand
    verdict: FrameResult | None

    def region(self) -> StageView:
        observation = self.results.observation
        what = "The part of the image that the hand, and an object in it, can reach."
        if observation is None:
            return self._missing(REGION)
        facts = [
            f"{len(observation.points)} points, one in {observation.step} pixels along a side",
            f"noise of the readings: {1000 * observation.noise:.1f} mm",
        ]
        return self._view(REGION, what, facts, clouds.plain(observation))

    def wrist(self) -> StageView:
        observation, wrist = self.results.observation, self.results.wrist
        if observation is None or wrist is None:
            return self._missing(WRIST)
        moved = wrist_error(wrist.T_camera_hand, observation.T_camera_hand)
        facts = [
            f"moved by {1000 * moved.translation:.1f} mm, {degrees(moved.rotation):.1f}° from the "
            "given pose"
        ]
        facts += self._wrist_errors("given", "wrist")
        placement = Placement(wrist.T_camera_hand, self.hand.hand.rest)
        what = "The palm, fitted to the cloud."
        view = self._view(WRIST, what, facts, clouds.plain(observation), placement)
        return replace(view, links=self.hand.is_palm)

    def hand_fit(self) -> StageView:
        observation, state = self.results.observation, self.results.hand_state
        if observation is None or state is None:
            return self._missing(HAND)
        names = [link.name for link in self.hand.hand.links]
        unseen = [n for n, certain in zip(names, state.certain, strict=True) if not certain]
        facts = self._joints(self.hand.hand.joint_dict(state.joint_vector))
        facts += self._wrist_errors("hand_state")
        if unseen:
            facts.append(f"not supported by the image: {', '.join(unseen)}")
        what = "Wrist and fingers, fitted together. Blue points are the hand's."
        cloud = clouds.by_hand(observation, state, self.hand)
        return self._view(HAND, what, facts, cloud, _hand_at(state))

    def segment(self) -> StageView:
        observation, segment = self.results.observation, self.results.segment
        if observation is None or segment is None:
            return self._missing(SEGMENT)
        facts = [f"{len(segment.points)} points, {segment.weight.sum():.0f} by weight"]
        if self.verdict and self.verdict.segment:
            precision, recall = self.verdict.segment
            facts.append(f"truly the object: {precision:.0%}; of the object kept: {recall:.0%}")
        what = "What is left without hand and background: the brighter, the surer the object's."
        cloud = clouds.by_weight(observation, segment)
        return self._view(SEGMENT, what, facts, cloud, _hand_at(self.results.hand_state))

    def poses(self, name: str) -> StageView:
        field, what = POSE_STAGES[name]
        poses = getattr(self.results, field)
        if poses is None or self.results.observation is None or self.results.segment is None:
            return self._missing(name)
        order = np.argsort(-poses.score, kind="stable")
        facts = [f"{len(poses)} poses"]
        best = self.verdict.best_adi.get(_BEST[name]) if self.verdict else None
        if best is not None:
            facts.append(f"the nearest to the truth is off by {1000 * best:.1f} mm (ADI)")
        cloud = clouds.by_weight(self.results.observation, self.results.segment)
        view = self._view(name, what, facts, cloud, _hand_at(self.results.hand_state))
        return replace(
            view,
            poses=poses.T_camera_object[order].astype(np.float64),
            scores=poses.score[order].astype(np.float64),
        )

    def choice(self) -> StageView:
        candidates = self.estimate.candidates
        if not self.estimate.found or self.estimate.T_camera_object is None:
            return self._missing(CHOICE)
        facts = [f"confidence {self.estimate.confidence:.2f}"]
        if self.verdict and self.verdict.adi is not None:
            facts.append(f"off by {1000 * self.verdict.adi:.1f} mm (ADI)")
        facts += self._joints(self.estimate.joint_positions)
        what = "The poses that are left, ranked; the first is the answer."
        poses = [c.T_camera_object for c in candidates] or [self.estimate.T_camera_object]
        scores = [next(iter(c.scores.values()), np.nan) for c in candidates] or [np.nan]
        placement = Placement.of_estimate(self.estimate, self.hand.hand)
        view = self._view(CHOICE, what, facts, None, replace(placement, T_camera_object=None))
        return replace(view, poses=np.array(poses), scores=np.array(scores))

    def _view(
        self,
        name: str,
        what: str,
        facts: list[str],
        cloud: Cloud | None,
        hand: Placement = Placement(),  # noqa: B008  (it is frozen)
    ) -> StageView:
        """A view of a stage that was reached, without poses."""
        return StageView(
            name=name,
            text="\n".join([what, "", *(f"- {fact}" for fact in facts)]),
            reached=True,
            cloud=cloud,
            hand=hand,
            links=np.ones(len(self.hand.hand.links), dtype=bool),
            poses=np.zeros((0, 4, 4)),
            scores=np.zeros(0),
        )

    def _missing(self, name: str) -> StageView:
        """The view of a stage that the estimate did not get to, with the hand if that was found."""
        why = self.estimate.reason or "there is no estimate"
        cloud = None if self.results.observation is None else clouds.plain(self.results.observation)
        found = replace(Placement.of_estimate(self.estimate, self.hand.hand), T_camera_object=None)
        view = self._view(name, "", [], cloud, found)
        return replace(view, text=f"**Not reached**: {why}.", reached=False)

    def _joints(self, positions: dict[str, float]) -> list[str]:
        """The joints' positions, as far as they are known, with their errors."""
        labelled, hand = self.frame.labelled, self.hand.hand
        truth = {} if labelled is None else labelled.truth.joint_positions
        errors = angle_errors(positions, truth)
        lines = []
        for name, kind in zip(hand.all_joint_names, hand.chain.kind, strict=True):
            if name not in positions:
                continue
            if kind != REVOLUTE:
                lines.append(f"{name}: {1000 * positions[name]:.1f} mm")
                continue
            error = f" (off by {degrees(errors[name]):.1f}°)" if name in errors else ""
            lines.append(f"{name}: {degrees(positions[name]):.1f}°{error}")
        return lines

    def _wrist_errors(self, *stages: str) -> list[str]:
        """How far off the wrist is after some stages, where the truth is known."""
        known = self.verdict.wrist_errors if self.verdict else {}
        names = {"given": "given pose", "wrist": "now", "hand_state": "wrist"}
        off = {stage: known[stage] for stage in stages if stage in known}
        return [
            f"{names[stage]} off by {1000 * translation:.1f} mm, {degrees(rotation):.1f}°"
            for stage, (translation, rotation) in off.items()
        ]


def _hand_at(state: HandState | None) -> Placement:
    return Placement() if state is None else Placement(state.T_camera_hand, state.joint_vector)
