"""Which frames of many are shown."""

from dataclasses import dataclass
from typing import Literal, get_args

from inhand.estimate import PoseEstimate
from inhand.evaluation.diagnosis import SOLVED
from inhand.evaluation.results import FrameResult

Kind = Literal["all", "failed", "not found", "low confidence"]
KINDS: tuple[Kind, ...] = get_args(Kind)


@dataclass(frozen=True)
class Outcome:
    """How the estimate of a frame came out."""

    found: bool
    """Whether there is an answer."""
    confidence: float
    """The estimator's confidence, 0 to 1."""
    adi: float | None = None
    """ADI of the answer [m]; None without an answer or without ground truth."""

    @classmethod
    def of(cls, estimate: PoseEstimate, adi: float | None) -> "Outcome":
        """The outcome of an estimate with this ADI [m]."""
        return cls(estimate.found, estimate.confidence, adi)

    @classmethod
    def of_result(cls, result: FrameResult) -> "Outcome":
        """The outcome that a benchmark wrote down."""
        return cls(result.outcome == "answer", result.confidence, result.adi)

    @property
    def failed(self) -> bool:
        """Whether there is no answer, or one that is known to be wrong."""
        return not self.found or (self.adi is not None and self.adi >= SOLVED)


@dataclass(frozen=True)
class Filter:
    """Which frames to show."""

    kind: Kind = "all"
    """`failed`: no answer, or one whose ADI is 5 mm or more; `not found`: no answer;
    `low confidence`: a confidence below the limit."""
    object_name: str | None = None
    """Only frames of this object; None for all objects."""
    confidence: float = 0.5
    """Limit of `low confidence`."""

    def keeps(self, object_name: str, outcome: Outcome | None) -> bool:
        """Whether a frame is shown.

        Args:
            object_name: of the object in it.
            outcome: of its estimate, None while there is none: then only `all` keeps it.
        """
        if self.object_name not in (None, object_name):
            return False
        if self.kind == "all":
            return True
        if outcome is None:
            return False
        if self.kind == "failed":
            return outcome.failed
        if self.kind == "not found":
            return not outcome.found
        return outcome.confidence < self.confidence
