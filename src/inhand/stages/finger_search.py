"""Search of single fingers over their whole range, by what the camera should see of them."""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from inhand.config import HandStateConfig
from inhand.geometry.se3 import Array
from inhand.hand import Hand
from inhand.kernels.launch import on_device, on_host
from inhand.kinematics import PRISMATIC
from inhand.packed import PackedHand, PackedPart
from inhand.stages.hand_visibility import HandVisibility, Scores, nearest_around
from inhand.stages.observation import Observation
from inhand.stages.results import Configurations


class FingerSearch:
    """Scores configurations of single fingers against the image.

    Surface that the palm or another finger explains does not count for a finger, so that two
    fingers cannot claim the same readings.

    Args:
        observation: the image.
        hand: the hand.
        config: parameters.
    """

    def __init__(self, observation: Observation, hand: PackedHand, config: HandStateConfig) -> None:
        self.packed, self.hand, self.config = hand, hand.hand, config
        self._first_rule = config.coarse_tolerance, config.first_points
        self._coarse_rule = config.coarse_tolerance, config.coarse_points
        self._fine_rule = config.fine_tolerance, config.fine_points
        slides = hand.hand.chain.source[hand.hand.chain.kind == PRISMATIC]
        self.scale = np.ones(len(hand.hand.rest))
        self.scale[slides] = config.slide_scale
        self.camera = observation.camera.subsampled(config.render_step)
        self.visibility = HandVisibility(observation, hand, config)
        nearest = nearest_around(observation, config.wrist_slack, config.render_step)
        self._nearest = on_device(nearest, float, hand.device)
        self._palm_depth: Any = None

    def alternatives(
        self, T_camera_hand: Array, rng: np.random.Generator
    ) -> tuple[list[Array], tuple[Configurations, ...]]:
        """The best distinct configurations of every finger, best first, (a, finger's joints) each,
        and many more that the image allows.

        All fingers are searched alone first, by a few samples; then in the order of their scores,
        each beside those before it, among its better configurations. A wrist that is a degree off
        puts a finger beside itself, so lenient scores decide what is refined.
        """
        fingers, q = self.packed.fingers, self.hand.rest.copy()
        there = self._palm(q, T_camera_hand)
        found = [configurations(f, self.hand, self.config.samples) for f in fingers]
        scores = [
            self._score(finger, tried, T_camera_hand[None], there, self._first_rule).lenient
            for finger, tried in zip(fingers, found, strict=True)
        ]
        order = np.argsort([-score.max() for score in scores])
        allowed: dict[int, Configurations] = {}
        for rank, i in enumerate(order):
            tried, score = found[i], scores[i]
            if rank > 0:
                there = self._beside(there, fingers[order[rank - 1]], self._poses(q, T_camera_hand))
            tried = tried[np.argsort(-score, kind="stable")[: self.config.shortlist]]
            score = self._score(fingers[i], tried, T_camera_hand[None], there, self._coarse_rule)
            best = np.argsort(-score.strict, kind="stable")[: self.config.allowed]
            allowed[i] = Configurations(tried[best], score.strict[best])
            tried = tried[np.argsort(-score.lenient, kind="stable")]
            found[i] = self._look_around(fingers[i], tried, T_camera_hand, there, rng)
            q[fingers[i].joints] = found[i][0]
        return found, tuple(allowed[i] for i in range(len(fingers)))

    def best_combination(self, q: Array, T_camera_hand: Array) -> tuple[Array, Array]:
        """Every finger's best joints (n,) among refined starts, and the wrist of the best start.

        Args:
            q: refined joint vectors, shape (s, n).
            T_camera_hand: refined wrist poses, shape (s, 4, 4).
        """
        fingers, there = self.packed.fingers, self._palm(q[0], T_camera_hand[0])
        alone = [
            self._score(f, q[:, f.joints], T_camera_hand, there, self._fine_rule).strict
            for f in fingers
        ]
        best = np.sum(alone, axis=0).argmax()
        T, combined = T_camera_hand[best], q[best].copy()
        order = np.argsort([-score.max() for score in alone])
        for rank, i in enumerate(order):
            joints, score = fingers[i].joints, alone[i]
            if rank > 0:
                there = self._beside(there, fingers[order[rank - 1]], self._poses(combined, T))
                rule = self._fine_rule
                score = self._score(fingers[i], q[:, joints], T_camera_hand, there, rule).strict
            combined[joints] = q[score.argmax(), joints]
        return combined, T

    def _score(
        self,
        finger: PackedPart,
        joints: Array,
        T_camera_hand: Array,
        others: Any,
        rule: tuple[float, int],
    ) -> Scores:
        """Scores beside what else is there, by a depth agreement [m] and samples of a link."""
        score = self.visibility.score
        return score(finger, joints, T_camera_hand, others, *rule, nearest=self._nearest)

    def _look_around(
        self,
        finger: PackedPart,
        tried: Array,
        T_camera_hand: Array,
        others: Any,
        rng: np.random.Generator,
    ) -> Array:
        """The best distinct configurations (a, k) near those of a search; best first, both."""
        config, joints = self.config, finger.joints
        scale = self.scale[joints]
        searched = configurations(finger, self.hand, config.samples)
        spacing = np.ptp(searched, axis=0) * len(searched) ** (-1 / len(joints))
        apart = np.maximum(config.distinct_angle * scale, config.distinct_spacings * spacing)
        centres = _distinct(tried, apart, config.alternatives)
        shape = len(centres), config.local_samples, len(joints)
        spread = rng.normal(0, config.local_spread, shape)
        spread[:, 0] = 0.0
        around = centres[:, None] + spread * scale
        around = np.clip(around, self.hand.lower[joints], self.hand.upper[joints])
        flat = around.reshape(-1, len(joints))
        score = self._score(finger, flat, T_camera_hand[None], others, self._fine_rule).strict
        score = score.reshape(len(centres), -1)
        best = around[np.arange(len(centres)), score.argmax(axis=1)]
        return best[np.argsort(-score.max(axis=1))]

    def _poses(self, q: Array, T_camera_hand: Array) -> NDArray[np.float32]:
        """Link poses (L, 4, 4) at joint vector (n,)."""
        return on_host(self.packed.pose(q[None], T_camera_hand[None]))

    def _palm(self, q: Array, T_camera_hand: Array) -> Any:
        """Depth [m] of the palm, on the device.

        It is rendered once: what the wrist moves in its refinement is less than a pixel here.
        """
        if self._palm_depth is None:
            poses = self._poses(q, T_camera_hand)
            self._palm_depth = self.packed.render(self.camera, poses, self.packed.is_palm)
        return self._palm_depth

    def _beside(self, others: Any, finger: PackedPart, T_camera_link: NDArray[np.float32]) -> Any:
        """Depth [m] of a finger and of what else is there, on the device."""
        shown = np.zeros(len(T_camera_link), dtype=bool)
        shown[finger.links] = True
        return self.packed.render(self.camera, T_camera_link, shown, others)


def configurations(finger: PackedPart, hand: Hand, count: int) -> Array:
    """Configurations (c, k) all over a finger's range; c is a power of two up to `count`, which is
    doubled for every second joint, at most four times."""
    lower, upper = hand.lower[finger.joints], hand.upper[finger.joints]
    return lower + _even_points(len(lower), count) * (upper - lower)


@cache
def _even_points(dimension: int, count: int) -> Array:
    """Points that fill the unit cube evenly, (c, dimension); c as in `configurations`."""
    count <<= min(dimension // 2, 4)
    return np.asarray(qmc.Sobol(dimension, seed=0).random_base2(int(np.log2(count))))


def _distinct(left: Array, apart: Array, keep: int) -> Array:
    """The first configurations that differ by `apart` (joints,) in some joint."""
    chosen: list[Array] = []
    while len(left) and len(chosen) < keep:
        chosen.append(left[0])
        left = left[(np.abs(left - left[0]) > apart).any(axis=1)]
    return np.stack(chosen)
