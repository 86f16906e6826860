"""The cloud that a registration method is given: the hand's whole region, what is left of it
without the hand, or the object's true pixels."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from inhand.baselines.method import View
from inhand.config import EstimatorConfig
from inhand.errors import InputError, NoAnswer
from inhand.estimator import StageResults, check_depth, check_wrist
from inhand.packed import PackedHand, PackedObject
from inhand.stages.hand_state import estimate_hand_state
from inhand.stages.observation import Cloud, Observation, observe
from inhand.stages.segmentation import segment_object
from inhand.stages.wrist import fit_wrist

Result = TypeVar("Result")

Source = Literal["region", "hs", "mask"]
"""`region`: everything in reach of the hand; `hs`: the hand removed with its estimated state;
`mask`: the object's true pixels, an upper bound."""


@dataclass(frozen=True)
class Stopwatch:
    """Seconds by stage."""

    seconds: dict[str, float] = field(default_factory=dict)

    def time(self, stage: str, function: Callable[..., Result], *args: Any) -> Result:
        """What the function returns; how long it took is noted under `stage`."""
        start = time.perf_counter()
        try:
            return function(*args)
        finally:
            self.seconds[stage] = time.perf_counter() - start


def object_cloud(
    view: View,
    source: Source,
    hand: PackedHand,
    obj: PackedObject,
    config: EstimatorConfig,
    watch: Stopwatch,
) -> tuple[Cloud, StageResults]:
    """Points to register the object with, and the results of the estimator's stages behind them.

    Raises:
        NoAnswer: too few points.
        InputError: the view is malformed, or lacks the mask.
    """
    depth, T_camera_hand = check_depth(view.depth, view.camera), check_wrist(view.T_camera_hand)
    reach, diameter = hand.hand.reach, obj.model.diameter
    observation = watch.time(
        "observation", observe, depth, view.camera, T_camera_hand, reach, diameter,
        config.observation, obj.device,
    )  # fmt: skip
    results = StageResults(observation=observation)
    if source == "region":
        return Cloud(observation.points, observation.normals), results
    if source == "mask":
        if view.true_mask is None:
            raise InputError("the method needs the object's true mask, which this frame lacks")
        return masked_cloud(observation, view.true_mask, config), results
    rng = np.random.default_rng(config.seed)
    wrist = watch.time("wrist", fit_wrist, observation, hand, config.wrist, config.hand_state, rng)
    state = watch.time(
        "hand_state", estimate_hand_state, observation, wrist, hand, config.hand_state,
        config.wrist, rng,
    )  # fmt: skip
    segment = watch.time(
        "segmentation", segment_object, observation, state, hand, diameter, config.segmentation
    )
    results = StageResults(observation, wrist, state, segment)
    return Cloud(segment.points, segment.normals), results


def masked_cloud(
    observation: Observation, mask: NDArray[np.bool_], config: EstimatorConfig
) -> Cloud:
    """The scene points whose pixels the mask (H, W) names; of few points, those of every pixel.

    Raises:
        NoAnswer: there are hardly any.
    """
    segmentation = config.segmentation
    cloud = _masked(Cloud(observation.points, observation.normals), observation, mask)
    if len(cloud.points) < segmentation.dense_below:
        cloud = _masked(observation.cloud(step=1), observation, mask)
    if len(cloud.points) < segmentation.min_points:
        raise NoAnswer(f"only {len(cloud.points)} depth readings show the object")
    return cloud


def _masked(cloud: Cloud, observation: Observation, mask: NDArray[np.bool_]) -> Cloud:
    pixels = np.rint(observation.camera.project(cloud.points)).astype(int)
    u, v = (pixels + observation.offset).T
    shown = mask[v, u]
    return Cloud(cloud.points[shown], cloud.normals[shown])
