"""Motion of a hand, of the object in it, and of what passes in front of them; no physics.

Everything moves in legs from rest to rest, as a minimum-jerk motion does (Flash and Hogan, 1985).
The object slides and turns between the fingers, which stay on it: each closes along its straight
line through joint space until it touches.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inhand.geometry import se3
from inhand.hand import Hand
from inhand.synth.grasp import FEW_SAMPLES, Grasp, GraspSampler

Array = NDArray[np.float64]

COARSE_STEPS, FINE_STEPS, BACK = 32, 24, 5
"""Configurations looked at along a finger's whole line by few samples, then by all of them along
the last so many steps before the first that touches: few samples see a contact late."""
LONGEST_LINE = 2.0
"""A finger's line ends here at the latest, in units of its way to the first contact."""
CHECKED_POSES = 10
"""Poses of the object that are looked at before it may move along a leg."""
MOST_TURN = 0.35
"""Most that a joint may turn between two of these [rad]: more is a jump from contact to contact."""
PALM_GAP = 0.0005
"""The object comes no nearer to the palm than this [m]."""
TRIES = 12
"""Legs of the object that are tried before it rests."""
DRIFT_TIME = 3.0
"""Time after which the drift of a wrist's error has forgotten where it was [s]."""


@dataclass(frozen=True)
class MotionProtocol:
    """What motions are drawn from. The numbers are choices of ours."""

    rate: float = 30.0
    """Images a second."""
    dropped: float = 0.03
    """Share of the images that are lost on the way; the time stamps jump there."""
    leg: tuple[float, float] = (0.4, 1.2)
    """Range of the time that a leg takes [s]."""
    rest: float = 0.35
    """Probability that a leg is a rest."""
    slide: float = 0.015
    """Longest slide of the object in one leg [m]."""
    roll: float = float(np.radians(40))
    """Largest turn of the object about its centre in one leg [rad]."""
    hand_shift: float = 0.03
    """Sd of where the hand goes along each axis, from where it was at first [m]."""
    hand_turn: float = float(np.radians(15))
    """Sd of how it is turned there about each axis [rad]."""
    occluders: float = 0.2
    """Solids that pass in front of the object, a second."""
    occluder_speed: tuple[float, float] = (0.15, 0.5)
    """Range of their speed [m/s]."""
    drift: float = 0.3
    """Sd of the given wrist pose's slow drift, in units of its constant error's."""
    jitter: float = 0.03
    """Sd of its error from image to image, in the same units."""


@dataclass(frozen=True, eq=False)
class Leg:
    """A motion of a body from rest to rest."""

    duration: float
    """[s]."""
    turn: Array
    """Rotation vector [rad] about the body's pivot, axes of the frame it moves in, shape (3,)."""
    shift: Array
    """Way of the pivot [m], shape (3,)."""


def poses_along(T: Array, pivot: Array, legs: Sequence[Leg], times: Array) -> Array:
    """Poses, shape (n, 4, 4), of a body that moves through legs one after the other.

    Args:
        T: its pose at time 0, shape (4, 4).
        pivot: the point of the body that its legs speak of [m], body frame, shape (3,).
        legs: the legs; after the last one it rests.
        times: when [s], rising, shape (n,).
    """
    poses, begin = np.empty((len(times), 4, 4)), 0.0
    for leg in legs:
        now = times >= begin
        u = np.clip((times[now] - begin) / leg.duration, 0, 1)
        poses[now] = _moved(T, pivot, leg, u**3 * (10 - 15 * u + 6 * u**2))
        T, begin = _moved(T, pivot, leg, np.ones(1))[0], begin + leg.duration
    poses[times >= begin] = T
    return poses


def _moved(T: Array, pivot: Array, leg: Leg, share: Array) -> Array:
    """A body's poses (n, 4, 4) after shares (n,) of a leg."""
    out = np.tile(T, (len(share), 1, 1))
    out[:, :3, :3] = se3.exp_so3(share[:, None] * leg.turn) @ T[:3, :3]
    centre = se3.transform(T, pivot[None]) + share[:, None] * leg.shift
    out[:, :3, 3] = centre - out[:, :3, :3] @ pivot
    return out


