"""The tracker as what estimates the images of a stream, whose clock need not be a good one."""

from inhand.errors import InputError
from inhand.estimate import PoseEstimate
from inhand.streams.pose_track import NS
from inhand.streams.source import Frame
from inhand.tracking.tracker import PoseTracker

SET_BACK = NS
"""An image that is older than the newest by more than this [ns] comes of a clock that was set back,
or of a recording that begins again; one by less is late."""


class Following:
    """Follows hand and object through the images of a stream; a `runner.Estimate`.

    Args:
        tracker: follows them.
    """

    def __init__(self, tracker: PoseTracker) -> None:
        self._tracker = tracker
        self._newest: int | None = None
        """Time of the newest image [ns]."""

    def __call__(self, frame: Frame) -> PoseEstimate:
        """The estimate of the next image.

        Raises:
            InputError: the image is bad input, or not newer than the one before it.
        """
        newest, time_ns = self._newest, frame.time_ns
        if newest is not None and time_ns < newest - SET_BACK:
            self._tracker.reset()
        elif newest is not None and time_ns <= newest:
            late = (newest - time_ns) / NS
            raise InputError(
                f"the image was taken {late:.3f} s before the one before it, and cannot be followed"
            )
        self._newest = time_ns
        return self._tracker.update(
            frame.depth, frame.camera, frame.T_camera_hand, time=time_ns / NS
        )
