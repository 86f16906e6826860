"""Gauss-Newton over wrist and joints together, several starts at once.

Residuals are distances of scene points to the nearest link's surface and of visible surface samples
to the plane of the reading on their ray, both with a redescending weight. The kernels sum them to
one 6x6 system a link; the kinematics turn these into a system over wrist and joints. Directions
that the image does not determine stay at the prior of the wrist pose.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from inhand.geometry.se3 import exp
from inhand.kernels.depth import pinhole
from inhand.kernels.hand_fit import TERMS, DepthView, hand_to_scene_terms, scene_to_hand_terms
from inhand.kernels.launch import launch
from inhand.kinematics import PRISMATIC
from inhand.packed import PackedHand, device_poses
from inhand.stages.observation import Observation

Array = NDArray[np.float64]
BLOCKS = 16


@dataclass(frozen=True)
class WristPrior:
    """What is known of the wrist before looking."""

    T_camera_hand: Array
    """The given pose, shape (4, 4)."""
    sd_rotation: float
    """[rad] per axis."""
    sd_translation: float
    """[m] per axis."""


def depth_view(observation: Observation) -> Any:
    """The observation as an argument of the hand kernels."""
    view = DepthView()
    view.camera = pinhole(observation.camera)
    view.depth = observation.depth_on_device
    view.normals = observation.normals_on_device
    view.missing = observation.missing_on_device
    return view


class ArticulatedFit:
    """Refines hand states against one observation.

    Args:
        observation: the image.
        hand: the hand.
        used: per link, whether it takes part, shape (L,).
        free: per independent joint, whether it may move, shape (n,).
        prior: prior of the wrist pose.
        point_information: information of one surface point [1/m^2].
        joint_damping: information that holds every joint in one iteration [1/rad^2].
    """

    def __init__(
        self,
        observation: Observation,
        hand: PackedHand,
        used: NDArray[np.bool_],
        free: NDArray[np.bool_],
        prior: WristPrior,
        *,
        point_information: float,
        joint_damping: float,
    ) -> None:
        self.hand, self.prior, self.free = hand, prior, free
        self.point_information, self.joint_damping = point_information, joint_damping
        device = hand.device
        self.view = depth_view(observation)
        self.points = wp.array(observation.points, dtype=wp.vec3, device=device)
        self.normals = wp.array(observation.normals, dtype=wp.vec3, device=device)
        self.weights = wp.full(len(observation.points), 1.0, dtype=float, device=device)
        self.used = wp.array(used.astype(np.int32), dtype=int, device=device)

    def refine(self, q: Array, T_camera_hand: Array, widths: Array) -> tuple[Array, Array]:
        """Refined joint vectors (s, n) and wrist poses (s, 4, 4).

        Args:
            q: starts [rad], shape (s, n).
            T_camera_hand: starts, shape (s, 4, 4).
            widths: width of the redescending weight in every iteration [m].
        """
        lower, upper = self.hand.hand.lower, self.hand.hand.upper
        terms = wp.zeros(
            len(q) * BLOCKS * len(self.hand.hand.links) * TERMS,
            dtype=float,
            device=self.hand.device,
        )
        for width in widths:
            A, b = self._link_systems(q, T_camera_hand, float(width), terms)
            J = self._link_jacobians(q, T_camera_hand)
            H = np.einsum("slip,slij,sljq->spq", J, A, J) * self.point_information
            g = np.einsum("slip,sli->sp", J, b) * self.point_information
            H, g = self._add_priors(H, g, T_camera_hand)
            step = np.linalg.solve(H, g[..., None])[..., 0]
            q = np.clip(q + np.clip(step[:, 6:], -0.3, 0.3), lower, upper)
            motion = exp(np.concatenate([step[:, :3], np.zeros((len(q), 3))], 1))
            moved = T_camera_hand.copy()
            moved[:, :3, :3] = motion[:, :3, :3] @ T_camera_hand[:, :3, :3]
            moved[:, :3, 3] += step[:, 3:6]
            T_camera_hand = moved
        return q, T_camera_hand

    def _link_systems(
        self, q: Array, T_camera_hand: Array, width: float, terms: Any
    ) -> tuple[Array, Array]:
        """Per start and link: 6x6 matrices and right-hand sides about the wrist's origin."""
        hand, device, starts = self.hand, self.hand.device, len(q)
        terms.zero_()
        poses = device_poses(hand.link_poses(q, T_camera_hand), device)
        pivot = wp.array(T_camera_hand[:, :3, 3], dtype=wp.vec3, device=device)
        widths = wp.full(starts, width, dtype=float, device=device)
        launch(
            scene_to_hand_terms,
            starts * BLOCKS,
            [self.points, self.normals, self.weights, hand.fields, hand.spheres, poses, self.used]
            + [pivot, widths, BLOCKS, terms],
            device,
            work_per_item=len(self.points) // BLOCKS,
        )
        launch(
            hand_to_scene_terms,
            starts * BLOCKS,
            [self.view, hand.points, hand.normals, hand.link, self.used, poses]
            + [pivot, widths, BLOCKS, terms],
            device,
            work_per_item=len(hand.points) // BLOCKS,
        )
        sums = terms.numpy().reshape(starts, BLOCKS, -1, TERMS).sum(axis=1, dtype=np.float64)
        upper = np.triu_indices(6)
        A = np.zeros((*sums.shape[:2], 6, 6))
        A[..., upper[0], upper[1]] = sums[..., :21]
        A[..., upper[1], upper[0]] = sums[..., :21]
        return A, sums[..., 21:27]

    def _link_jacobians(self, q: Array, T_camera_hand: Array) -> Array:
        """Twist of every link per parameter, (s, L, 6, 6 + n): rotation, motion at the wrist."""
        chain = self.hand.hand.chain
        n = q.shape[1]
        T = T_camera_hand[:, None] @ chain.joint_poses(q)
        axis = np.einsum("sjab,jb->sja", T[..., :3, :3], chain.axis)
        arm = T[..., :3, 3] - T_camera_hand[:, None, :3, 3]
        slides = (chain.kind == PRISMATIC)[:, None]
        rotation = np.where(slides, 0.0, axis)
        motion = np.where(slides, axis, np.cross(arm, axis))
        screw = np.concatenate([rotation, motion], -1) * chain.multiplier[:, None]
        J = np.zeros((len(q), len(chain.link_joint), 6, 6 + n))
        J[..., :6, :6] = np.eye(6)
        for link, joint in enumerate(chain.link_joint):
            while joint >= 0:
                source = chain.source[joint]
                if self.free[source]:
                    J[:, link, :, 6 + source] += screw[:, joint]
                joint = chain.parent[joint]
        return J

    def _add_priors(self, H: Array, g: Array, T_camera_hand: Array) -> tuple[Array, Array]:
        """Add the wrist's prior and the joints' damping."""
        information = np.repeat([self.prior.sd_rotation, self.prior.sd_translation], 3) ** -2.0
        away = self.prior.T_camera_hand[:3, :3] @ np.swapaxes(T_camera_hand[:, :3, :3], 1, 2)
        towards = np.concatenate(
            [
                Rotation.from_matrix(away).as_rotvec(),
                self.prior.T_camera_hand[:3, 3] - T_camera_hand[:, :3, 3],
            ],
            1,
        )
        n = H.shape[1] - 6
        H = H + np.diag(np.concatenate([information, np.full(n, self.joint_damping)]))
        g = g + np.concatenate([information * towards, np.zeros((len(g), n))], 1)
        return H, g
