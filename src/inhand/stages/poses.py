"""The set of object poses that is handed from stage to stage."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class PoseSet:
    """Object poses with a score each; higher is better."""

    T_camera_object: NDArray[np.float32]
    """Poses, shape (m, 4, 4)."""
    score: NDArray[np.float32]
    """Score within the stage that made the set, shape (m,)."""

    def __len__(self) -> int:
        return len(self.score)

    def take(self, index: NDArray[np.intp]) -> "PoseSet":
        """The poses at `index`, in that order."""
        return PoseSet(self.T_camera_object[index], self.score[index])
