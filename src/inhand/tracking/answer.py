"""What the tracker answers: its track as a `PoseEstimate`."""

import numpy as np

from inhand.estimate import Candidate, PoseEstimate
from inhand.hand import Hand
from inhand.object_model import ObjectModel
from inhand.tracking.accuracy import sensor_covariance, surface_within
from inhand.tracking.config import TrackerConfig
from inhand.tracking.gaussian import Array, about_origin, carried
from inhand.tracking.rivals import share_of_answer
from inhand.tracking.track import Track


class Answers:
    """Makes answers of tracks.

    Args:
        hand, obj: what is tracked.
        config: parameters.
    """

    def __init__(self, hand: Hand, obj: ObjectModel, config: TrackerConfig) -> None:
        self._hand, self._object, self._config = hand, obj, config

    def followed(self, track: Track, score: float, timings: dict[str, float]) -> PoseEstimate:
        """The answer where the object was followed, with this score."""
        return PoseEstimate(
            found=True,
            reason="",
            T_camera_object=track.answer,
            joint_positions=self._hand.joint_dict(track.joint_vector),
            T_camera_hand=track.T_camera_hand,
            confidence=track.confidence
            * share_of_answer(track.rivals, self._config.rivals)
            * self._accuracy(track),
            candidates=(Candidate(track.answer, {"score": score}),),
            timings=timings,
            covariance=self.covariance(track),
        )

    def none(self, track: Track | None, reason: str, timings: dict[str, float]) -> PoseEstimate:
        """The answer where the object was not found, for this reason."""
        return PoseEstimate(
            found=False,
            reason=reason,
            T_camera_object=None,
            joint_positions=self._hand.joint_dict(track.joint_vector) if track else {},
            T_camera_hand=track.T_camera_hand if track else None,
            confidence=0.0,
            timings=timings,
        )

    def covariance(self, track: Track) -> Array:
        """Covariance of the object's pose as `PoseEstimate` has it, (6, 6)."""
        return about_origin(self._about_centre(track), track.answer, self._object.centre)

    def _about_centre(self, track: Track) -> Array:
        """Covariance of the object's twist, with what the sensor is off by, (6, 6)."""
        c, centre = self._config.object, self._object.centre
        sensor = sensor_covariance(track.answer, centre, c.sensor_along, c.sensor_across)
        return np.asarray(track.whole_covariance + sensor)

    def _accuracy(self, track: Track) -> float:
        """Probability that the pose is right, if it is not another altogether."""
        R = track.T_camera_object[:3, :3]
        covariance = carried(self._about_centre(track), R.T)
        return surface_within(covariance, self._object.surface_form, self._config.loss.right)
