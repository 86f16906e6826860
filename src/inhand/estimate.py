"""What the estimator returns."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Candidate:
    """One of the ranked poses of the object."""

    T_camera_object: NDArray[np.float64]
    """Pose of the object in the camera, shape (4, 4)."""
    scores: dict[str, float]
    """Scores by name; higher is better."""


@dataclass(frozen=True)
class PoseEstimate:
    """The answer to one depth image."""

    found: bool
    """Whether there is an answer."""
    reason: str
    """Why there is none, a sentence for a person; empty when found."""
    T_camera_object: NDArray[np.float64] | None
    """Pose of the object in the camera, shape (4, 4); None when not found."""
    joint_positions: dict[str, float]
    """Position of every movable joint [rad, or m], mimic joints included; empty if unknown."""
    T_camera_hand: NDArray[np.float64] | None
    """Refined pose of the hand's root link in the camera, shape (4, 4); None if unknown."""
    confidence: float
    """Probability that `T_camera_object` is right, 0..1; 0 when not found."""
    candidates: tuple[Candidate, ...] = ()
    """Ranked alternatives; the first is the answer."""
    timings: dict[str, float] = field(default_factory=dict)
    """Wall-clock time of every stage [s]."""
    covariance: NDArray[np.float64] | None = None
    """Of `T_camera_object`, shape (6, 6): rotation vector [rad], then translation [m], of the
    object's frame about its own origin, camera axes. From a tracker; None from the estimator."""
