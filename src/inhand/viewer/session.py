"""The frames that are looked at, with what is known of their estimates so far."""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from inhand.errors import InputError
from inhand.estimate import PoseEstimate
from inhand.evaluation.results import FrameResult
from inhand.viewer.analysis import Analysis, Analyst
from inhand.viewer.filters import Filter, Outcome
from inhand.viewer.frames import FrameSource

OWN_METHODS = {"inhand": "default", "paper": "paper"}
"""Methods of a benchmark that are the estimator's own: preset by name."""
KEPT = 8
"""Analyses that are kept."""


class Session:
    """Frames, analysed when they are looked at.

    Args:
        source: the frames.
        analyst: analyses them.
        results: what is known already, by frame: a benchmark's results, or estimates of any kind.
    """

    def __init__(
        self,
        source: FrameSource,
        analyst: Analyst,
        results: Mapping[str, FrameResult | PoseEstimate] | None = None,
    ) -> None:
        self.source, self._analyst = source, analyst
        self._results = results or {}
        self.outcomes: list[Outcome | None] = [
            Outcome.of_result(known) if isinstance(known, FrameResult) else None
            for known in map(self._results.get, source.names)
        ]
        self.analysis = lru_cache(KEPT)(self._analysis)

    def __len__(self) -> int:
        return len(self.source.names)

    def matching(self, wanted: Filter) -> list[int]:
        """Indices of the frames that a filter keeps."""
        names = self.source.object_names
        return [i for i, name in enumerate(names) if wanted.keeps(name, self.outcomes[i])]

    def first_unknown(self) -> int | None:
        """Index of the first frame whose outcome is unknown; None if there is none left."""
        return next((i for i, outcome in enumerate(self.outcomes) if outcome is None), None)

    def _analysis(self, index: int) -> Analysis:
        """The analysis of a frame; its outcome is known from then on.

        Raises:
            InputError: the frame cannot be read, or makes no sense.
        """
        try:
            frame, obj = self.source.read(index)
            known = self._results.get(frame.name)
            if known is None or (isinstance(known, FrameResult) and known.method in OWN_METHODS):
                analysis = self._analyst.analyse(frame, obj)
            else:
                estimate = known if isinstance(known, PoseEstimate) else estimate_of(known)
                analysis = self._analyst.of_estimate(frame, obj, estimate)
        except InputError:
            self.outcomes[index] = Outcome(found=False, confidence=0.0)
            raise
        T = analysis.estimate.T_camera_object
        self.outcomes[index] = Outcome.of(analysis.estimate, analysis.adi(T))
        return analysis


def estimate_of(result: FrameResult) -> PoseEstimate:
    """The estimate that a benchmark wrote down."""
    T_object, T_hand = (
        None if T is None else np.array(T) for T in (result.T_camera_object, result.T_camera_hand)
    )
    return PoseEstimate(
        found=T_object is not None,
        reason=result.reason,
        T_camera_object=T_object,
        joint_positions=result.joint_positions,
        T_camera_hand=T_hand,
        confidence=result.confidence,
        timings=result.timings,
    )
