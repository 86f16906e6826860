"""6D pose of the object in a robot's hand, and the hand's joint angles, from one depth image.

The public names below are imported on first use, so that `import inhand` costs nothing.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from inhand.camera import Camera
    from inhand.config import EstimatorConfig
    from inhand.errors import InputError
    from inhand.estimate import Candidate, PoseEstimate
    from inhand.estimator import PoseEstimator
    from inhand.hand import Hand
    from inhand.object_model import ObjectModel, Symmetry
    from inhand.tracking.config import TrackerConfig
    from inhand.tracking.tracker import PoseTracker

__version__ = "0.1.0"

__all__ = [
    "Camera",
    "Candidate",
    "EstimatorConfig",
    "Hand",
    "InputError",
    "ObjectModel",
    "PoseEstimate",
    "PoseEstimator",
    "PoseTracker",
    "Symmetry",
    "TrackerConfig",
]

_HOME_OF = {
    "Camera": "camera",
    "Candidate": "estimate",
    "EstimatorConfig": "config",
    "Hand": "hand",
    "InputError": "errors",
    "ObjectModel": "object_model",
    "PoseEstimate": "estimate",
    "PoseEstimator": "estimator",
    "PoseTracker": "tracking.tracker",
    "Symmetry": "object_model",
    "TrackerConfig": "tracking.config",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_HOME_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
