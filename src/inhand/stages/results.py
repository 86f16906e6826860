"""What the stages hand to each other."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Wrist:
    """The corrected wrist."""

    T_camera_hand: NDArray[np.float64]
    """Pose of the hand's root link in the camera, shape (4, 4)."""


@dataclass(frozen=True)
class Configurations:
    """Configurations of a finger that the image allows."""

    joints: NDArray[np.float64]
    """Positions of the finger's joints [rad, m], best first, shape (c, k)."""
    score: NDArray[np.float64]
    """Visibility score of each, shape (c,)."""


@dataclass(frozen=True)
class HandState:
    """The estimated hand."""

    joint_vector: NDArray[np.float64]
    """Independent joint positions in the order of `hand.joint_names` [rad], shape (n,)."""
    T_camera_hand: NDArray[np.float64]
    """Pose of the hand's root link in the camera, shape (4, 4)."""
    T_camera_link: NDArray[np.float64]
    """Poses of the links that have geometry, shape (L, 4, 4)."""
    certain: NDArray[np.bool_]
    """Whether the image supports each link where it is, shape (L,); palm links always count."""
    allowed: tuple[Configurations, ...] = ()
    """What else the image allows, finger by finger; empty if no other configurations were tried."""


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
    hand_misfit: float = 0.0
    """Mean distance [m] of the scene cloud's points at the hand to its surface: what sensor,
    calibration and model leave where all is right; 0 if it is not known."""

    def where(self, mask: NDArray[np.bool_]) -> "Segment":
        """The points of which a mask, shape (n,), is true."""
        points, normals, distance = self.points, self.normals, self.hand_distance
        parts = points[mask], normals[mask], distance[mask], self.weight[mask]
        return Segment(*parts, self.hand_misfit)


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


@dataclass(frozen=True)
class Selection:
    """The poses that are left, best first, and how sure the first one is."""

    poses: PoseSet
    """Ranked poses."""
    confidence: float
    """Probability that the first pose is right, 0..1."""
    joint_vector: NDArray[np.float64]
    """The hand's joints [rad, m], with hidden fingers placed against the first pose and missed ones
    where they explain what it leaves, shape (n,)."""

    @property
    def T_camera_object(self) -> NDArray[np.float32]:
        """Ranked poses, shape (m, 4, 4)."""
        return self.poses.T_camera_object

    @property
    def score(self) -> NDArray[np.float32]:
        """Scores, shape (m,)."""
        return self.poses.score