class FingerContacts:
    """Where fingers touch an object that moves.

    Args:
        grasps: hand and object.
        q: joints [rad, m] of a grasp, shape (n,); every finger moves on the straight line from the
            open hand through this.
    """

    def __init__(self, grasps: GraspSampler, q: Array) -> None:
        self._grasps, self._hand = grasps, grasps.hand
        self._open, self._way = grasps.open_q, q - grasps.open_q
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.where(self._way > 0, self._hand.upper, self._hand.lower)
            room = np.where(self._way != 0, (ends - self._open) / self._way, np.inf)
        joints = [list(finger.joints) for finger in self._hand.fingers]
        self._ends = [float(np.clip(room[j].min(), 1.0, LONGEST_LINE)) for j in joints]

    def close(self, T_hand_object: Array) -> Array | None:
        """Joints [rad, m], shape (b, n), that touch the object at poses (b, 4, 4).

        None when a finger does not touch in one of them.
        """
        q = np.tile(self._open, (len(T_hand_object), 1))
        for i, (finger, end) in enumerate(zip(self._hand.fingers, self._ends, strict=True)):
            joints = list(finger.joints)
            grid = np.tile(np.linspace(0, end, COARSE_STEPS), (len(q), 1))
            first = np.argmax(self._gaps(i, T_hand_object, grid, FEW_SAMPLES) < 0, axis=1)
            if (first == 0).any():
                return None
            step = end / (COARSE_STEPS - 1)
            fine = (first - BACK)[:, None] * step + np.linspace(0, BACK * step, FINE_STEPS)
            gaps = self._gaps(i, T_hand_object, np.clip(fine, 0, end), 10**6)
            way = _first_crossing(fine, gaps)
            q[:, joints] += way[:, None] * self._way[joints]
        return q

    def palm_gap(self, T_hand_object: Array, q: Array) -> float:
        """Smallest distance [m] between palm and object at poses (b, 4, 4) and joints (b, n)."""
        palm = self._hand.palm_links
        if not palm:
            return np.inf
        return float(self._grasps.object_gaps(T_hand_object, q, palm, 10**6).min())

    def _gaps(self, i: int, T_hand_object: Array, ways: Array, samples: int) -> Array:
        """Gaps [m], (b, s), between finger i and the object after ways (b, s) along its line."""
        finger, (poses, steps) = self._hand.fingers[i], ways.shape
        q = np.tile(self._open, (poses * steps, 1))
        joints = list(finger.joints)
        q[:, joints] += ways.reshape(-1, 1) * self._way[joints]
        T = np.repeat(T_hand_object, steps, axis=0)
        gaps = self._grasps.object_gaps(T, q, finger.links, samples)
        return gaps.reshape(poses, steps)


def _first_crossing(at: Array, gaps: Array) -> Array:
    """Where rows of gaps (b, s) at places (b, s) first fall to zero, by linear interpolation, (b,).

    A row that is below zero from the start crosses there; one that never is, at its end.
    """
    inside = gaps < 0
    last = at.shape[1] - 1
    first = np.where(inside.any(axis=1), np.argmax(inside, axis=1), last)
    row, before = np.arange(len(at)), np.maximum(first - 1, 0)
    free, touching = gaps[row, before], gaps[row, first]
    share = np.where(free > touching, free / np.maximum(free - touching, 1e-12), 1.0)
    place = at[row, before] + np.clip(share, 0, 1) * (at[row, first] - at[row, before])
    return np.asarray(np.where(first == 0, at[:, 0], place))


