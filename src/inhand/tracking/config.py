"""Parameters of the tracker, one frozen section a part, as in `inhand.config`."""

from dataclasses import dataclass, field, replace
from functools import cached_property

from inhand.config import (
    EstimatorConfig,
    HandStateConfig,
    NonNegative,
    ObservationConfig,
    Real,
    Section,
    Share,
)


@dataclass(frozen=True)
class ViewConfig(Section):
    """The part of the image that is looked at."""

    pixel_spacing: float = 0.0018
    """About the distance of neighbouring pixels at the hand [m]: those between are left out."""
    margin: NonNegative = 0.015
    """Added to hand and object where they are expected [m]."""


@dataclass(frozen=True)
class StartConfig(Section):
    """How well an answer of the estimator is known, as standard deviations."""

    wrist_turn: float = 0.02
    """[rad] per axis."""
    wrist_shift: float = 0.003
    """[m] per axis."""
    joint: float = 0.2
    """[rad]; of a sliding joint times `HandStateConfig.slide_scale`."""
    object_turn: float = 0.1
    """[rad] per axis."""
    object_shift: float = 0.005
    """[m] per axis."""
    lasting: NonNegative = 2.0
    """The object may be off by this many times as much all the same, in directions in which no
    image corrects it; see `Track.lasting`."""


@dataclass(frozen=True)
class HandTrackConfig(Section):
    """Following of wrist and fingers."""

    iterations: int = 2
    """Gauss-Newton iterations."""
    width: float = 0.005
    """Width of the redescending weight [m]."""
    stride: int = 1
    """Every so-many-th point takes part."""
    point_information: float = 2.0e4
    """Information of one surface point [1/m^2], see `HandStateConfig.point_information`."""
    wrist_motion: float = 0.01
    """Sd of how the error of the given wrist pose changes [m/sqrt(s)]."""
    wrist_turn: float = 0.04
    """Sd of how its rotation does [rad/sqrt(s)]."""
    joint_motion: float = 0.15
    """Sd of how a joint moves [rad/sqrt(s)]; of a sliding joint times
    `HandStateConfig.slide_scale`."""
    anchor: float = 100.0
    """The given wrist pose, with the estimator's sd, counts as one measurement in so many images:
    its error is the same in all of them."""


@dataclass(frozen=True)
class FingerSearchConfig(Section):
    """Search for fingers that the last image did not support where they were."""

    near: int = 64
    """Configurations tried around the last one."""
    spread: float = 0.25
    """Sd of these [rad]; of a sliding joint times `HandStateConfig.slide_scale`."""
    anywhere: int = 64
    """Configurations tried all over the finger's range."""
    lead: NonNegative = 0.1
    """A finger moves to a configuration that scores better by this ..."""
    least: Real = 0.2
    """... and this at least: out of sight, nothing speaks against anything."""
    render_step: int = 2
    """Object and other links are rendered at every so-many-th pixel."""
    every: int = 3
    """In so many images a finger is looked for once."""


@dataclass(frozen=True)
class ObjectTrackConfig(Section):
    """Following of the object."""

    near: float = 0.015
    """Scene points farther from where the object is expected are not the object's [m]."""
    min_points: int = 10
    """With fewer points that are the object's, it is hidden."""
    points: int = 300
    """About how many segment points and how many model points are used in the fit."""
    iterations: int = 4
    """Gauss-Newton iterations of every start."""
    first_width: float = 0.007
    """Width of the redescending weight in the first iteration [m]."""
    last_width: float = 0.004
    """And in the last [m]."""
    image_weight: NonNegative = 0.3
    """Weight of a visible model point against a segment point."""
    point_information: float = 2.0e5
    """Information of one segment point [1/m^2] where the fit is weighed against the prediction."""
    still_motion: float = 0.0005
    """Sd of how an object moves that seems to be still in the hand [m/sqrt(s)]."""
    still_turn: float = 0.004
    """Sd of how it turns [rad/sqrt(s)]."""
    agility: NonNegative = 0.7
    """The sd of its motion from image to image is this times the recent motion, and more if it is
    still."""
    unseen_agility: NonNegative = 0.3
    """And in every direction this times the root mean square of all: what the image shows to move
    may move where it does not show it as well."""
    hidden_motion: float = 0.02
    """Sd of how an object moves that was not seen in the last image [m/sqrt(s)]."""
    hidden_turn: float = 0.6
    """Sd of how it turns [rad/sqrt(s)]."""
    lever: float = 0.03
    """Motion that counts as one radian of turning there [m/rad]."""
    lasting: NonNegative = 0.9
    """Sd of the errors that are the same in all images, in units of those that are not; see
    `Track.lasting`."""
    sensor_along: NonNegative = 0.0007
    """Sd of what the sensor is off by everywhere along the line of sight [m] ..."""
    sensor_across: NonNegative = 0.0004
    """... and across it."""
    memory: Share = 0.8
    """Weight of earlier images in the recent motion."""
    start_lead: NonNegative = 0.02
    """A start other than the prediction must score better by this."""
    aside: NonNegative = 1.5
    """Two more starts are so many sds away, where the surface is known the least ..."""
    least_aside: NonNegative = 0.0007
    """... if one sd moves it by more than this, root mean square along its normals [m]."""
    aside_lead: NonNegative = 0.2
    """One of these takes the place of the prediction if it is better by more, as rivals are
    compared: less would let noise move an object that is still."""


