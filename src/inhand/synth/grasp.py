"""Grasps: an object at a random pose between the fingers, every finger closed until it touches.

The paper's protocol (section "Simulation Dataset and Results"): no physics, so any pose in the
hand may occur. Contact and collision are signed distances between surface samples of one body and
the distance field of the other, both ways.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.errors import InputError
from inhand.geometry import se3
from inhand.hand import Finger, Hand, Link
from inhand.kernels.fields import pack_fields
from inhand.kernels.launch import launch
from inhand.object_model import ObjectModel
from inhand.packed import device_poses
from inhand.synth.kernels import body_gaps

Array = NDArray[np.float64]

PATHS, PATH_STEPS = 24, 32
"""Random closing paths tried for a finger, and configurations looked at along one."""
FINE_STEPS = 8
"""Configurations looked at in every round that narrows down where a finger touches."""
TOUCH = 0.0002
"""A finger stops at most this far from the object [m]."""
CLEARANCE = 0.002
"""Links nearer than this in the open hand belong together and are not checked for collision [m]."""
OVERLAP = 0.001
"""Two fingers, or a finger and the palm, may overlap by this before they count as colliding [m]."""
PLACEMENTS, BATCH = 4096, 32
"""Attempts to place the object before giving up, and how many are looked at at once."""
FEW_SAMPLES = 48
"""Surface samples of a body for a first look; a contact is found with all of them."""
EXACT = -1e6
"""A distance below all others: every gap is exact [m]."""


@dataclass(frozen=True, eq=False)
class Grasp:
    """An object in a hand."""

    T_hand_object: Array
    """Pose of the object, shape (4, 4)."""
    q: Array
    """Independent joint positions [rad, m], shape (n,)."""


class GraspSampler:
    """Draws grasps of one object in one hand.

    Args:
        hand: the hand.
        obj: the object.
        device: Warp device name.
    """

    def __init__(self, hand: Hand, obj: ObjectModel, device: str = "cpu") -> None:
        self.hand = hand
        self.obj = obj
        self._device = device
        bodies: list[Link | ObjectModel] = [*hand.links, obj]
        self._object = len(hand.links)
        self._fields = pack_fields(
            [body.distance_field for body in bodies], [body.mesh for body in bodies], device
        )
        points = [body.surface.points for body in bodies]
        self._points = wp.array(np.concatenate(points), dtype=wp.vec3, device=device)
        start = np.cumsum([0, *map(len, points)])
        self._start = wp.array(start, dtype=int, device=device)
        self._all_samples = max(map(len, points))
        self.open_q = open_configuration(hand, np.random.default_rng(0))
        self._apart = self._pairs_apart()

    def sample(self, rng: np.random.Generator) -> Grasp:
        """A random grasp.

        Raises:
            InputError: none was found; the object is too large for the hand, or out of its reach.
        """
        links = range(self._object)
        for _ in range(PLACEMENTS // BATCH):
            T_hand_object = self._placements(rng)
            open_q = np.tile(self.open_q, (BATCH, 1))
            free = np.ones(BATCH, dtype=bool)
            for samples in (FEW_SAMPLES, self._all_samples):
                gaps = self.object_gaps(T_hand_object[free], open_q[free], links, samples, stop=0.0)
                free[free] = gaps > 0
            for T in T_hand_object[free]:
                q = self.close(T, rng)
                if q is not None:
                    return Grasp(T, q)
        raise InputError(
            f"no grasp of {self.obj.name} found in {PLACEMENTS} placements; does it fit between "
            f"the fingers of {self.hand.name}?"
        )

    def close(self, T_hand_object: Array, rng: np.random.Generator) -> Array | None:
        """Close one finger after another, in random order, until each touches the object.

        A finger moves straight through joint space towards a random configuration.

        Returns:
            Joint positions, shape (n,), or None when a finger cannot touch or would hit another
            link.
        """
        q = self.open_q
        for i in rng.permutation(len(self.hand.fingers)):
            finger = self.hand.fingers[i]
            closed = self._close_finger(finger, T_hand_object, q, rng)
            if closed is None:
                return None
            at_risk = [pair for pair in self._apart if set(finger.links).intersection(pair)]
            if (self.link_gaps(closed, at_risk, stop=-OVERLAP) < -OVERLAP).any():
                return None
            q = closed
        return q

    def object_gaps(
        self,
        T_hand_object: Array,
        q: Array,
        links: Sequence[int],
        samples: int,
        stop: float = EXACT,
    ) -> Array:
        """Signed distance [m] between the object and the nearest of some links, shape (b,).

        Args:
            T_hand_object: poses of the object, shape (b, 4, 4).
            q: joint positions, shape (b, n).
            links: indices of the links.
            samples: how many surface samples of a body are used.
            stop: a distance below this need not be exact [m].
        """
        T_hand_link = self.hand.forward_kinematics(q)[:, list(links)]
        T_object_link = se3.inverse(T_hand_object)[:, None] @ T_hand_link
        one = np.tile(links, len(q))
        other = np.full(len(one), self._object)
        gaps = self._gaps(one, other, T_object_link.reshape(-1, 4, 4), samples, stop)
        return np.asarray(gaps.reshape(len(q), len(links)).min(axis=1))

    def link_gaps(self, q: Array, pairs: list[tuple[int, int]], stop: float = EXACT) -> Array:
        """Signed distances [m] between pairs of links at joint positions `q`, (n,); shape (k,)."""
        if not pairs:
            return np.zeros(0)
        one, other = np.array(pairs).T
        poses = self.hand.forward_kinematics(q)
        T_other_one = se3.inverse(poses[other]) @ poses[one]
        return self._gaps(one, other, T_other_one, self._all_samples, stop)

    def _gaps(
        self,
        one: NDArray[np.int64],
        other: NDArray[np.int64],
        T_other_one: Array,
        samples: int,
        stop: float,
    ) -> Array:
        device, count = self._device, len(one)
        gap = wp.empty(count, dtype=float, device=device)
        launch(
            body_gaps,
            count,
            [self._fields, self._points, self._start, samples, stop]
            + [wp.array(body, dtype=int, device=device) for body in (one, other)]
            + [device_poses(T_other_one, device), gap],
            device,
            work_per_item=2 * samples,
        )
        return np.asarray(gap.numpy(), dtype=np.float64)

    def _close_finger(
        self, finger: Finger, T_hand_object: Array, q: Array, rng: np.random.Generator
    ) -> Array | None:
        """`q` with the joints of `finger` moved until it touches; None when no path touches."""
        joints = list(finger.joints)
        lower, upper = self.hand.lower[joints], self.hand.upper[joints]
        targets = np.tile(q, (PATHS, 1))
        targets[:, joints] = rng.uniform(lower, upper, size=(PATHS, len(joints)))

        def gaps(stretches: Array, samples: int, stop: float) -> Array:
            poses = np.tile(T_hand_object, (len(stretches), 1, 1))
            return self.object_gaps(poses, stretches, finger.links, samples, stop)

        paths = np.concatenate([_between(q, target, PATH_STEPS) for target in targets])
        touches = (gaps(paths, FEW_SAMPLES, 0.0) < 0).reshape(PATHS, PATH_STEPS).any(axis=1)
        if not touches.any():
            return None
        path = _between(q, targets[rng.choice(np.flatnonzero(touches))], PATH_STEPS)
        free_gap = np.inf
        while free_gap > TOUCH:
            at = gaps(path, self._all_samples, EXACT)
            first = int(np.argmax(at < 0))
            if first == 0 or np.abs(path[first] - path[first - 1]).max() < 1e-6:
                return None
            free, free_gap = path[first - 1], at[first - 1]
            path = _between(free, path[first], FINE_STEPS)
        return np.asarray(free)

    def _pairs_apart(self) -> list[tuple[int, int]]:
        """Pairs of links of different fingers, or finger and palm, apart in the open hand."""
        groups = [self.hand.palm_links, *(finger.links for finger in self.hand.fingers)]
        pairs = [
            (a, b)
            for i, one in enumerate(groups)
            for other in groups[i + 1 :]
            for a in one
            for b in other
        ]
        gaps = self.link_gaps(self.open_q, pairs)
        return [pair for pair, gap in zip(pairs, gaps, strict=True) if gap > CLEARANCE]

    def _placements(self, rng: np.random.Generator) -> Array:
        """Random object poses, (BATCH, 4, 4), with some point of the inside between the fingers."""
        hand, obj = self.hand, self.obj
        q = rng.uniform(hand.lower, hand.upper, size=(BATCH, len(hand.lower)))
        T = np.tile(np.eye(4), (BATCH, 1, 1))
        T[:, :3, :3] = [se3.random_rotation(rng) for _ in range(BATCH)]
        held = (obj.centre + rng.choice(obj.surface.points, BATCH)) / 2
        place = _centre_of_fingers(hand, q) + rng.normal(scale=0.01, size=(BATCH, 3))
        T[:, :3, 3] = place - np.einsum("bij,bj->bi", T[:, :3, :3], held)
        return T


def open_configuration(hand: Hand, rng: np.random.Generator) -> Array:
    """Joint positions at their limits that spread every finger as far as possible, shape (n,).

    "Far" is the mean distance of a finger's links from the centre of all fingers at mid-range, so
    no convention about the sign of closing is needed.
    """
    at_upper = rng.integers(0, 2, size=(512, len(hand.joint_names))).astype(bool)
    corners = np.where(at_upper, hand.upper, hand.lower)
    q = (hand.lower + hand.upper) / 2
    centre = _centre_of_fingers(hand, q[None])[0]
    for finger in hand.fingers:
        spread = np.linalg.norm(_link_centres(hand, corners, finger.links) - centre, axis=-1)
        joints = list(finger.joints)
        q[joints] = corners[np.argmax(spread.mean(axis=1))][joints]
    return q


def _between(start: Array, end: Array, steps: int) -> Array:
    """Joint positions on the straight way from `start` to `end`, both included, (steps, n)."""
    along = np.linspace(0, 1, steps)[:, None]
    return np.asarray(start + along * (end - start))


def _centre_of_fingers(hand: Hand, q: Array) -> Array:
    """Mean of the fingers' centres [m], hand frame; (b, n) -> (b, 3)."""
    centres = [_link_centres(hand, q, finger.links).mean(axis=1) for finger in hand.fingers]
    return np.asarray(np.mean(centres, axis=0))


def _link_centres(hand: Hand, q: Array, links: tuple[int, ...]) -> Array:
    """Mean surface points of some links, hand frame [m]; (b, n) -> (b, len(links), 3)."""
    T = hand.forward_kinematics(q)[:, list(links)]
    centres = np.stack([hand.links[i].surface.points.mean(axis=0) for i in links])
    return np.asarray(np.einsum("blij,lj->bli", T[..., :3, :3], centres) + T[..., :3, 3])
