"""Gauss-Newton over wrist and joints together, several starts at once.

Residuals are distances of scene points to the nearest link's surface and of visible surface samples
to the plane of the reading on their ray, both with a redescending weight. The kernels sum them to
one 6x6 system a link; the kinematics turn these into a system over wrist and joints. Directions
that the image does not determine stay at the prior of the wrist pose. All iterations run on the
device.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.config import HandStateConfig
from inhand.geometry.se3 import Array
from inhand.kernels.gauss_newton import refine_states
from inhand.kernels.kinematics import Twist
from inhand.kernels.launch import assign, block_size, empty, on_device, on_host, prepare
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
        self.hand = hand
        self.point_information = point_information
        self._scene_points = len(observation.points)
        self._fixed = [observation.view, hand.fitted, *observation.cloud_on_device]
        self._fixed += [on_device(x, int, hand.device) for x in (used, free)]
        self._prior = [joint_damping, wp.mat44d(prior.T_camera_hand)]
        self._prior += [prior.sd_rotation**-2.0, prior.sd_translation**-2.0]

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
        fit = self._prepare(q, T_camera_hand, widths, stride, moving=True)
        fit.run()
        return on_host(fit.q), on_host(fit.T_camera_hand)

    def begin(self, q: Array, T_camera_hand: Array, width: float, stride: int) -> "PreparedFit":
        """A fit whose steps the caller takes; arguments as `refine`, of one width."""
        return self._prepare(q, T_camera_hand, np.array([width]), stride, moving=False)

    def _prepare(
        self, q: Array, T_camera_hand: Array, widths: Array, stride: int, *, moving: bool
    ) -> "PreparedFit":
        hand, device, starts, parameters = self.hand, self.hand.device, len(q), 6 + q.shape[1]
        links, joints = len(hand.hand.links), len(hand.hand.chain.parent)
        inputs = [*self._fixed, stride, stride * self.point_information]
        inputs += [*self._prior, on_device(widths, float, device), int(moving)]
        # Copies: the kernel moves them.
        q = on_device(q.copy(), wp.float64, device)
        T_camera_hand = on_device(T_camera_hand.copy(), wp.mat44d, device)
        H = empty((starts, parameters, parameters), wp.float64, device)
        g = empty((starts, parameters), wp.float64, device)
        inputs += [q, T_camera_hand, empty((starts, joints), wp.mat44d, device)]
        inputs += [empty((starts * links,), wp.mat44, device)]
        inputs += [empty((block_size(device), starts, 7 * links), Vector6, device)]
        inputs += [twists := empty((starts, joints), Twist, device), H, g]
        work = len(widths) * (10 * self._scene_points + 4 * len(hand.points)) // stride
        run = prepare(refine_states, starts, inputs, device, work_per_item=work, shared=True)
        return PreparedFit(q, T_camera_hand, twists, H, g, run)


def whole_hand_fit(
    observation: Observation,
    hand: PackedHand,
    prior: WristPrior,
    config: HandStateConfig,
    used: NDArray[np.bool_] | None = None,
) -> ArticulatedFit:
    """The fit of wrist and all joints to what the image shows of all links, or of those `used`."""
    return ArticulatedFit(
        observation,
        hand,
        used=np.ones(len(hand.hand.links), dtype=bool) if used is None else used,
        free=np.ones(len(hand.hand.joint_names), dtype=bool),
        prior=prior,
        point_information=config.point_information,
        joint_damping=config.joint_damping,
    )


@dataclass(frozen=True)
class PreparedFit:
    """A fit that can be run; its arrays are on the device."""

    q: Any
    """Joints of every start [rad], (s, n)."""
    T_camera_hand: Any
    """Wrists, (s)."""
    twists: Any
    """Twist of what each joint carries per unit of its source, (s, j, 6)."""
    H: Any
    """The last iteration's systems H x = g over wrist and joints, (s, 6 + n, 6 + n)."""
    g: Any
    """(s, 6 + n)."""
    run: Callable[[], None]
    """Does all iterations, from where joints and wrists are."""

    def system(self, q: Array, T_camera_hand: Array) -> tuple[Array, Array]:
        """The system without priors, H (6 + n, 6 + n) and g (6 + n,), of the one start, put there.

        The next call may write over it.

        Args:
            q: joints [rad], shape (n,).
            T_camera_hand: wrist, shape (4, 4).
        """
        assign(self.q, q[None])
        assign(self.T_camera_hand, T_camera_hand[None])
        self.run()
        return on_host(self.H)[0], on_host(self.g)[0]
