"""The results of a stream on a page, as they come, and how the stream ended."""

from dataclasses import replace
from functools import partial

from inhand.config import EstimatorConfig
from inhand.errors import InputError
from inhand.estimate import PoseEstimate
from inhand.estimator import PoseEstimator, StageResults
from inhand.hand import Hand
from inhand.object_model import ObjectModel
from inhand.streams.runner import Counts, Result, Summary
from inhand.streams.source import Frame
from inhand.viewer.frames import ViewedFrame
from inhand.viewer.live import LiveView


class StagesKept:
    """An estimator whose last image can be followed through the stages; a `runner.Estimate`.

    Args:
        estimator: estimates the images.
    """

    def __init__(self, estimator: PoseEstimator) -> None:
        self._estimator = estimator
        self._last: tuple[PoseEstimate, StageResults] | None = None

    def __call__(self, frame: Frame) -> PoseEstimate:
        """The estimate of an image."""
        self._last = self._estimator.run(frame.depth, frame.camera, frame.T_camera_hand)
        return self._last[0]

    def stages_of(self, estimate: PoseEstimate) -> StageResults | None:
        """What the stages returned, if it is the last estimate."""
        return self._last[1] if self._last is not None and self._last[0] is estimate else None


class PageOutput:
    """Shows the latest result of a stream; an output of `streams.runner.run`.

    The page stays when the run has ended, until it is closed.

    Args:
        hand: the hand.
        obj: the object.
        host: address that the page's server listens on.
        port: its port, 0 for any that is free.
        config: the estimator's parameters.
        device: Warp device of the drawing.
        kept: the estimator, if its stages are to be seen.

    Raises:
        InputError: as `LiveView`.
    """

    def __init__(
        self,
        hand: Hand,
        obj: ObjectModel,
        host: str,
        port: int,
        config: EstimatorConfig,
        device: str,
        kept: StagesKept | None = None,
    ) -> None:
        self._view = LiveView(hand, obj, host=host, port=port, config=config, device=device)
        self._hand, self._obj, self._kept, self._ending = hand, obj, kept, ""
        self._counts = Counts()
        self.address = self._view.address

    def write(self, result: Result) -> None:
        """Show a result, and what became of the images so far; no depth image, no picture."""
        self._counts = self._counts.after(result)
        self._view.say(f"**Running**: {self._counts.in_words()}")
        if result.frame.depth is not None:
            stages = None if self._kept is None else self._kept.stages_of(result.estimate)
            self._view.show(partial(self._viewed, result.frame), result.estimate, stages)

    def _viewed(self, frame: Frame) -> ViewedFrame:
        """An image with its ground truth, where that is known; read only if it is shown."""
        assert frame.depth is not None
        viewed = ViewedFrame(frame.name, frame.depth, frame.camera, frame.T_camera_hand)
        if frame.read_truth is None:
            return viewed
        try:
            labelled = frame.read_truth(self._obj)
            labelled_too = replace(viewed, colour=labelled.rgb, labelled=labelled)
            labelled_too.truth(self._hand)  # which may be another one, with other joints
        except InputError as error:
            return replace(viewed, remark=f"The ground truth cannot be shown: {error}")
        return labelled_too

    def finish(self, summary: Summary) -> None:
        """Say that the run has ended, and what became of the images."""
        self._ending = f"**The run has ended**: {summary.counts.in_words()}"
        if summary.first_problem:
            self._ending += f"  \nThe first that could not be estimated: {summary.first_problem}"
        self._view.say(self._ending)

    @property
    def ended(self) -> bool:
        """Whether the run was finished."""
        return bool(self._ending)

    def tell(self, problem: str) -> None:
        """Say why the run ended before its source did."""
        self._view.say(f"{self._ending}  \n⚠ {problem}")

    def close(self) -> None:
        """Close the page."""
        self._view.close()
