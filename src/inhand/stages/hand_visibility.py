"""How well posed links of the hand agree with what the camera sees of them."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter

from inhand.config import EvidenceConfig, HandStateConfig
from inhand.kernels.hand_fit import SupportSums, Visibility, link_support, score_configurations
from inhand.kernels.launch import computed, filled, on_device, pack
from inhand.packed import PackedHand, PackedPart, device_poses
from inhand.stages.observation import Observation

Array = NDArray[np.float64]


class Scores(NamedTuple):
    """Of hand states, shape (c,) each."""

    strict: Array
    """Visibility scores."""
    seen: Array
    """Shares of the part that nothing hides."""
    lenient: Array
    """Scores without penalties for what an error of the wrist may explain."""


class HandVisibility:
    """Scores hand states against the image.

    Args:
        observation: the image.
        hand: the hand.
        config: parameters.
    """

    def __init__(self, observation: Observation, hand: PackedHand, config: HandStateConfig) -> None:
        self._config = config
        self._view = observation.view
        self._noise = config.noise_tolerance * observation.noise
        coarse = observation.camera.subsampled(config.render_step)
        nothing = np.zeros(coarse.width * coarse.height, dtype=np.float32)
        self._nothing = on_device(nothing, float, hand.device)

    def score(
        self,
        part: PackedPart,
        q: Array,
        T_camera_hand: Array,
        others: Any = None,
        tolerance: float | None = None,
        points: int | None = None,
        nearest: Any = None,
    ) -> Scores:
        """Visibility scores of a part.

        Args:
            part: the links that are scored.
            q: positions of the joints that move them [rad, m], shape (c, k).
            T_camera_hand: wrist poses, shape (c, 4, 4), or (1, 4, 4) for all.
            others: rendered depth [m] of other parts of the hand, on the device, at every
                `render_step`-th pixel; what they hide or explain does not count.
            tolerance: depth agreement [m], by default the fine one; more if the image is noisy.
            points: surface samples of every link that are used at most.
            nearest: result of `nearest_around` at that step, on the device: what is looked through
                beside something as near counts in strict scores only.
        """
        config = self._config
        rule = visibility_rule(config, max(tolerance or config.fine_tolerance, self._noise))
        samples = int(np.minimum(part.counts, points or part.counts).sum())
        inputs = [self._view, rule, part.pose(q, T_camera_hand), len(part.links), part.points]
        inputs += [part.normals, part.link, samples, config.early_points]
        inputs += [config.hopeless, self._nothing if others is None else others, config.render_step]
        inputs += [self._nothing if nearest is None else nearest]
        shape, work = (len(q),), 2 * samples
        kernel, device = score_configurations, part.device
        scores = computed(kernel, shape, wp.vec3, inputs, device, work_per_item=work, shared=True)
        return Scores(*scores.T.astype(np.float64))


def nearest_around(observation: Observation, distance: float, step: int) -> NDArray[np.float32]:
    """Least depth [m] of the readings up to `distance` [m] beside every `step`-th pixel, flat, inf
    where there are none.

    The distance is that at the middle of the region of interest, in whole steps.
    """
    depth = np.where(observation.depth > 0, observation.depth, np.float32(np.inf))
    for _ in range(2):  # rows, then columns
        least = depth[::step].copy()
        for k in range(1, step):
            more = depth[k::step]
            np.minimum(least[: len(more)], more, out=least[: len(more)])
        depth = least.T
    radius = round(distance * observation.camera.fx / observation.sphere[0][2] / step)
    return np.ascontiguousarray(minimum_filter(depth, 2 * radius + 1)).reshape(-1)


@dataclass(frozen=True)
class Support:
    """Scores per share of the surface that nothing hides."""

    links: Array
    """Of every link, shape (L,), without what another finger or the palm explains as well."""
    whole: float
    """Of the whole hand, with less weight on what contradicts its fingers, and on what has no
    readings."""


def hand_support(
    observation: Observation,
    hand: PackedHand,
    T_camera_link: NDArray[np.floating[Any]],
    config: HandStateConfig,
) -> Support:
    """How well the image supports every link of a posed hand, and all of it.

    Args:
        observation: the image.
        hand: the hand.
        T_camera_link: poses of the links, shape (L, 4, 4).
        config: parameters.
    """
    device, count = hand.device, len(hand.hand.links)
    noise = config.noise_tolerance * observation.noise
    rule = visibility_rule(config, max(config.fine_tolerance, noise))
    start = on_device(hand.point_start, int, device)
    coarse = observation.camera.subsampled(config.render_step)
    shown = filled((coarse.width * coarse.height,), -1, int, device)
    depth = hand.render(coarse, T_camera_link, np.ones(count, dtype=bool), link=shown)
    inputs = [observation.view, rule, device_poses(T_camera_link, device), hand.points]
    inputs += [hand.normals, start, config.fine_points, hand.fields, hand.apart]
    inputs += [depth, shown, config.render_step]
    kernel, shape, work = link_support, (count,), 15 * config.fine_points
    sums = computed(kernel, shape, SupportSums, inputs, device, work_per_item=work, shared=True)
    area, score, seen, other_score, other_seen, missing = sums.astype(np.float64).T
    least = config.min_seen * area
    together = score + other_score - (1 - config.missing_blame) * missing
    blamed = np.where((together < 0) & ~hand.is_palm, config.finger_blame, 1.0) * together
    whole = blamed.sum() / max((seen + other_seen).sum(), least.sum())
    return Support(score / np.maximum(seen, least), float(whole))


def visibility_rule(config: HandStateConfig | EvidenceConfig, tolerance: float) -> Any:
    """How surface points are judged, for kernels; the tolerance in [m]."""
    c = config
    return _rule(tolerance=tolerance, violation=c.violation, missing=c.missing, hidden=c.hidden)


@lru_cache(32)
def _rule(**members: float) -> Any:
    return pack(Visibility, "cpu", **members)
