"""How well posed links of the hand agree with what the camera sees of them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.config import HandStateConfig
from inhand.kernels.hand_fit import Visibility, score_configurations
from inhand.kernels.launch import launch
from inhand.packed import PackedHand, device_poses
from inhand.stages.articulated_fit import depth_view
from inhand.stages.observation import Observation

Array = NDArray[np.float64]


class HandVisibility:
    """Scores hand states against the image.

    Args:
        observation: the image.
        hand: the hand.
        config: parameters.
    """

    def __init__(self, observation: Observation, hand: PackedHand, config: HandStateConfig) -> None:
        self._hand, self._config = hand, config
        self._view = depth_view(observation)
        coarse = observation.camera.subsampled(config.render_step)
        self._nothing = wp.zeros(coarse.width * coarse.height, dtype=float, device=hand.device)

    def score(
        self,
        links: Sequence[int],
        q: Array,
        T_camera_hand: Array,
        others: Any = None,
        tolerance: float | None = None,
        points: int | None = None,
    ) -> tuple[Array, Array]:
        """Visibility score of some links and the share of them that nothing hides, (c,) each.

        Args:
            links: indices of the links.
            q: joint vectors [rad], shape (c, n).
            T_camera_hand: wrist poses, shape (c, 4, 4).
            others: rendered depth [m] of other parts of the hand, on the device, at every
                `render_step`-th pixel; what they hide or explain does not count.
            tolerance: depth agreement [m]; by default the fine one.
            points: surface samples of every link that are used at most.
        """
        hand, config, device = self._hand, self._config, self._hand.device
        rule = Visibility()
        rule.tolerance = tolerance or config.fine_tolerance
        rule.violation, rule.missing, rule.hidden = config.violation, config.missing, config.hidden
        ranges = [np.arange(*hand.point_start[[i, i + 1]])[:points] for i in links]
        samples = wp.array(np.concatenate(ranges), dtype=int, device=device)
        poses = device_poses(hand.link_poses(q, T_camera_hand), device)
        score = wp.empty(len(q), dtype=float, device=device)
        seen = wp.empty(len(q), dtype=float, device=device)
        launch(
            score_configurations,
            len(q),
            [self._view, rule, poses, len(hand.hand.links), hand.points, hand.normals, hand.link]
            + [samples, self._nothing if others is None else others, config.render_step]
            + [score, seen],
            device,
            work_per_item=len(samples),
        )
        return score.numpy().astype(np.float64), seen.numpy().astype(np.float64)
