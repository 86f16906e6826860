"""Search of single fingers over their whole range, by what the camera should see of them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from inhand.config import HandStateConfig
from inhand.hand import Finger
from inhand.kinematics import PRISMATIC
from inhand.packed import PackedHand
from inhand.stages.hand_visibility import HandVisibility
from inhand.stages.observation import Observation

Array = NDArray[np.float64]


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
        slides = hand.hand.chain.source[hand.hand.chain.kind == PRISMATIC]
        self.scale = np.ones(len(hand.hand.rest))
        self.scale[slides] = config.slide_scale
        self.camera = observation.camera.subsampled(config.render_step)
        self.visibility = HandVisibility(observation, hand, config)

    def alternatives(self, T_camera_hand: Array, rng: np.random.Generator) -> list[Array]:
        """The best distinct configurations of every finger, best first, (k, finger's joints) each.

        All fingers are searched alone first; then in the order of their scores, each beside those
        before it.
        """
        palm = self._render(self.hand.rest, T_camera_hand, [])
        alone = [self._search(finger, T_camera_hand, palm, rng) for finger in self.hand.fingers]
        found = [configurations for configurations, _ in alone]
        order = np.argsort([-score for _, score in alone])
        q = self.hand.rest.copy()
        placed: list[Finger] = []
        for rank, i in enumerate(order):
            finger = self.hand.fingers[i]
            if rank > 0:
                others = self._render(q, T_camera_hand, placed)
                found[i], _ = self._search(finger, T_camera_hand, others, rng)
            q[list(finger.joints)] = found[i][0]
            placed.append(finger)
        return found

    def best_combination(self, q: Array, T_camera_hand: Array) -> tuple[Array, Array]:
        """Every finger's best joints (n,) among refined starts, and the wrist of the best start.

        Args:
            q: refined joint vectors, shape (s, n).
            T_camera_hand: refined wrist poses, shape (s, 4, 4).
        """
        palm = self._render(self.hand.rest, T_camera_hand[0], [])
        score = self.visibility.score
        alone = [score(f.links, q, T_camera_hand, palm)[0] for f in self.hand.fingers]
        total = np.sum(alone, axis=0)
        T = T_camera_hand[total.argmax()]
        combined = q[total.argmax()].copy()
        placed: list[Finger] = []
        for i in np.argsort([-scores.max() for scores in alone]):
            finger = self.hand.fingers[i]
            others = self._render(combined, T, placed)
            best = score(finger.links, q, T_camera_hand, others)[0].argmax()
            combined[list(finger.joints)] = q[best][list(finger.joints)]
            placed.append(finger)
        return combined, T

    def link_support(self, q: Array, T_camera_hand: Array) -> Array:
        """Score of every finger link per share of it that nothing hides, (L,); 0 for palm links.

        Args:
            q: joint vector, shape (n,).
            T_camera_hand: wrist pose, shape (4, 4).
        """
        support = np.zeros(len(self.hand.links))
        for finger in self.hand.fingers:
            others = [other for other in self.hand.fingers if other is not finger]
            depth = self._render(q, T_camera_hand, others)
            for link in finger.links:
                support[link] = self._support((link,), q, T_camera_hand, depth)
        return support

    def hand_support(self, q: Array, T_camera_hand: Array) -> float:
        """Score of the whole hand per share of it that nothing hides; arguments as above."""
        return self._support(range(len(self.hand.links)), q, T_camera_hand, None)

    def _support(self, links: Sequence[int], q: Array, T_camera_hand: Array, others: Any) -> float:
        score, seen = self.visibility.score(links, q[None], T_camera_hand[None], others)
        return float(score[0]) / max(float(seen[0]), self.config.min_seen)

    def _search(
        self, finger: Finger, T_camera_hand: Array, others: Any, rng: np.random.Generator
    ) -> tuple[Array, float]:
        """The best distinct configurations of a finger, best first, and the best score."""
        config, joints = self.config, list(finger.joints)
        lower, upper = self.hand.lower[joints], self.hand.upper[joints]

        def score(tried: Array, tolerance: float, points: int) -> Array:
            q = np.repeat(self.hand.rest[None], len(tried), 0)
            q[:, joints] = tried
            poses = np.repeat(T_camera_hand[None], len(q), 0)
            return self.visibility.score(finger.links, q, poses, others, tolerance, points)[0]

        sampler = qmc.Sobol(len(joints), seed=rng)
        tried = lower + sampler.random_base2(int(np.log2(config.samples))) * (upper - lower)
        scores = score(tried, config.coarse_tolerance, config.coarse_points)
        scale = self.scale[joints]
        centres = _distinct(tried, scores, config.distinct_angle * scale, config.alternatives)
        spread = rng.normal(
            0, config.local_spread, (len(centres), config.local_samples, len(joints))
        )
        spread[:, 0] = 0.0
        spread *= scale
        around = np.clip(centres[:, None] + spread, lower, upper)
        scores = score(around.reshape(-1, len(joints)), config.fine_tolerance, config.fine_points)
        scores = scores.reshape(len(centres), -1)
        best = around[np.arange(len(centres)), scores.argmax(axis=1)]
        return best[np.argsort(-scores.max(axis=1))], float(scores.max())

    def _render(self, q: Array, T_camera_hand: Array, fingers: Sequence[Finger]) -> Any:
        """Depth [m], on the device, of the palm and some fingers at joint vector (n,)."""
        shown = {*self.hand.palm_links, *(link for finger in fingers for link in finger.links)}
        poses = self.packed.link_poses(q[None], T_camera_hand[None])[0]
        return self.packed.render(self.camera, poses, np.isin(np.arange(len(poses)), list(shown)))


def _distinct(tried: Array, score: Array, apart: Array, keep: int) -> Array:
    """The best configurations that differ by `apart` (joints,) in some joint, best first."""
    chosen: list[Array] = []
    left = tried[np.argsort(-score)]
    while len(left) and len(chosen) < keep:
        chosen.append(left[0])
        left = left[(np.abs(left - left[0]) > apart).any(axis=1)]
    return np.stack(chosen)
