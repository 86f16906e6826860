"""The pipeline: the stages in order."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.random import Generator, default_rng
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.checks import number_array, whole_number
from inhand.config import EstimatorConfig
from inhand.errors import InputError, NoAnswer
from inhand.estimate import Candidate, PoseEstimate
from inhand.geometry.se3 import check_rigid
from inhand.hand import Hand
from inhand.kernels.launch import keep_launches_whole, on_all_cores, resolve_device
from inhand.object_model import ObjectModel
from inhand.packed import PackedHand, PackedObject
from inhand.processes import WorkerPool
from inhand.stages.clustering import cluster
from inhand.stages.evidence import Evidence, gather_evidence
from inhand.stages.hand_state import estimate_hand_state
from inhand.stages.hypotheses import generate_hypotheses
from inhand.stages.observation import Observation, observe
from inhand.stages.pruning import prune
from inhand.stages.refinement import refine
from inhand.stages.results import HandState, PoseSet, Segment, Selection, Wrist
from inhand.stages.second_look import doubted, hands_in_segment, with_missed_fingers
from inhand.stages.segmentation import segment_object
from inhand.stages.selection import select
from inhand.stages.wrist import fit_wrist

Result = TypeVar("Result")

FARTHEST = 50.0
"""Depths and wrists beyond this are no metres [m]."""


class Clock:
    """Measures the stages."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def time(self, stage: str, function: Callable[..., Result], *args: Any) -> Result:
        """What `function` returns; its time is noted."""
        start = time.perf_counter()
        try:
            return function(*args)
        finally:
            taken = time.perf_counter() - start
            self.seconds[stage] = self.seconds.get(stage, 0.0) + taken


@dataclass(frozen=True)
class StageResults:
    """What every stage returned; None for a stage that was not reached.

    Fingers that were found when the object was known are in `hand_state` and `selection` alone.
    """

    observation: Observation | None = None
    wrist: Wrist | None = None
    hand_state: HandState | None = None
    segment: Segment | None = None
    hypotheses: PoseSet | None = None
    clustered: PoseSet | None = None
    refined: PoseSet | None = None
    pruned: PoseSet | None = None
    selection: Selection | None = None

    @property
    def confidence(self) -> float:
        """Confidence of the selected pose, 0 without one."""
        return self.selection.confidence if self.selection else 0.0