def move_in_hand(
    grasps: GraspSampler,
    grasp: Grasp,
    protocol: MotionProtocol,
    times: Array,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """T_hand_object, (n, 4, 4), and joints [rad, m], (n, joints), of a grasp that goes on moving.

    Args:
        grasps: hand and object.
        grasp: how they are at first.
        protocol: what the motion is drawn from.
        times: when [s], from 0, rising, shape (n,).
        rng: source of everything random.
    """
    contacts, centre = FingerContacts(grasps, grasp.q), grasps.obj.centre
    legs: list[Leg] = []
    T, end = grasp.T_hand_object, 0.0
    while end < times[-1]:
        leg = _object_leg(contacts, T, centre, grasps.hand, protocol, rng)
        legs.append(leg)
        T, end = _moved(T, centre, leg, np.ones(1))[0], end + leg.duration
    poses = poses_along(grasp.T_hand_object, centre, legs, times)
    q = contacts.close(poses)
    if q is None:  # between the poses that were checked; the hand stays as it was
        return np.tile(grasp.T_hand_object, (len(times), 1, 1)), np.tile(grasp.q, (len(times), 1))
    return poses, q


def _object_leg(
    contacts: FingerContacts,
    T: Array,
    centre: Array,
    hand: Hand,
    protocol: MotionProtocol,
    rng: np.random.Generator,
) -> Leg:
    """A slide, a roll or a rest of an object at `T` (4, 4) that the fingers can follow."""
    rest = Leg(rng.uniform(*protocol.leg), np.zeros(3), np.zeros(3))
    if rng.random() < protocol.rest:
        return rest
    for _ in range(TRIES):
        slides, turns = [(1, 0), (0, 1), (1, 1)][rng.integers(3)]
        shift = slides * rng.uniform(0.3, 1) * protocol.slide * _direction(rng)
        turn = turns * rng.uniform(0.3, 1) * protocol.roll * _direction(rng)
        leg = Leg(rest.duration, turn, shift)
        poses = _moved(T, centre, leg, np.linspace(0, 1, CHECKED_POSES))
        q = contacts.close(poses)
        if q is None or np.abs(np.diff(q, axis=0)).max() > MOST_TURN:
            continue
        if contacts.palm_gap(poses, q) > PALM_GAP:
            return leg
    return rest


def move_hand(
    T_camera_hand: Array,
    hand: Hand,
    protocol: MotionProtocol,
    times: Array,
    rng: np.random.Generator,
) -> Array:
    """T_camera_hand, (n, 4, 4), of a hand that moves about where it is at first.

    Args:
        T_camera_hand: its pose at first, shape (4, 4).
        hand: the hand.
        protocol, times, rng: as in `move_in_hand`.
    """
    legs, end = [], 0.0
    at_turn, at_shift = np.zeros(3), np.zeros(3)
    while end < times[-1]:
        to_turn, to_shift = at_turn, at_shift
        if rng.random() >= protocol.rest:
            to_turn = rng.normal(scale=protocol.hand_turn, size=3)
            to_shift = rng.normal(scale=protocol.hand_shift, size=3)
        leg = Leg(rng.uniform(*protocol.leg), to_turn - at_turn, to_shift - at_shift)
        legs.append(leg)
        at_turn, at_shift, end = to_turn, to_shift, end + leg.duration
    return poses_along(T_camera_hand, hand.reach[0], legs, times)


def wrist_errors(
    times: Array,
    sd_translation: float,
    sd_rotation: float,
    protocol: MotionProtocol,
    rng: np.random.Generator,
) -> Array:
    """Errors of forward kinematics, shape (n, 6): rotation [rad] and translation [m], camera axes.

    A constant offset (calibration), a slow drift (joints that bend and warm up; an
    Ornstein-Uhlenbeck process) and a small jitter (encoders, time stamps).

    Args:
        times: when [s], shape (n,).
        sd_translation, sd_rotation: sd of the constant offset along and about each axis [m, rad].
        protocol: sizes of the rest in units of these.
        rng: source of the errors.
    """
    n = len(times)
    drift = np.empty((n, 6))
    drift[0] = rng.normal(size=6)
    steps = rng.normal(size=(n, 6))
    keep = np.exp(-np.diff(times) / DRIFT_TIME)
    for i, k in enumerate(keep):
        drift[i + 1] = k * drift[i] + np.sqrt(1 - k**2) * steps[i + 1]
    offset, jitter = rng.normal(size=6), rng.normal(size=(n, 6))
    errors = offset + protocol.drift * drift + protocol.jitter * jitter
    return np.asarray(errors * ([sd_rotation] * 3 + [sd_translation] * 3))


def time_stamps(number: int, protocol: MotionProtocol, rng: np.random.Generator) -> Array:
    """When the images that arrive are taken [s], from 0, shape (number,)."""
    lost = rng.geometric(1 - protocol.dropped, size=number) - 1
    lost[0] = 0
    return np.asarray((np.arange(number) + np.cumsum(lost)) / protocol.rate)


def _direction(rng: np.random.Generator) -> Array:
    """A random unit vector, shape (3,)."""
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))
