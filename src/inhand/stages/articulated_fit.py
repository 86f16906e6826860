"""Gauss-Newton over wrist and joints together, several starts at once.

Residuals are distances of scene points to the nearest link's surface and of visible surface samples
to the plane of the reading on their ray, both with a redescending weight. The kernels sum them to
one 6x6 system a link; the kinematics turn these into a system over wrist and joints. Directions
that the image does not determine stay at the prior of the wrist pose. All iterations run on the
device, from launches that are prepared once.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.kernels import gauss_newton as kernels
from inhand.kernels.depth import pinhole
from inhand.kernels.gauss_newton import gauss_newton_step, normal_equations
from inhand.kernels.hand_fit import (
    TERMS,
    DepthView,
    hand_to_scene_terms,
    scene_to_hand_terms,
)
from inhand.kernels.kinematics import Twist, pose_links
from inhand.kernels.launch import prepare
from inhand.packed import PackedHand
from inhand.stages.observation import Observation

Array = NDArray[np.float64]
BLOCKS = 16
Launch = Callable[[], None]


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
        device = hand.device
        self.hand = hand
        self.point_information, self.joint_damping = point_information, joint_damping
        self.prior = kernels.WristPrior()
        self.prior.T_camera_hand = wp.mat44d(prior.T_camera_hand)
        self.prior.rotation = prior.sd_rotation**-2.0
        self.prior.translation = prior.sd_translation**-2.0
        self.free = wp.array(free.astype(np.int32), dtype=int, device=device)
        self.view = depth_view(observation)
        self.points = wp.array(observation.points, dtype=wp.vec3, device=device)
        self.normals = wp.array(observation.normals, dtype=wp.vec3, device=device)
        self.used = wp.array(used.astype(np.int32), dtype=int, device=device)

    def refine(
        self, q: Array, T_camera_hand: Array, widths: Array, stride: int = 1
    ) -> tuple[Array, Array]:
        """Refined joint vectors (s, n) and wrist poses (s, 4, 4).

        Args:
            q: starts [rad], shape (s, n).
            T_camera_hand: starts, shape (s, 4, 4).
            widths: width of the redescending weight in every iteration [m].
            stride: every so-many-th point takes part.
        """
        fit = self.begin(q, T_camera_hand, widths, stride)
        for _ in widths:
            fit.assemble()
            fit.step()
        return fit.q.numpy().copy(), fit.T_camera_hand.numpy().copy()

    def begin(
        self, q: Array, T_camera_hand: Array, widths: Array, stride: int = 1
    ) -> "FitInProgress":
        """A refinement whose iterations are still to be done; arguments as `refine`."""
        hand, device, starts = self.hand, self.hand.device, len(q)
        links, parameters = len(hand.hand.links), 6 + q.shape[1]
        empty = partial(wp.empty, device=device)
        q_now = wp.array(q, dtype=wp.float64, device=device)
        T_now = wp.array(T_camera_hand, dtype=wp.mat44d, device=device)
        T_joint = empty((starts, len(hand.hand.chain.parent)), dtype=wp.mat44d)
        T_link = empty(starts * links, dtype=wp.mat44)
        twists = empty(T_joint.shape, dtype=Twist)
        terms = empty(starts * BLOCKS * links * TERMS, dtype=float)
        H = empty((starts, parameters, parameters), dtype=wp.float64)
        g = empty((starts, parameters), dtype=wp.float64)
        iteration = wp.zeros(starts, dtype=int, device=device)
        all_widths = wp.array(widths, dtype=float, device=device)
        sums = [self.used, T_link, T_now, all_widths, iteration, BLOCKS, stride, terms]

        def launches(kernel: Any, items: int, inputs: list[Any], work: int = 1) -> Launch:
            return prepare(kernel, items, inputs, device, work_per_item=work)

        return FitInProgress(
            q_now,
            T_now,
            twists,
            H,
            g,
            [
                launches(pose_links, starts, [hand.chain, q_now, T_now, T_joint, T_link]),
                launches(
                    scene_to_hand_terms,
                    starts * BLOCKS,
                    [self.points, self.normals, hand.fields, hand.spheres, *sums],
                    10 * len(self.points) // BLOCKS // stride,
                ),
                launches(
                    hand_to_scene_terms,
                    starts * BLOCKS,
                    [self.view, hand.points, hand.normals, hand.link, *sums],
                    4 * len(hand.points) // BLOCKS // stride,
                ),
                launches(
                    normal_equations,
                    starts,
                    [hand.chain, self.free, T_now, T_joint, terms, BLOCKS, twists, H, g],
                ),
            ],
            launches(
                gauss_newton_step,
                starts,
                [H, g, stride * self.point_information, self.prior, self.joint_damping]
                + [hand.lower, hand.upper, q_now, T_now, iteration],
            ),
        )


@dataclass(frozen=True)
class FitInProgress:
    """What a refinement changes, on the device, and the launches of one iteration in order."""

    q: Any
    """Joint vectors [rad, m], (s, n)."""
    T_camera_hand: Any
    """Wrist poses, (s)."""
    twists: Any
    """Twists of the joints, see `normal_equations`, (s, j)."""
    H: Any
    """Matrices of the systems, (s, 6 + n, 6 + n)."""
    g: Any
    """Right-hand sides, (s, 6 + n)."""
    sums: Sequence[Launch]
    """Make the systems, without priors, where joints and wrists are."""
    step: Launch
    """Solve the systems with their priors and move joints and wrists."""

    def assemble(self) -> None:
        """Run `sums`."""
        for launch in self.sums:
            launch()
