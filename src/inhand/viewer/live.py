"""A page that shows estimates as they come."""

from collections.abc import Callable
from types import TracebackType

from inhand.config import EstimatorConfig
from inhand.estimate import PoseEstimate
from inhand.estimator import StageResults
from inhand.hand import Hand
from inhand.object_model import ObjectModel
from inhand.viewer.analysis import Analyst
from inhand.viewer.controls import on_user
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
        config: the estimator's parameters, by which poses that are tried by hand are scored.
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
        config: EstimatorConfig | None = None,
        device: str = "cpu",
    ) -> None:
        self._obj = obj
        self._analyst = Analyst(hand, EstimatorConfig() if config is None else config, device)
        self._server = start_server("inhand", host=host, port=port)
        gui = self._server.gui
        self._note = gui.add_markdown("", order=-4)
        self._hold = gui.add_checkbox(
            "Hold this image", False, order=-3, hint="look at it while others come and go"
        )
        self._newest: Callable[[], None] | None = None
        on_user(self._hold, self._draw_newest)
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
        self,
        frame: ViewedFrame | Callable[[], ViewedFrame],
        estimate: PoseEstimate,
        results: StageResults | None = None,
    ) -> None:
        """Show an estimate; returns at once, and drops the one before if that was not drawn yet.

        While the user holds an image, that one stays; the newest follows when it is let go.

        Args:
            frame: the frame, or what makes it, which is called only when it is drawn.
            estimate: its estimate.
            results: what the stages returned (`PoseEstimator.run`), to look at them as well.
        """
        self._newest = lambda: self._draw(frame, estimate, results)
        self._draw_newest()

    def say(self, text: str) -> None:
        """Say something at the top of the page, in Markdown."""
        self._note.content = text

    def close(self) -> None:
        """Stop the page's server."""
        self._page.stop()
        stop_server(self._server)

    def _draw_newest(self) -> None:
        if self._newest is not None and not self._hold.value:
            self._page.worker.submit("frame", self._newest)

    def _draw(
        self,
        frame: ViewedFrame | Callable[[], ViewedFrame],
        estimate: PoseEstimate,
        results: StageResults | None,
    ) -> None:
        drawn = frame() if callable(frame) else frame
        self._page.show(self._analyst.of_estimate(drawn, self._obj, estimate, results))
