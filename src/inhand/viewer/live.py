"""A page that shows estimates as they come."""

from types import TracebackType

from inhand.config import EstimatorConfig
from inhand.estimate import PoseEstimate
from inhand.estimator import StageResults
from inhand.hand import Hand
from inhand.object_model import ObjectModel
from inhand.viewer.analysis import Analyst
from inhand.viewer.frames import ViewedFrame
from inhand.viewer.page import Page
from inhand.viewer.server import HOST, PORT, address, start_server, stop_server


class LiveView:
    """Shows the latest of a stream of frames.

    Args:
        hand: the hand.
        obj: the object.
        host: address that the page's server listens on.
        port: its port, 0 for any that is free.
        device: Warp device of the drawing.

    Raises:
        InputError: the port is taken, or the viewer's libraries are not installed.
    """

    def __init__(
        self,
        hand: Hand,
        obj: ObjectModel,
        *,
        host: str = HOST,
        port: int = PORT,
        device: str = "cpu",
    ) -> None:
        self._obj = obj
        self._analyst = Analyst(hand, EstimatorConfig(), device)
        self._server = start_server("inhand", host=host, port=port)
        self._page = Page(self._server, hand)

    def __enter__(self) -> "LiveView":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def address(self) -> str:
        """What to type into a browser."""
        return address(self._server)

    def show(
        self, frame: ViewedFrame, estimate: PoseEstimate, results: StageResults | None = None
    ) -> None:
        """Show an estimate; returns at once, and drops the one before if that was not drawn yet.

        Args:
            frame: the frame.
            estimate: its estimate.
            results: what the stages returned (`PoseEstimator.run`), to look at them as well.
        """
        self._page.worker.submit("frame", lambda: self._draw(frame, estimate, results))

    def close(self) -> None:
        """Stop the page's server."""
        self._page.stop()
        stop_server(self._server)

    def _draw(
        self, frame: ViewedFrame, estimate: PoseEstimate, results: StageResults | None
    ) -> None:
        self._page.show(self._analyst.of_estimate(frame, self._obj, estimate, results))
