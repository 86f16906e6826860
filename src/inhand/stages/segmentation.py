"""Removal of the hand from the scene cloud; what remains is the object segment P_O."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Segment:
    """The object segment P_O."""

    points: NDArray[np.float32]
    """Points [m], camera frame, shape (n, 3)."""
    normals: NDArray[np.float32]
    """Unit normals towards the camera, shape (n, 3)."""
    hand_distance: NDArray[np.float32]
    """Signed distance of every point to the estimated hand [m], shape (n,)."""
    weight: NDArray[np.float32]
    """Probability that the point belongs to the object, shape (n,)."""
