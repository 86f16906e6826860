"""Generation of object poses (paper, section IV-B)."""

import math
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.config import HypothesesConfig
from inhand.errors import NoAnswer
from inhand.kernels.launch import empty, launch, on_device, on_host
from inhand.kernels.pair_matching import match_pairs
from inhand.packed import PackedObject
from inhand.stages.congruent_sets import generate_from_congruent_sets
from inhand.stages.evidence import Evidence, score_with_contact
from inhand.stages.results import PoseSet, Segment

PART = 32
"""Every so-many-th pose tells what the best ones will score."""


def generate_hypotheses(
    segment: Segment,
    evidence: Evidence,
    obj: PackedObject,
    config: HypothesesConfig,
    rng: np.random.Generator,
) -> PoseSet:
    """Object poses that lay parts of the model onto the segment, scored.

    The paper samples 4-point bases and looks for congruent sets (Alg. 2). By default pairs of
    oriented points are matched instead (Drost et al., "Model Globally, Match Locally", 2010), and
    every pose is scored against the image.

    Raises:
        NoAnswer: nothing on the segment matches the model.
    """
    if config.method == "congruent_sets":
        return generate_from_congruent_sets(segment, obj, config, rng)
    device, matches = obj.device, config.matches
    pairs = _sample_pairs(segment, obj, config, rng)
    drawn: Any = empty((len(pairs[0]) * matches,), wp.mat44, device)
    inputs = [on_device(x, wp.vec3, device) for x in (segment.points, segment.normals)]
    inputs += [on_device(index, int, device) for index in pairs]
    inputs += [obj.pairs, matches, int(rng.integers(2**31)), drawn]
    launch(match_pairs, len(pairs[0]), inputs, device, work_per_item=25 * matches)
    poses = on_host(drawn)
    poses = poses[poses[:, 3, 3] > 0]  # an empty draw is a zero matrix
    if not len(poses):
        raise NoAnswer("no part of the object segment matches the object's shape")
    return _best(poses, evidence, obj, config)


def _best(
    poses: NDArray[np.float32], evidence: Evidence, obj: PackedObject, config: HypothesesConfig
) -> PoseSet:
    """The best `keep` of the poses.

    A part of them tells what the worst of these will score; what is certain to score less is left
    on the way there.
    """
    part = score_with_contact(evidence, obj, poses[::PART], config)
    expected = config.keep / PART
    enough = int(expected + 2 * math.sqrt(expected))
    worth = float(np.sort(part)[-enough]) if enough < len(part) else -np.inf
    scores = score_with_contact(evidence, obj, poses, config, worth)
    n = min(config.keep, len(poses))
    best = np.argpartition(-scores, n - 1)[:n]
    return PoseSet(poses[best], scores[best])


def _sample_pairs(
    segment: Segment, obj: PackedObject, config: HypothesesConfig, rng: np.random.Generator
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Pairs of segment points that lie on the object with high probability and not too close."""
    heuristic = 1 - np.exp(-config.heuristic_decay * np.maximum(segment.hand_distance, 0))
    probability = segment.weight * heuristic + 1e-6
    probability /= probability.sum()
    # Wide pairs fix a pose better: of several partners the one nearest the wanted width is taken.
    n, tries = config.pairs, config.partner_tries
    a = rng.choice(len(segment.points), size=n, p=probability)
    b = rng.choice(len(segment.points), size=(n, tries), p=probability)
    width = np.linalg.norm(segment.points[a][:, None] - segment.points[b], axis=2)
    diameter = obj.model.diameter
    wanted = rng.uniform(config.min_width, config.max_width, size=(n, 1)) * diameter
    cost = np.abs(width - wanted) + np.where(width > diameter, 10.0, 0.0)
    best = cost.argmin(axis=1)
    b = b[np.arange(n), best]
    usable = (width[np.arange(n), best] < diameter) & (a != b)
    return a[usable].astype(np.int32), b[usable].astype(np.int32)
