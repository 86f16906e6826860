"""Gauss-Newton over wrist and joints together, several starts at once.

Residuals are distances of scene points to the nearest link's surface and of visible surface samples
to the plane of the reading on their ray, both with a redescending weight. The kernels sum them to
one 6x6 system a link; the kinematics turn these into a system over wrist and joints. Directions
that the image does not determine stay at the prior of the wrist pose. All iterations run on the
device.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.config import HandStateConfig
from inhand.geometry.se3 import Array
from inhand.kernels import gauss_newton as kernels
from inhand.kernels import hand_terms
from inhand.kernels.kinematics import Twist
from inhand.kernels.launch import block_size, in_struct, launch, prepare
from inhand.kernels.normal_equations import Vector6
from inhand.packed import PackedHand
from inhand.stages.observation import Observation


@dataclass(frozen=True)
class WristPrior:
    """What is known of the wrist before looking."""

    T_camera_hand: Array
    """The given pose, shape (4, 4)."""
    sd_rotation: float
    """[rad] per axis."""
    sd_translation: float
    """[m] per axis."""


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
        self.point_information = point_information
        p = hand_terms.FitProblem()
        p.view = observation.view
        p.points, p.normals = observation.cloud_on_device
        p.fields, p.chain = hand.fields, hand.chain
        p.hand_points, p.hand_normals, p.hand_link = hand.points, hand.normals, hand.link
        p.lower, p.upper = hand.lower, hand.upper
        p.used = in_struct(used.astype(np.int32), int, device)
        p.free = in_struct(free.astype(np.int32), int, device)
        p.prior.T_camera_hand = wp.mat44d(prior.T_camera_hand)
        p.prior.rotation, p.prior.translation = prior.sd_rotation**-2.0, prior.sd_translation**-2.0
        p.joint_damping = joint_damping
        self.problem = p

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
        state = self._start(q, T_camera_hand, widths, stride)
        work = len(widths) * self._work(stride)
        kernel, inputs, device = kernels.refine_states, [self.problem, state], self.hand.device
        launch(kernel, len(q), inputs, device, work_per_item=work, shared=True)
        return state.q.numpy(), state.T_camera_hand.numpy()

    def begin(self, q: Array, T_camera_hand: Array, width: float, stride: int) -> "FitInProgress":
        """A refinement that is done step by step; arguments as `refine`, of one width."""
        state = self._start(q, T_camera_hand, np.array([width]), stride)
        kernel, inputs, work = kernels.assemble_systems, [self.problem, state], self._work(stride)
        device = self.hand.device
        assemble = prepare(kernel, len(q), inputs, device, work_per_item=work, shared=True)
        return FitInProgress(state, assemble)

    def _work(self, stride: int) -> int:
        """Rough number of operations of one iteration of one start."""
        return (10 * len(self.problem.points) + 4 * len(self.problem.hand_points)) // stride

    def _start(self, q: Array, T_camera_hand: Array, widths: Array, stride: int) -> Any:
        """State of a refinement that is still to be done; completes the problem."""
        hand, device, starts, parameters = self.hand, self.hand.device, len(q), 6 + q.shape[1]
        links, joints = len(hand.hand.links), len(hand.hand.chain.parent)
        empty = partial(wp.empty, device=device)
        problem, state = self.problem, hand_terms.FitState()
        problem.widths = in_struct(widths, float, device)
        problem.stride = stride
        problem.information = stride * self.point_information
        # Copies: the kernels move them.
        state.q = wp.array(q, dtype=wp.float64, device=device)
        state.T_camera_hand = wp.array(T_camera_hand, dtype=wp.mat44d, device=device)
        state.iteration = wp.zeros(starts, dtype=int, device=device)
        state.T_camera_joint = empty((starts, joints), dtype=wp.mat44d)
        state.T_camera_link = empty(starts * links, dtype=wp.mat44)
        state.sums = empty((block_size(device), starts, 7 * links), dtype=Vector6)
        state.twists = empty((starts, joints), dtype=Twist)
        state.H = empty((starts, parameters, parameters), dtype=wp.float64)
        state.g = empty((starts, parameters), dtype=wp.float64)
        return state


def whole_hand_fit(
    observation: Observation, hand: PackedHand, prior: WristPrior, config: HandStateConfig
) -> ArticulatedFit:
    """The fit of wrist and all joints to what the image shows of all links."""
    return ArticulatedFit(
        observation,
        hand,
        used=np.ones(len(hand.hand.links), dtype=bool),
        free=np.ones(len(hand.hand.joint_names), dtype=bool),
        prior=prior,
        point_information=config.point_information,
        joint_damping=config.joint_damping,
    )


@dataclass(frozen=True)
class FitInProgress:
    """A refinement between its steps."""

    state: Any
    """What it changes, on the device, `kernels.hand_terms.FitState`."""
    assemble: Callable[[], None]
    """Makes the systems `state.H` x = `state.g`, without priors, where joints and wrists are."""
