"""The part of an image that shows hand and object where they are expected."""

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.geometry import se3
from inhand.packed import PackedHand, PackedObject
from inhand.stages.observation import NEAREST, Observation, observe
from inhand.tracking.config import TrackerConfig
from inhand.tracking.gaussian import Array
from inhand.tracking.track import Track


def look_at(
    image: NDArray[np.float32],
    camera: Camera,
    track: Track,
    hand: PackedHand,
    obj: PackedObject,
    config: TrackerConfig,
) -> Observation:
    """The region of interest around hand and object, as coarse as the tracker needs it.

    Args:
        image: depth [m], shape (H, W).
        camera: its camera.
        track: the track as predicted.
        hand, obj: the models.
        config: parameters.

    Raises:
        NoAnswer: that lies outside the image, or holds too few readings.
    """
    centre, radius = _sphere(track, hand, obj)
    distance = max(float(se3.transform(track.T_camera_hand, centre[None])[0, 2]), NEAREST)
    step = max(1, round(config.view.pixel_spacing * camera.fx / distance))
    return observe(
        image[::step, ::step],
        camera.subsampled(step),
        track.T_camera_hand,
        (centre, radius),
        0.0,
        config.observation,
        hand.device,
    )


def _sphere(track: Track, hand: PackedHand, obj: PackedObject) -> tuple[Array, float]:
    """Centre (3,), hand frame, and radius [m] of a sphere that holds hand and object."""
    links = hand.hand.forward_kinematics(track.joint_vector)
    corners = hand.corners @ links[:, :3, :3].swapaxes(1, 2) + links[:, None, :3, 3]
    T_hand_object = se3.inverse(track.T_camera_hand) @ track.T_camera_object
    held = se3.transform(T_hand_object, obj.model.mesh.hull_vertices)
    points = np.concatenate([corners.reshape(-1, 3), held])
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    return centre, float(np.linalg.norm(points - centre, axis=1).max())
