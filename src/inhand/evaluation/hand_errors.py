"""How far an estimated state of the hand is from the truth."""

from collections.abc import Mapping

import numpy as np

from inhand.evaluation.metrics import Array, PoseError
from inhand.geometry.se3 import rotation_angle


def wrist_error(T_estimate: Array, T_truth: Array) -> PoseError:
    """Error of a wrist pose, measured at the origin of the hand frame."""
    return PoseError(
        float(np.linalg.norm(T_estimate[:3, 3] - T_truth[:3, 3])),
        float(rotation_angle(T_estimate[:3, :3], T_truth[:3, :3])),
    )


def angle_errors(estimate: Mapping[str, float], truth: Mapping[str, float]) -> dict[str, float]:
    """Absolute error [rad], 0 to pi, of the joints that both name; whole turns do not count."""
    return {
        name: abs((estimate[name] - truth[name] + np.pi) % (2 * np.pi) - np.pi)
        for name in truth
        if name in estimate
    }
