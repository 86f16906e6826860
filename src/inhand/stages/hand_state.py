"""The hand's joint angles (paper, section IV-A)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.stats import qmc

from inhand.config import HandStateConfig, WristConfig
from inhand.hand import Finger
from inhand.kernels.hand_fit import Visibility, score_configurations
from inhand.kernels.launch import launch
from inhand.packed import PackedHand, device_poses
from inhand.stages.articulated_fit import ArticulatedFit, depth_view
from inhand.stages.observation import Observation
from inhand.stages.wrist import Wrist, wrist_prior

Array = NDArray[np.float64]
PALM_STEP = 2
"""The palm is rendered at every so-many-th pixel."""


@dataclass(frozen=True)
class HandState:
    """The estimated hand."""

    joint_vector: Array
    """Independent joint positions in the order of `hand.joint_names` [rad], shape (n,)."""
    T_camera_hand: Array
    """Pose of the hand's root link in the camera, shape (4, 4)."""
    T_camera_link: Array
    """Poses of the links that have geometry, shape (L, 4, 4)."""
    certain: NDArray[np.bool_]
    """Whether the image supports each link where it is, shape (L,); palm links always count."""


def estimate_hand_state(
    observation: Observation,
    wrist: Wrist,
    hand: PackedHand,
    config: HandStateConfig,
    wrist_config: WristConfig,
    rng: np.random.Generator,
) -> HandState:
    """Joint angles and refined wrist.

    By default every finger is searched over its whole range with a visibility-aware score; the best
    few configurations of each then start a joint Gauss-Newton over wrist and all fingers.
    """
    if config.method == "swarm":
        from inhand.stages.particle_swarm import search_fingers

        return search_fingers(observation, wrist, hand, config, rng)
    search = _FingerSearch(observation, hand, config)
    T = wrist.T_camera_hand
    palm = search.render_palm(T)
    alternatives = [search.alternatives(finger, T, palm, rng) for finger in hand.hand.fingers]
    starts = _starts(alternatives, hand)
    fit = ArticulatedFit(
        observation,
        hand,
        used=np.ones(len(hand.hand.links), dtype=bool),
        free=np.ones(len(hand.hand.joint_names), dtype=bool),
        prior=wrist_prior(observation, wrist_config),
        point_information=config.point_information,
        joint_damping=config.joint_damping,
    )
    widths = np.geomspace(config.first_width, config.last_width, config.iterations)
    q, poses = fit.refine(starts, np.repeat(T[None], len(starts), 0), widths)
    q, T = search.best_combination(q, poses, palm)
    refined, poses = fit.refine(q[None], T[None], np.full(4, config.last_width))
    support = search.link_support(refined[0], poses[0], palm)
    return make_state(hand, refined[0], poses[0], support > config.certain_support)


def make_state(
    hand: PackedHand, q: Array, T_camera_hand: Array, certain: NDArray[np.bool_] | None = None
) -> HandState:
    """The hand state at joint vector `q` (n,) and a wrist pose (4, 4)."""
    poses = hand.link_poses(q[None], T_camera_hand[None])[0]
    if certain is None:
        certain = np.ones(len(poses), dtype=bool)
    return HandState(q, T_camera_hand, poses, certain)


def _starts(alternatives: list[Array], hand: PackedHand) -> Array:
    """The best of every finger, and each other alternative of one finger with the others' best."""
    best = np.clip(np.zeros(len(hand.hand.joint_names)), hand.hand.lower, hand.hand.upper)
    for finger, found in zip(hand.hand.fingers, alternatives, strict=True):
        best[list(finger.joints)] = found[0]
    starts = [best]
    for finger, found in zip(hand.hand.fingers, alternatives, strict=True):
        for other in found[1:]:
            start = best.copy()
            start[list(finger.joints)] = other
            starts.append(start)
    return np.stack(starts)


