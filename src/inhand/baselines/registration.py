"""Methods that register the object's model with a cloud of points."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from inhand.baselines.front_end import Source, Stopwatch, object_cloud
from inhand.baselines.icp import rank, refine_by_icp
from inhand.baselines.method import Method, PreparedMethod, View
from inhand.config import EstimatorConfig
from inhand.errors import NoAnswer
from inhand.estimate import Candidate, PoseEstimate
from inhand.estimator import StageResults
from inhand.hand import Hand
from inhand.object_model import ObjectModel
from inhand.packed import PackedHand, PackedObject
from inhand.stages.observation import Cloud
from inhand.stages.results import PoseSet, Selection


class Registration(ABC):
    """Finds where one object's model lies in a cloud."""

    @abstractmethod
    def align(self, cloud: Cloud, view: View) -> NDArray[np.float64]:
        """T_camera_object of one or a few poses, shape (m, 4, 4).

        Args:
            cloud: oriented points, some or all of them on the object.
            view: the image they are from.

        Raises:
            NoAnswer: no pose was found.
        """


@dataclass(frozen=True)
class CloudMethod(Method):
    """A registration of the model with one kind of cloud."""

    name: str
    make_registration: Callable[[PackedObject, int], Registration]
    """From an object and a seed; raises InputError when a library is not installed."""
    source: Source
    icp: bool
    """Whether point-to-plane ICP refines the poses."""
    seed: int = 0
    perturbation: Mapping[str, float] = field(default_factory=dict)

    def prepare(self, hand: Hand, obj: ObjectModel, device: str) -> PreparedMethod:
        """Make the registration of the object."""
        packed = PackedObject(obj, device)
        registration = self.make_registration(packed, self.seed)
        return _Prepared(self, registration, PackedHand(hand, device), packed)


class _Prepared(PreparedMethod):
    def __init__(
        self, method: CloudMethod, registration: Registration, hand: PackedHand, obj: PackedObject
    ) -> None:
        self._method, self._registration, self._hand, self._obj = method, registration, hand, obj
        # The best hand state there is: what is compared is the registration.
        self._config = replace(EstimatorConfig(), seed=method.seed)

    def run(self, view: View) -> tuple[PoseEstimate, StageResults | None]:
        watch, results = Stopwatch(), StageResults()
        try:
            cloud, results = object_cloud(
                view, self._method.source, self._hand, self._obj, self._config, watch
            )
            results = self._register(cloud, view, results, watch)
            reason = ""
        except NoAnswer as problem:
            reason = str(problem)
        estimate = self._estimate(results, reason, watch)
        # Without a hand state most stages are missing, and none can be blamed.
        return estimate, results if self._method.source == "hs" else None

    def _register(
        self, cloud: Cloud, view: View, results: StageResults, watch: Stopwatch
    ) -> StageResults:
        """The results completed by what the registration and ICP found."""
        poses = watch.time("registration", self._registration.align, cloud, view)
        coarse = rank(poses, cloud, self._obj)
        fine = coarse
        if self._method.icp:
            refined = watch.time("icp", refine_by_icp, poses, cloud, self._obj)
            fine = rank(refined, cloud, self._obj)
        state = results.hand_state
        return replace(
            results,
            hypotheses=coarse,
            clustered=coarse,
            refined=fine,
            pruned=fine,
            selection=Selection(
                fine, float(fine.score[0]), state.joint_vector if state else np.zeros(0)
            ),
        )

    def _estimate(self, results: StageResults, reason: str, watch: Stopwatch) -> PoseEstimate:
        state, selection = results.hand_state, results.selection
        candidates = () if selection is None else _candidates(selection.poses)
        return PoseEstimate(
            found=selection is not None,
            reason=reason,
            T_camera_object=candidates[0].T_camera_object if candidates else None,
            joint_positions=self._hand.hand.joint_dict(state.joint_vector) if state else {},
            T_camera_hand=state.T_camera_hand if state else None,
            confidence=selection.confidence if selection else 0.0,
            candidates=candidates,
            timings=watch.seconds,
        )


def _candidates(poses: PoseSet) -> tuple[Candidate, ...]:
    return tuple(
        Candidate(T.astype(np.float64), {"lcp": float(score)})
        for T, score in zip(poses.T_camera_object, poses.score, strict=True)
    )
