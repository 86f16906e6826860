"""The tracker: follows hand and object from image to image, and finds them again when lost."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.checks import finite_number
from inhand.errors import InputError, NoAnswer
from inhand.estimate import PoseEstimate
from inhand.estimator import Clock, PoseEstimator, check_depth, check_wrist
from inhand.hand import Hand
from inhand.object_model import ObjectModel
from inhand.stages.evidence import gather_evidence
from inhand.stages.observation import Observation
from inhand.stages.results import HandState
from inhand.tracking.answer import Answers
from inhand.tracking.config import TrackerConfig
from inhand.tracking.finger_search import find_lost_fingers
from inhand.tracking.gaussian import Array
from inhand.tracking.hand_track import follow_hand
from inhand.tracking.loss import seen_confidence
from inhand.tracking.object_track import FollowedObject, follow_object, segment_near
from inhand.tracking.recovery import Sighting, resumed, same_place, stands_beside_the_hand
from inhand.tracking.rest import with_answer
from inhand.tracking.rivals import Rival, rivals_of, share_of_answer
from inhand.tracking.track import Track, begun, predicted
from inhand.tracking.view import look_at


class PoseTracker:
    """Follows a known object in a known hand through a sequence of depth images.

    Args:
        hand: the hand.
        obj: the object.
        config: parameters.
        device: "cpu", "cuda:0", or None for the best there is.

    Raises:
        InputError: an argument is of the wrong kind, or the device does not exist.
    """

    def __init__(
        self,
        hand: Hand,
        obj: ObjectModel,
        config: TrackerConfig | None = None,
        device: str | None = None,
    ) -> None:
        self.config = TrackerConfig() if config is None else config
        if not isinstance(self.config, TrackerConfig):
            raise InputError(f"config must be an inhand.TrackerConfig, got {config!r:.80}")
        self.estimator = PoseEstimator(hand, obj, self.config.estimator, device)
        self._hand, self._object = self.estimator.hand, self.estimator.object
        self._answers = Answers(self._hand.hand, self._object.model, self.config)
        self.reset()

    def reset(self) -> None:
        """Forget all images; the next one starts anew."""
        self._track: Track | None = None
        self._rng = np.random.default_rng(self.config.estimator.seed)
        self._lost = True
        self._sighting: Sighting | None = None  # of the last image
        self._images = 0
        self._time: float | None = None

    @property
    def lost(self) -> bool:
        """Whether the next image is searched all over."""
        return self._lost

    def update(
        self, depth: Any, camera: Camera, T_camera_hand: Any, *, time: float | None = None
    ) -> PoseEstimate:
        """Pose of the object and state of the hand in the next image.

        Args:
            depth: z [m], floating point, shape (H, W); 0, NaN and inf mean "no reading".
            camera: the camera of the image.
            T_camera_hand: approximate pose of the hand's root link in the camera, (4, 4).
            time: when the image was taken [s]; by default images come at `config.rate`.

        Raises:
            InputError: the input is malformed, or `time` is not later than the last image's. An
                image without an answer is no error: see `PoseEstimate.found`.
        """
        image, given = check_depth(depth, camera), check_wrist(T_camera_hand)
        seconds, clock = self._since_last(time), Clock()
        self._images += 1
        if self._track is not None:
            self._track = predicted(
                self._track, given, seconds, self._lost, self._hand.hand, self.config
            )
            if self._unsure():
                self._track = clock.time(
                    "rivals", self._with_more_rivals, self._track, image, camera, given
                )
            answer = self._follow(image, camera, self._track, clock)
            if answer.found:
                return answer
        return self._search(image, camera, given, clock)

    def _since_last(self, time: float | None) -> float:
        """Time since the last image [s]."""
        if time is None:
            return 1 / self.config.rate
        time, last = finite_number(time, "time"), self._time
        if last is not None and time <= last:
            raise InputError(
                f"time must rise from image to image, got {time} after {last}; call reset() before "
                "another sequence"
            )
        self._time = time
        return 1 / self.config.rate if last is None else time - last

    def _follow(
        self, image: NDArray[np.float32], camera: Camera, track: Track, clock: Clock
    ) -> PoseEstimate:
        """The answer near where hand and object are expected.

        What is found becomes the track. While the tracker is lost, only a sure pose does.
        """
        hand, obj, config = self._hand, self._object, self.config
        try:
            observation = clock.time(
                "observation", look_at, image, camera, track, hand, obj, config
            )
            if self._images % config.fingers.every == 0:
                track = clock.time(
                    "fingers", find_lost_fingers, observation, hand, obj, track, config, self._rng
                )
            found_hand = clock.time("hand", follow_hand, observation, hand, track, config)
            self._track = track = found_hand.kept_in(track)
            found = clock.time("object", self._follow_object, observation, found_hand.state, track)
        except NoAnswer as problem:
            self._lost = True
            return self._no_answer(str(problem), clock)
        loss = config.loss
        expected = loss.again if self._lost else track.confidence
        if not track.certain.any():  # what hides the hand may have moved the object as well
            expected = min(expected, loss.again)
        confidence = seen_confidence(expected, found.score, loss)
        if confidence < (loss.accept if self._lost else loss.lost):
            self._lost = True
            return self._no_answer("the image does not show the object where it is expected", clock)
        self._lost, self._sighting = False, None
        followed = found.kept_in(track, confidence, config)
        self._track = with_answer(followed, self._object.model.centre, hand.hand.reach[1], config)
        return self._answers.followed(self._track, found.score, clock.seconds)

    def _follow_object(
        self, observation: Observation, state: HandState, track: Track
    ) -> FollowedObject:
        c, hand, obj = self.config.estimator, self._hand, self._object
        segment = segment_near(observation, state, track, hand, obj, self.config)
        evidence = gather_evidence(observation, state, segment, hand, c.evidence)
        return follow_object(evidence, obj, track, self.config)

    def _search(
        self, image: NDArray[np.float32], camera: Camera, given: Array, clock: Clock
    ) -> PoseEstimate:
        """The estimator's answer; if it is sure, the track goes on from there."""
        estimate = self._estimate(image, camera, given)
        clock.seconds.update(estimate.timings)
        before, self._sighting = self._sighting, None
        if not estimate.found:
            # Of a hand that is hidden, the track knows more than the estimator.
            unseen = replace(estimate, timings=clock.seconds)
            return self._no_answer(estimate.reason, clock) if self._track else unseen
        if estimate.confidence < self.config.loss.accept:
            reason = f"no pose of the object is sure (the best: {estimate.confidence:.2f})"
            return self._unconfirmed(estimate, given, reason, clock)
        if not self._stands_beside_the_hand(estimate, image, camera):
            return self._no_answer("the search takes a part of the hand for the object", clock)
        self._sighting = Sighting.of(estimate)
        if not self._confirmed(estimate, before):
            reason = "no second image agrees yet on where the object is"
            return self._unconfirmed(estimate, given, reason, clock)
        self._lost = False
        self._track = track = self._resumed(estimate, given)
        return replace(
            estimate,
            T_camera_object=track.answer,
            timings=clock.seconds,
            covariance=self._answers.covariance(track),
        )

    def _unconfirmed(
        self, estimate: PoseEstimate, given: Array, reason: str, clock: Clock
    ) -> PoseEstimate:
        """What is answered when a search is not believed.

        While there is no track, nobody knows better than the estimator: its answer stands, but with
        less confidence.
        """
        if self._track is not None:
            return self._no_answer(reason, clock)
        return replace(
            estimate,
            confidence=self.config.loss.unconfirmed * estimate.confidence,
            timings=clock.seconds,
            covariance=self._answers.covariance(
                begun(estimate, given, self._hand.hand, self.config)
            ),
        )

    def _estimate(self, image: NDArray[np.float32], camera: Camera, given: Array) -> PoseEstimate:
        """What the estimator makes of an image: what one seed does not find, the next may."""
        seed = int(self._rng.integers(2**31))
        self.estimator.config = replace(self.config.estimator, seed=seed)
        return self.estimator.estimate(image, camera, given)

    def _unsure(self) -> bool:
        """Whether it is time to look what else the object's pose may be."""
        c, track = self.config.rivals, self._track
        if self._lost or track is None:
            return False
        if not track.searched:
            return track.images >= c.first
        return self._images % c.every == 0 and share_of_answer(track.rivals, c) < c.unsure

    def _with_more_rivals(
        self, track: Track, image: NDArray[np.float32], camera: Camera, given: Array
    ) -> Track:
        """The track with what a search finds beside its pose."""
        estimate, known = self._estimate(image, camera, given), track.rivals
        T, c = track.T_camera_object, self.config.rivals
        rivals = rivals_of(estimate, T, self._object, c, known)
        return replace(track, rivals=rivals, searched=True)

    def _stands_beside_the_hand(
        self, estimate: PoseEstimate, image: NDArray[np.float32], camera: Camera
    ) -> bool:
        """Whether a search took no part of the followed hand for the object, if one is followed."""
        track, hand, obj, config = self._track, self._hand, self._object, self.config
        if track is None:
            return True
        try:
            observation = look_at(image, camera, track, hand, obj, config)
        except NoAnswer:
            return True
        return stands_beside_the_hand(estimate, track, observation, hand, obj, config)

    def _confirmed(self, estimate: PoseEstimate, before: Sighting | None) -> bool:
        """Whether the track or the last image's search agree on where a search found the object.

        While there is no track, a search may be sure enough alone.
        """
        sighting, track, obj, config = Sighting.of(estimate), self._track, self._object, self.config
        if track is None:
            share = share_of_answer(self._rivals(estimate), config.rivals)
            alone = share * estimate.confidence >= config.loss.sure
        else:
            alone = same_place(sighting.T_camera_object, track.T_camera_object, obj, config)
        return alone or (before is not None and sighting.agrees_with(before, obj, config))

    def _resumed(self, estimate: PoseEstimate, given: Array) -> Track:
        """The track after a search."""
        before, hand, obj, config = self._track, self._hand, self._object, self.config
        if before is None:
            track = begun(estimate, given, hand.hand, config)
        else:
            track = resumed(before, estimate, given, hand, obj, config)
        return replace(track, rivals=self._rivals(estimate))

    def _rivals(self, estimate: PoseEstimate) -> tuple[Rival, ...]:
        """The rivals of a search's answer."""
        T = Sighting.of(estimate).T_camera_object
        return rivals_of(estimate, T, self._object, self.config.rivals)

    def _no_answer(self, reason: str, clock: Clock) -> PoseEstimate:
        return self._answers.none(self._track, reason, clock.seconds)
