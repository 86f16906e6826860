"""What is answered while hand and object rest.

A nearly round body hardly shows how it is turned: over many images, the estimate of that wanders by
degrees towards the truth. While nothing moves, the answer stays until the estimate says that it is
wrong. Where the image determines the pose well, and where anything moves, it is the estimate.
"""

from dataclasses import replace

import numpy as np

from inhand.geometry.se3 import moved
from inhand.tracking.config import TrackerConfig
from inhand.tracking.gaussian import Array, twist_between
from inhand.tracking.track import Track, hand_speed


def with_answer(track: Track, centre: Array, reach: float, config: TrackerConfig) -> Track:
    """The track with the pose to answer, which the estimate draws along.

    Args:
        track: the track after an image that shows the object.
        centre: the object's centre, object frame [m], shape (3,).
        reach: how far the hand reaches from its root [m].
        config: parameters.
    """
    c = config.rest
    if track.images <= c.settling:
        return replace(track, answer=track.T_camera_object)
    # Turns count as the motions at the lever, so that all six have one unit.
    scale = np.array([config.object.lever] * 3 + [1.0] * 3)
    variance, axes = np.linalg.eigh(track.whole_covariance * np.outer(scale, scale))
    way = axes.T @ (scale * twist_between(track.T_camera_object, track.answer, centre))
    most = c.doubt * np.maximum(np.sqrt(np.maximum(variance, 0)) - c.least_doubt, 0)
    way = np.clip(way, -most, most) * (1.0 if rests(track, reach, config) else c.closing)
    return replace(track, answer=moved(track.T_camera_object, axes @ way / scale, centre))


def rests(track: Track, reach: float, config: TrackerConfig) -> bool:
    """Whether neither the hand moves, as far as its given poses tell, nor the object in it."""
    c, speed = config.rest, hand_speed(track.hand_motion, reach)
    motion = track.motion @ np.linalg.solve(track.motion_covariance, track.motion)
    return bool(speed < c.hand_speed and motion < c.most_motion)