class PoseEstimator:
    """Estimates the pose of a known object in a known hand from single depth images.

    Args:
        hand: the hand.
        obj: the object.
        config: parameters; `EstimatorConfig.paper()` is the paper's method.
        device: "cpu", "cuda:0", or None for the best there is.

    Raises:
        InputError: an argument is of the wrong kind, or the device does not exist.
    """

    def __init__(
        self,
        hand: Hand,
        obj: ObjectModel,
        config: EstimatorConfig | None = None,
        device: str | None = None,
    ) -> None:
        self.config = EstimatorConfig() if config is None else config
        for value, kind, name in (
            (hand, Hand, "hand"),
            (obj, ObjectModel, "obj"),
            (self.config, EstimatorConfig, "config"),
        ):
            if not isinstance(value, kind):
                raise InputError(f"{name} must be an inhand.{kind.__name__}, got {value!r:.80}")
        self.device = resolve_device(device)
        self.hand = PackedHand(hand, self.device)
        self.object = PackedObject(obj, self.device)
        self._workers: WorkerPool[Any, PoseEstimate] | None = None

    def estimate(self, depth: Any, camera: Camera, T_camera_hand: Any) -> PoseEstimate:
        """Pose of the object and state of the hand in one depth image.

        Args:
            depth: z [m], floating point, shape (H, W); 0, NaN and inf mean "no reading".
            camera: the camera of the image.
            T_camera_hand: approximate pose of the hand's root link in the camera, (4, 4).

        Raises:
            InputError: the input is malformed. An image without an answer is no error: see
                `PoseEstimate.found`.
        """
        return self.run(depth, camera, T_camera_hand)[0]

    def estimate_batch(
        self, images: Iterable[tuple[Any, Camera, Any]], workers: int = 1
    ) -> list[PoseEstimate]:
        """Estimates of many images, the same as by `estimate`, in less time altogether.

        Args:
            images: depth, camera and T_camera_hand of each, as for `estimate`.
            workers: processes to share the work; as many as cores for the most images a second.
                They take seconds to start, and then wait for the next batch. A script that starts
                some needs `if __name__ == "__main__":`, as they import it. With 1, threads of this
                process share the work, if on a CPU; no more than a few can be busy at a time.

        Raises:
            InputError: the input of an image is malformed, or a process died.
        """
        workers = whole_number(workers, "workers", 1)
        if workers == 1:
            return on_all_cores(lambda image: self.estimate(*image), images, self.device)
        if self._workers is None or self._workers.count != workers:
            if self._workers is not None:
                self._workers.close()
            parts = self.hand.hand, self.object.model, self.config, self.device
            self._workers = WorkerPool(partial(_worker_estimate, *parts), workers)
        try:
            return list(self._workers.map(images))
        except BrokenProcessPool as error:
            self._workers = None
            raise InputError(
                "a worker process died; see what it printed. If for want of memory, try fewer "
                "workers. It imports the main script, which must start nothing then: put what that "
                'does under `if __name__ == "__main__":`'
            ) from error

    def run(
        self, depth: Any, camera: Camera, T_camera_hand: Any
    ) -> tuple[PoseEstimate, StageResults]:
        """As `estimate`, with what every stage returned (for diagnosis)."""
        image = check_depth(depth, camera)
        T = check_wrist(T_camera_hand)
        clock = Clock()
        results = StageResults()
        try:
            for reached in self._stages(image, camera, T, clock):
                results = reached
        except NoAnswer as problem:
            return self._no_answer(str(problem), results, clock), results
        return self._answer(results, clock), results

    def _stages(
        self, depth: NDArray[np.float32], camera: Camera, T: Any, clock: Clock
    ) -> Iterator[StageResults]:
        """Run the stages one after the other, yielding the results so far after each."""
        c, hand, obj, r = self.config, self.hand, self.object, StageResults()
        rng = default_rng(c.seed)
        diameter, reach = obj.model.diameter, hand.hand.reach

        observation = clock.time(
            "observation", observe, depth, camera, T, reach, diameter, c.observation, self.device
        )
        yield (r := replace(r, observation=observation))

        wrist = clock.time("wrist", fit_wrist, observation, hand, c.wrist, c.hand_state, rng)
        yield (r := replace(r, wrist=wrist))

        state = clock.time(
            "hand_state", estimate_hand_state, observation, wrist, hand, c.hand_state, c.wrist, rng
        )
        yield (r := replace(r, hand_state=state))

        best, searches = r, (c,) if c.first_look.enough == 1 else (c.quick, c)
        for reached in self._object_stages(r, clock, rng, searches):
            yield (best := reached)
        with_hand = partial(self._with_hand, r, clock, rng, searches[:1])
        yield from self._second_looks(best, with_hand, clock)

    def _second_looks(
        self, best: StageResults, with_hand: Callable[[HandState], StageResults], clock: Clock
    ) -> Iterator[StageResults]:
        """What further looks make of the `best` results, as `_stages`: those of other hands if they
        are surer, a doubt, fingers that were missed.

        `with_hand`: the object stages' results with another hand.
        """
        c, hand, obj, observation = self.config, self.hand, self.object, best.observation
        if best.segment is not None and best.confidence < c.second_look.below:
            for other in clock.time(
                "second_look", hands_in_segment, observation, best.hand_state, best.segment, hand, c
            ):
                again = with_hand(other)
                if again.confidence > best.confidence:
                    yield (best := again)
        yield (best := self._doubted(best, clock))

        for _ in hand.fingers if c.second_look.left_explained < 1 else []:
            if best.selection is None:
                return
            answer = observation, best.hand_state, best.selection, best.segment
            fuller = clock.time("missed_fingers", with_missed_fingers, *answer, hand, obj, c)
            if fuller is None:
                return
            selection = replace(best.selection, joint_vector=fuller.joint_vector)
            if best.confidence < c.second_look.doubt_below:
                again = self._doubted(with_hand(fuller), clock)
                if again.confidence > best.confidence:
                    yield (best := again)
                    continue
            yield replace(best, hand_state=fuller, selection=selection)
            return

    def _with_hand(
        self,
        r: StageResults,
        clock: Clock,
        rng: Generator,
        searches: Sequence[EstimatorConfig],
        hand_state: HandState,
    ) -> StageResults:
        """The object stages' results with another hand than that of `r`, as far as they come."""
        r = replace(r, hand_state=hand_state)
        with suppress(NoAnswer):
            for reached in self._object_stages(r, clock, rng, searches):
                r = reached
        return r

    def _doubted(self, r: StageResults, clock: Clock) -> StageResults:
        """Results that are less sure if a finger may have been missed."""
        c = self.config.second_look
        if r.selection is None or r.confidence >= c.doubt_below:
            return r
        doubts = r.selection, r.hand_state, r.segment, self.hand, c
        return replace(r, selection=clock.time("second_look", doubted, *doubts))

    def _object_stages(
        self, r: StageResults, clock: Clock, rng: Generator, searches: Sequence[EstimatorConfig]
    ) -> Iterator[StageResults]:
        """The stages that follow the hand's, as `_stages`; one search after the other until the
        answer is sure."""
        c, hand, diameter = self.config, self.hand, self.object.model.diameter
        observation, state = r.observation, r.hand_state
        segment = clock.time(
            "segmentation", segment_object, observation, state, hand, diameter, c.segmentation
        )
        evidence = clock.time(
            "evidence", gather_evidence, observation, state, segment, hand, c.evidence
        )
        yield (r := replace(r, segment=segment))

        first = r
        for search in searches[:-1]:
            with suppress(NoAnswer):
                for first in self._pose_stages(r, evidence, search, clock, rng):
                    yield first
            if first.confidence >= c.first_look.enough:
                return
        yield from self._pose_stages(r, evidence, searches[-1], clock, rng)

    def _pose_stages(
        self, r: StageResults, evidence: Evidence, c: EstimatorConfig, clock: Clock, rng: Generator
    ) -> Iterator[StageResults]:
        """The stages from hypotheses to selection, as `_stages`."""
        hand, obj, state, segment = self.hand, self.object, r.hand_state, r.segment

        hypotheses = clock.time(
            "hypotheses", generate_hypotheses, segment, evidence, obj, c.hypotheses, rng
        )
        yield (r := replace(r, hypotheses=hypotheses))

        clustered = clock.time("clustering", cluster, hypotheses, evidence, obj, c.clustering)
        yield (r := replace(r, clustered=clustered))

        refined = clock.time("refinement", refine, clustered, segment, evidence, obj, c.refinement)
        yield (r := replace(r, refined=refined))

        pruned = clock.time("pruning", prune, refined, state, hand, obj, c.pruning)
        yield (r := replace(r, pruned=pruned))

        selection = clock.time(
            "selection", select, pruned, r.observation, state, segment, evidence, hand, obj,
            c.selection,
        )  # fmt: skip
        yield replace(r, selection=selection)

    def _answer(self, results: StageResults, clock: Clock) -> PoseEstimate:
        selection, state = results.selection, results.hand_state
        if selection is None or state is None or not len(selection.poses):
            return self._no_answer("no pose of the object agrees with the image", results, clock)
        candidates = tuple(
            Candidate(np.asarray(T, dtype=np.float64), {"score": float(s)})
            for T, s in zip(selection.T_camera_object, selection.score, strict=True)
        )
        return PoseEstimate(
            found=True,
            reason="",
            T_camera_object=candidates[0].T_camera_object,
            joint_positions=self.hand.hand.joint_dict(selection.joint_vector),
            T_camera_hand=state.T_camera_hand,
            confidence=selection.confidence,
            candidates=candidates,
            timings=clock.seconds,
        )

    def _no_answer(self, reason: str, results: StageResults, clock: Clock) -> PoseEstimate:
        state = results.hand_state
        return PoseEstimate(
            found=False,
            reason=reason,
            T_camera_object=None,
            joint_positions=self.hand.hand.joint_dict(state.joint_vector) if state else {},
            T_camera_hand=state.T_camera_hand if state else None,
            confidence=0.0,
            timings=clock.seconds,
        )


