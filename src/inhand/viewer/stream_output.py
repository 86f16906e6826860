"""The results of a stream on a page, as they come."""

from inhand.hand import Hand
from inhand.object_model import ObjectModel
from inhand.streams.runner import Result, Summary
from inhand.viewer.frames import ViewedFrame
from inhand.viewer.live import LiveView


class PageOutput:
    """Shows the latest result of a stream; an output of `streams.runner.run`.

    Args:
        hand: the hand.
        obj: the object.
        port: port of the page, 0 for any that is free.
        device: Warp device of the drawing.

    Raises:
        InputError: as `LiveView`.
    """

    def __init__(self, hand: Hand, obj: ObjectModel, port: int, device: str) -> None:
        self._view = LiveView(hand, obj, port=port, device=device)
        self.address = self._view.address

    def write(self, result: Result) -> None:
        """Show a result; what has no depth image is left out."""
        frame = result.frame
        if frame.depth is not None:
            shown = ViewedFrame(frame.name, frame.depth, frame.camera, frame.T_camera_hand)
            self._view.show(shown, result.estimate)

    def finish(self, summary: Summary) -> None:
        """Close the page."""
        self._view.close()