@dataclass(frozen=True)
class RestConfig(Section):
    """What is answered while hand and object rest; see `tracking.rest`."""

    hand_speed: NonNegative = 0.018
    """A hand whose given pose moves more slowly than this rests [m/s]."""
    stopping: Share = 0.5
    """A hand that moves by less than this share of its recent speed slows down, and keeps no more
    of that than this (else `ObjectTrackConfig.memory`): once it has stopped, it rests soon."""
    most_motion: NonNegative = 16.8
    """An object rests whose recent motion, squared and in units of what chance makes of it, is less
    than this: 99 % are where nothing moves (chi squared, six degrees of freedom)."""
    settling: int = 4
    """Images after a search or a loss in which an answer follows the estimate at once."""
    doubt: NonNegative = 1.5
    """The answer stays while the estimate is within so many standard deviations, each less ..."""
    least_doubt: NonNegative = 0.0005
    """... this [m]: where the image says more, the answer is the estimate."""
    closing: Share = 0.2
    """Share of the difference that is left after each image with motion."""


@dataclass(frozen=True)
class LossConfig(Section):
    """How the tracker knows that it is lost."""

    evidence_bias: Real = -3.15
    """What a score of 0 adds to the log odds that a followed pose is right. This and the next are a
    logistic regression over poses followed through generated sequences, and over others that began
    away from the truth, less the log odds of a right one among them; see docs/tracking.md."""
    evidence_fit: float = 2.76
    """What a unit of score adds."""
    loss_rate: Share = 0.02
    """Probability that a pose is lost from one image to the next."""
    most: Share = 0.95
    """A pose counts as no surer than this in the next image: what deceives the score in one image
    does so in the next."""
    lost: Share = 0.3
    """A pose of less confidence is given up."""
    again: Share = 0.5
    """Probability that an object which was lost is where it is expected."""
    accept: Share = 0.6
    """A tracker that is lost takes a pose of this confidence or more; of a search, only if it
    agrees with where the object was expected or where the last image's search had it."""
    sure: Share = 0.95
    """While there is no track to agree with, one search is enough if its confidence, times its
    answer's share among the rivals that it found, is at least this."""
    unconfirmed: Share = 0.5
    """Until then, the estimator's answer has its confidence times this."""
    right: float = 0.005
    """A pose is right if the object's surface is off by less than this, root mean square [m]."""
    same: float = 0.004
    """Poses whose surfaces are nearer than this on average agree [m]."""


@dataclass(frozen=True)
class RivalConfig(Section):
    """Other poses that a search found likely; see `tracking.rivals`."""

    most: int = 5
    """Of these, so many at most are followed."""
    most_behind: NonNegative = 0.2
    """A pose whose score is behind by more is none."""
    apart: float = 0.0025
    """Poses whose surfaces are nearer than this on average are one [m]."""
    visible: NonNegative = 2.0
    """Between rivals, what the camera sees of a pose counts this many times what segment it
    explains: the segment may hold points of the hand."""
    memory: Share = 0.7
    """Weight of earlier images in how far a rival leads."""
    overtakes: NonNegative = 0.03
    """A rival that leads by more takes the answer's place."""
    tells: float = 0.05
    """A lead of this makes one pose e times as likely as another."""
    elsewhere: float = 0.004
    """A rival makes the answer unsure if its surface is farther away than this on average [m]; less
    than twice `apart`."""
    unsure: Share = 0.6
    """While the answer's share among its rivals is less than this, others are searched for ..."""
    every: int = 5
    """... in one of so many images."""
    first: int = 2
    """And once when an object that was hidden has been followed for so many images: where it came
    to light it may have been taken for another pose."""


@dataclass(frozen=True)
class TrackerConfig(Section):
    """All parameters of `PoseTracker`."""

    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)
    """The estimator that starts and recovers; its sections also rule what the two share."""
    rate: float = 30.0
    """Images a second where `update` is told no time."""
    view: ViewConfig = field(default_factory=ViewConfig)
    start: StartConfig = field(default_factory=StartConfig)
    hand: HandTrackConfig = field(default_factory=HandTrackConfig)
    fingers: FingerSearchConfig = field(default_factory=FingerSearchConfig)
    object: ObjectTrackConfig = field(default_factory=ObjectTrackConfig)
    rivals: RivalConfig = field(default_factory=RivalConfig)
    rest: RestConfig = field(default_factory=RestConfig)
    loss: LossConfig = field(default_factory=LossConfig)

    @cached_property
    def observation(self) -> ObservationConfig:
        """The estimator's section with the tracker's margin."""
        return replace(self.estimator.observation, margin=self.view.margin)

    @cached_property
    def finger_score(self) -> HandStateConfig:
        """The estimator's section with the finger search's rendering."""
        return replace(self.estimator.hand_state, render_step=self.fingers.render_step)