def _worker_estimate(
    hand: Hand, obj: ObjectModel, config: EstimatorConfig, device: str
) -> Callable[[tuple[Any, Camera, Any]], PoseEstimate]:
    """What a worker process estimates an image with."""
    keep_launches_whole()
    estimator = PoseEstimator(hand, obj, config, device)
    return lambda image: estimator.estimate(*image)


def check_depth(depth: Any, camera: Camera) -> NDArray[np.float32]:
    """`depth` as a float32 image [m] of the camera's size.

    Raises:
        InputError: it is not a floating-point image of that size, or is not in metres.
    """
    if not isinstance(camera, Camera):
        raise InputError(f"camera must be an inhand.Camera, got {type(camera).__name__}")
    if isinstance(depth, np.ma.MaskedArray):
        depth = depth.filled(0)
    image = number_array(depth, "depth", "a floating-point image in metres")
    if image.ndim != 2:
        raise InputError(f"depth must be an image of shape (H, W), got shape {image.shape}")
    if image.dtype.kind in "iu":
        raise InputError(
            f"depth must be floating point in metres, got {image.dtype}; "
            "multiply the counts by the camera's depth unit (0.001 for millimetres)"
        )
    if image.shape != (camera.height, camera.width):
        raise InputError(
            f"depth is {image.shape[1]} x {image.shape[0]} pixels but the camera "
            f"{camera.width} x {camera.height}; scale the intrinsics with the image"
        )
    # Two passes tell that nothing is odd; looking at each reading takes ten times as long.
    if np.fmin.reduce(image, axis=None) < 0 or np.fmax.reduce(image, axis=None) > FARTHEST:
        _check_readings(image[np.isfinite(image) & (image != 0)])
    with np.errstate(over="ignore"):  # becomes inf, no reading
        return image.astype(np.float32)


def _check_readings(depth: NDArray[Any]) -> None:
    """Check that readings, shape (n,), are metres in front of the camera.

    Raises:
        InputError: some are negative, or half of them farther than any sensor sees.
    """
    if (depth < 0).any():
        raise InputError("depth holds negative numbers; z points away from the camera")
    if 2 * np.count_nonzero(depth > FARTHEST) > len(depth):
        raise InputError(
            f"the median depth is {np.median(depth):.4g} m: the image seems to be in "
            "millimetres; multiply it by 0.001"
        )


def check_wrist(T_camera_hand: Any) -> NDArray[np.float64]:
    """`T_camera_hand` as a (4, 4) matrix.

    Raises:
        InputError: it is no rigid transform, or not in metres.
    """
    T = check_rigid(T_camera_hand, "T_camera_hand")
    distance = np.abs(T[:3, 3]).max()
    if distance > FARTHEST:
        raise InputError(
            f"T_camera_hand puts the hand {distance:.4g} m from the camera: its translation seems "
            "to be in millimetres; multiply it by 0.001"
        )
    return T
