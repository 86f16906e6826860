"""Snapping: the refinement of a pose, or of finger angles, from where the user has put them.

The refinements are the estimator's. What is added are starts scattered around the user's, for a
hand is not placed to a millimetre by eye, and a leash: what runs away from there is not what the
user meant.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from inhand.annotation.images import RawImage
from inhand.annotation.session import Label
from inhand.config import EstimatorConfig, NonNegative, Real, Section, Seed
from inhand.errors import NoAnswer
from inhand.evaluation.metrics import ObjectMetric
from inhand.evaluation.symmetric_poses import nearest_symmetric
from inhand.geometry.se3 import moved
from inhand.packed import PackedHand, PackedObject
from inhand.stages.articulated_fit import ArticulatedFit, WristPrior
from inhand.stages.clustering import surface_distances_to
from inhand.stages.evidence import Evidence, gather_evidence, score_with_contact
from inhand.stages.finger_search import FingerSearch
from inhand.stages.hand_visibility import hand_support
from inhand.stages.observation import Observation, observe
from inhand.stages.refinement import fit_to_field
from inhand.stages.results import HandState
from inhand.stages.segmentation import segment_object

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SnapConfig(Section):
    """Refinement from the user's placement."""

    seed: Seed = 0
    """Seed of the scattered starts."""
    starts: int = 200
    """Poses of the object that are refined: the given one and others around it."""
    spread_translation: float = 0.007
    """Standard deviation per axis of these around the given pose [m]."""
    spread_rotation: float = 0.15
    """Standard deviation per axis of these around the given pose [rad]."""
    leash: float = 0.025
    """How far the object's surface may move from where it was given, on average [m]."""
    first_width: float = 0.015
    """Width of the redescending weight in the first iteration [m]."""
    middle_width: float = 0.006
    """Width between the rough and the fine iterations [m]."""
    last_width: float = 0.003
    """Width in the last iteration [m]."""
    rough_points: int = 150
    """Segment points, and model points, in the rough iterations of all poses."""
    rough_iterations: int = 8
    """Rough iterations."""
    keep: int = 10
    """Best poses that go into the fine iterations."""
    fine_points: int = 2000
    """Segment points, and model points, in the fine iterations."""
    fine_iterations: int = 30
    """Fine iterations."""
    least_score: Real = 0.5
    """A pose that scores less at the end is none: the object is not there."""
    hand_starts: int = 24
    """Hand states that are refined: the given one and others around it."""
    hand_iterations: int = 8
    """Iterations of all of them, and of the best once more."""
    spread_joint: float = 0.15
    """Standard deviation of their joints around the given ones [rad, or as `slide_scale`]."""
    idle_way: float = 0.1
    """A finger that moved by more than this in some joint [rad] ..."""
    idle_gain: NonNegative = 0.05
    """... although its visibility score rose by less than this, stays where it was."""
    wrist_translation: float = 0.010
    """Standard deviation per axis of the given wrist pose [m]."""
    wrist_rotation: float = 0.06
    """Standard deviation per axis of the given wrist pose [rad]."""