class _FingerSearch:
    """Scores configurations of single fingers against the image."""

    def __init__(self, observation: Observation, hand: PackedHand, config: HandStateConfig) -> None:
        self.observation, self.hand, self.config = observation, hand, config
        self.view = depth_view(observation)

    def alternatives(
        self, finger: Finger, T_camera_hand: Array, palm: Any, rng: np.random.Generator
    ) -> Array:
        """The best distinct configurations of a finger, best first, shape (k, finger's joints)."""
        config, hand = self.config, self.hand.hand
        joints = list(finger.joints)
        lower, upper = hand.lower[joints], hand.upper[joints]
        sampler = qmc.Sobol(len(joints), seed=rng)
        tried = lower + sampler.random_base2(int(np.log2(config.samples))) * (upper - lower)
        score = self.score(finger, tried, T_camera_hand, palm, config.coarse_tolerance)
        centres = _distinct(tried, score, config.distinct_angle, config.alternatives)
        around = centres[:, None] + rng.normal(
            0, config.local_spread, (len(centres), config.local_samples, len(joints))
        )
        around[:, 0] = centres
        around = np.clip(around, lower, upper)
        score = self.score(
            finger, around.reshape(-1, len(joints)), T_camera_hand, palm, config.fine_tolerance
        ).reshape(len(centres), -1)
        best = around[np.arange(len(centres)), score.argmax(axis=1)]
        return best[np.argsort(-score.max(axis=1))]

    def score(
        self, finger: Finger, tried: Array, T_camera_hand: Array, palm: Any, tolerance: float
    ) -> Array:
        """Visibility score, shape (c,), of configurations of one finger, (c, finger's joints)."""
        hand = self.hand.hand
        q = np.repeat(np.clip(np.zeros((1, len(hand.lower))), hand.lower, hand.upper), len(tried), 0)
        q[:, list(finger.joints)] = tried
        return self._score(finger.links, q, np.repeat(T_camera_hand[None], len(q), 0), palm, tolerance)[0]

    def best_combination(
        self, q: Array, T_camera_hand: Array, palm: Any
    ) -> tuple[Array, Array]:
        """Every finger's best joints among refined starts (s, n), and the wrist of the best start."""
        combined, total = q[0].copy(), np.zeros(len(q))
        for finger in self.hand.hand.fingers:
            score = self._score(finger.links, q, T_camera_hand, palm, self.config.fine_tolerance)[0]
            joints = list(finger.joints)
            combined[joints] = q[score.argmax()][joints]
            total += score
        return combined, T_camera_hand[total.argmax()]

    def link_support(self, q: Array, T_camera_hand: Array, palm: Any) -> Array:
        """Score of every link per share of it that nothing hides, shape (L,); 1 for palm links."""
        support = np.ones(len(self.hand.hand.links))
        for finger in self.hand.hand.fingers:
            for link in finger.links:
                score, seen = self._score(
                    (link,), q[None], T_camera_hand[None], palm, self.config.fine_tolerance
                )
                support[link] = score[0] / max(float(seen[0]), self.config.min_seen)
        return support

    def _score(
        self, links: tuple[int, ...], q: Array, T_camera_hand: Array, palm: Any, tolerance: float
    ) -> tuple[Array, Array]:
        """Visibility score of some links and the share of them that nothing hides, (c,) each."""
        hand, device, config = self.hand, self.hand.device, self.config
        rule = Visibility()
        rule.tolerance, rule.violation = tolerance, config.violation
        rule.missing, rule.hidden = config.missing, config.hidden
        ranges = [np.arange(*hand.point_start[[i, i + 1]]) for i in links]
        samples = wp.array(np.concatenate(ranges), dtype=int, device=device)
        poses = device_poses(hand.link_poses(q, T_camera_hand), device)
        score = wp.empty(len(q), dtype=float, device=device)
        seen = wp.empty(len(q), dtype=float, device=device)
        launch(
            score_configurations,
            len(q),
            [self.view, rule, poses, len(hand.hand.links), hand.points, hand.normals, hand.link]
            + [samples, palm, PALM_STEP, score, seen],
            device,
            work_per_item=len(samples),
        )
        return score.numpy().astype(np.float64), seen.numpy().astype(np.float64)

    def render_palm(self, T_camera_hand: Array) -> Any:
        """Depth of the palm alone [m], on the device."""
        hand = self.hand.hand
        rest = np.clip(np.zeros((1, len(hand.lower))), hand.lower, hand.upper)
        poses = self.hand.link_poses(rest, T_camera_hand[None])[0]
        moving = np.ones(len(poses), dtype=bool)
        moving[list(hand.palm_links)] = False
        # A link that moves is put behind the camera, where no ray meets it.
        poses[moving, 2, 3] = -10.0
        coarse = self.observation.camera.subsampled(PALM_STEP)
        return self.hand.renderer.render_on_device(coarse, poses)[0]


def _distinct(tried: Array, score: Array, angle: float, keep: int) -> Array:
    """The best configurations that differ by `angle` in some joint, best first."""
    chosen: list[Array] = []
    order = np.argsort(-score)
    left = tried[order]
    while len(left) and len(chosen) < keep:
        chosen.append(left[0])
        left = left[np.abs(left - left[0]).max(axis=1) > angle]
    return np.stack(chosen)
