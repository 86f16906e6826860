"""What must hold of an estimate, whatever the image."""

import math

import numpy as np

from inhand import Camera, InputError, PoseEstimator
from inhand.geometry.se3 import check_rigid, transform


def check_any_answer(
    estimator: PoseEstimator, depth: np.ndarray, camera: Camera, T_camera_hand: np.ndarray
) -> None:
    """Whatever the image: a sound answer, or a reason."""
    try:
        estimate = estimator.estimate(depth, camera, T_camera_hand)
    except InputError:
        return  # most of the image is farther away than 50 m
    hand = estimator.hand.hand
    assert 0 <= estimate.confidence <= 1
    assert estimate.found == (estimate.reason == "")
    for candidate in estimate.candidates:
        check_rigid(candidate.T_camera_object, "candidate")
        assert all(math.isfinite(score) for score in candidate.scores.values())
    if estimate.T_camera_hand is not None:
        check_rigid(estimate.T_camera_hand, "T_camera_hand")
        q = hand.joint_vector(estimate.joint_positions)
        assert ((hand.lower - 1e-9 <= q) & (q <= hand.upper + 1e-9)).all()
    if estimate.found:
        T = check_rigid(estimate.T_camera_object, "T_camera_object")
        assert estimate.T_camera_hand is not None
        centre = transform(T, estimator.object.model.centre[None])[0]
        middle = transform(estimate.T_camera_hand, hand.reach[0][None])[0]
        reach = hand.reach[1] + 2 * estimator.object.model.diameter
        assert np.linalg.norm(centre - middle) < reach
    else:
        assert estimate.T_camera_object is None
        assert estimate.confidence == 0