class Snapper:
    """Refines placements of one hand and object.

    Args:
        hand: the hand.
        obj: the object.
        config: the estimator's parameters.
        snap: parameters of what is added here.
    """

    def __init__(
        self,
        hand: PackedHand,
        obj: PackedObject,
        config: EstimatorConfig | None = None,
        snap: SnapConfig | None = None,
    ) -> None:
        self.hand, self.obj, self.metric = hand, obj, ObjectMetric(obj.model, obj.device)
        self.config = EstimatorConfig() if config is None else config
        self.snap = SnapConfig() if snap is None else snap

    def snap_object(self, raw: RawImage, label: Label) -> Label:
        """The label with the object where the image shows it near its place in the label.

        Of poses that the object's symmetry makes alike, the one nearest to the label's.

        Args:
            raw: the image.
            label: where hand and object are about; the hand is taken as it is.

        Raises:
            NoAnswer: the image shows no object there.
        """
        c, s, given = self.config, self.snap, label.T_camera_object
        evidence = self._evidence(raw, label)
        fit = partial(fit_to_field, evidence, self.obj, c.refinement.image_weight)
        widths = s.first_width, s.middle_width, s.last_width
        rough, _, _ = fit(self._around(given), s.rough_points, s.rough_iterations, widths[:2])
        rough = self._on_the_leash(rough, given)
        scores = score_with_contact(evidence, self.obj, rough, c.refinement)
        best = rough[np.argsort(-scores, kind="stable")[: s.keep]]
        fine, _, _ = fit(best, s.fine_points, s.fine_iterations, widths[1:])
        scores = score_with_contact(evidence, self.obj, fine, c.selection)
        if scores.max() < s.least_score:
            raise NoAnswer("the image does not show the object where it is; move it closer")
        found = orthonormal(np.asarray(fine[scores.argmax()], dtype=np.float64))
        return replace(
            label, T_camera_object=nearest_symmetric(self.obj.model.symmetry, given, found)
        )

    def snap_hand(self, raw: RawImage, label: Label) -> Label:
        """The label with wrist and fingers where the image shows them near their place in it.

        Raises:
            NoAnswer: the image shows nothing there.
        """
        c, s, hand = self.config.hand_state, self.snap, self.hand
        given = hand.hand.joint_vector(label.joint_positions)
        observation = self._observe(raw, label)
        search = FingerSearch(observation, hand, c)
        fit = ArticulatedFit(
            observation,
            hand,
            used=np.ones(len(hand.hand.links), dtype=bool),
            free=np.ones(len(given), dtype=bool),
            prior=WristPrior(label.T_camera_hand, s.wrist_rotation, s.wrist_translation),
            point_information=c.point_information,
            joint_damping=c.joint_damping,
        )
        rng = np.random.default_rng(s.seed)
        offset = rng.normal(0, s.spread_joint, (s.hand_starts, len(given))) * search.scale
        offset[0] = 0.0
        starts = np.clip(given + offset, hand.hand.lower, hand.hand.upper)
        wrists = np.repeat(label.T_camera_hand[None], len(starts), 0)
        widths = np.geomspace(c.first_width, c.middle_width, s.hand_iterations)
        q, T = search.best_combination(*fit.refine(starts, wrists, widths, c.start_stride))
        widths = np.geomspace(c.middle_width, c.last_width, s.hand_iterations)
        q, T = fit.refine(q[None], T[None], widths)
        T_camera_link = hand.link_poses(q, T)[0]
        if hand_support(observation, hand, T_camera_link, c).whole < c.min_hand_support:
            raise NoAnswer("the image does not show the hand where it is; move it closer")
        joints = self._unless_idle(search, given, q[0], T)
        return replace(
            label,
            T_camera_hand=orthonormal(T[0]),
            joint_positions=dict(zip(hand.hand.joint_names, joints.tolist(), strict=True)),
        )

    def _unless_idle(self, search: FingerSearch, given: Array, fitted: Array, T: Array) -> Array:
        """The fitted joints, (n,), but the given ones of fingers that moved for nothing.

        Nothing but the user's word says where a hidden finger is.
        """
        s, joints = self.snap, fitted.copy()
        for finger in self.hand.fingers:
            both = np.stack([given, fitted])[:, finger.joints]
            score = search.visibility.score(finger, both, T).strict
            way = np.abs(both[1] - both[0]) / search.scale[finger.joints]
            if way.max() > s.idle_way and score[1] - score[0] < s.idle_gain:
                joints[finger.joints] = both[0]
        return joints

    def _observe(self, raw: RawImage, label: Label) -> Observation:
        reach, diameter = self.hand.hand.reach, self.obj.model.diameter
        config, device = self.config.observation, self.hand.device
        return observe(raw.depth, raw.camera, label.T_camera_hand, reach, diameter, config, device)

    def _evidence(self, raw: RawImage, label: Label) -> Evidence:
        c, hand = self.config, self.hand
        observation = self._observe(raw, label)
        q = hand.hand.joint_vector(label.joint_positions)
        links = hand.link_poses(q[None], label.T_camera_hand[None])[0]
        everywhere = np.ones(len(links), dtype=bool)  # the user says where every link is
        state = HandState(q, label.T_camera_hand, links, everywhere)
        diameter = self.obj.model.diameter
        segment = segment_object(observation, state, hand, diameter, c.segmentation)
        return gather_evidence(observation, state, segment, hand, c.evidence)

    def _around(self, T_camera_object: Array) -> NDArray[np.float32]:
        """The given pose and random ones around it, turned about the object's centre."""
        s, rng = self.snap, np.random.default_rng(self.snap.seed)
        sd = np.repeat([s.spread_rotation, s.spread_translation], 3)
        offset = rng.normal(0, 1, (s.starts, 6)) * sd
        offset[0] = 0.0
        return moved(T_camera_object, offset, self.obj.model.centre).astype(np.float32)

    def _on_the_leash(
        self, T_camera_object: NDArray[np.float32], given: Array
    ) -> NDArray[np.float32]:
        """Those of the poses (m, 4, 4) that stayed near the given one."""
        limit = self.snap.leash
        moved = surface_distances_to(T_camera_object, given.astype(np.float32), self.obj, 2 * limit)
        near = T_camera_object[moved <= limit]
        if not len(near):
            raise NoAnswer("the image shows the object too far from where it is; move it closer")
        return near


def orthonormal(T: Array) -> Array:
    """`T`, (4, 4), with its rotation rid of rounding errors."""
    out = T.copy()
    u, _, vt = np.linalg.svd(T[:3, :3])
    out[:3, :3] = u @ vt
    return out
