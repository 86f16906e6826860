"""Scenes with ground truth: a hand holds an object in front of a depth camera.

The protocol is the paper's (section "Simulation Dataset and Results"): the object has a random
pose between the fingers, every finger closes along a random path until it touches, and the camera
stands anywhere on spheres around the hand. No physics: any pose in the hand may occur.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.errors import InputError
from inhand.geometry import se3
from inhand.geometry.distance_field import DistanceField
from inhand.geometry.mesh import box
from inhand.hand import Finger, Hand
from inhand.kernels.depth import DepthRenderer
from inhand.object_model import ObjectModel
from inhand.synth.sensor import PERFECT, STRUCTURED_LIGHT, SensorModel, observe, perturb_wrist

Array = NDArray[np.float64]

NOTHING, HAND, OBJECT, BACKGROUND = 0, 1, 2, 3
"""Values of a label image."""

PATHS, PATH_STEPS = 24, 64
"""Random closing paths tried for a finger, and configurations looked at along one."""
TOUCH = 0.0002
"""A finger stops at most this far from the object [m]."""
CLEARANCE = 0.002
"""Links nearer than this in the open hand belong together and are not checked for collision [m]."""
OVERLAP = 0.001
"""Two fingers, or a finger and the palm, may overlap by this before they count as colliding [m]."""
PLACEMENTS, VIEWS = 400, 200
"""Attempts to place the object, and the camera, before giving up."""
MIN_PIXELS = 100
"""Pixels of the object that must be visible."""


@dataclass(frozen=True)
class SceneProtocol:
    """What the scenes are drawn from."""

    distance: tuple[float, float] = (0.3, 0.9)
    """Range of the camera's distance from the centre of the hand's reach [m]."""
    visible: tuple[float, float] = (0.05, 1.0)
    """Range of the visible share of the object's silhouette."""
    sensor: SensorModel = PERFECT
    """The depth camera's errors."""
    wrist_translation: float = 0.0005
    """Sd of the error of the given wrist pose along each axis [m]."""
    wrist_rotation: float = 0.0025
    """Sd of the error of the given wrist pose about each axis [rad]."""
    backdrop: tuple[float, float] | None = None
    """Range of the distance of a wall from the hand's reach [m]; None: nothing behind the hand."""


CLEAN = SceneProtocol()
"""The paper's simulation: no sensor noise but quantisation; the wrist is known well."""

NOISY = SceneProtocol(
    sensor=STRUCTURED_LIGHT,
    wrist_translation=0.004,
    wrist_rotation=float(np.radians(1.5)),
    backdrop=(0.05, 0.4),
)
"""A structured-light camera, a wall behind the hand, and a wrist from forward kinematics."""


@dataclass(frozen=True, eq=False)
class Grasp:
    """An object in a hand."""

    T_hand_object: Array
    """Pose of the object, shape (4, 4)."""
    q: Array
    """Independent joint positions [rad, m], shape (n,)."""


@dataclass(frozen=True, eq=False)
class Scene:
    """One depth image, the errors an estimator has to live with, and the truth behind it."""

    hand: Hand = field(repr=False)
    obj: ObjectModel = field(repr=False)
    camera: Camera
    T_camera_hand: Array
    """True wrist pose, shape (4, 4)."""
    T_camera_hand_given: Array
    """The wrist pose an estimator is told, shape (4, 4)."""
    T_camera_object: Array
    """True object pose, shape (4, 4)."""
    joint_positions: dict[str, float]
    """True positions [rad, m] of all movable joints, by name."""
    depth: NDArray[np.float32] = field(repr=False)
    """What the sensor reads [m], shape (H, W), 0 without reading."""
    label: NDArray[np.uint8] = field(repr=False)
    """What each pixel truly shows, shape (H, W): NOTHING, HAND, OBJECT or BACKGROUND."""
    visible_share: float
    """Visible share of the object's silhouette in the image."""


def make_scene(
    hand: Hand,
    obj: ObjectModel,
    camera: Camera,
    seed: int,
    protocol: SceneProtocol = CLEAN,
    device: str = "cpu",
) -> Scene:
    """A random scene; the same arguments give the same scene.

    Raises:
        InputError: the hand cannot hold the object, or no view of it fits the protocol.
    """
    rng = np.random.default_rng(seed)
    grasp = sample_grasp(hand, obj, rng)
    low, high = protocol.visible
    for _ in range(VIEWS):
        T_camera_hand = sample_view(hand, protocol, rng)
        scene = render_scene(hand, obj, camera, T_camera_hand, grasp, protocol, rng, device)
        enough = np.count_nonzero(scene.label == OBJECT) >= MIN_PIXELS
        if enough and low <= scene.visible_share <= high:
            return with_errors(scene, protocol, rng)
    raise InputError(
        f"none of {VIEWS} views shows a share of the object within {protocol.visible} and at "
        f"least {MIN_PIXELS} pixels of it; widen the range or bring the camera closer"
    )


def sample_view(hand: Hand, protocol: SceneProtocol, rng: np.random.Generator) -> Array:
    """`T_camera_hand`, (4, 4), of a camera on a sphere that looks roughly at its centre."""
    centre, _ = hand.reach
    T = np.eye(4)
    T[:3, :3] = se3.random_rotation(rng)
    aim = rng.normal(scale=0.02, size=3) + [0, 0, rng.uniform(*protocol.distance)]
    T[:3, 3] = aim - T[:3, :3] @ centre
    return T


def render_scene(
    hand: Hand,
    obj: ObjectModel,
    camera: Camera,
    T_camera_hand: Array,
    grasp: Grasp,
    protocol: SceneProtocol,
    rng: np.random.Generator,
    device: str = "cpu",
) -> Scene:
    """The scene of a grasp before any error: perfect depth, the true wrist pose as the given one.

    The wall behind the hand is drawn from `rng`.
    """
    T_camera_object = T_camera_hand @ grasp.T_hand_object
    meshes = [*(link.mesh for link in hand.links), obj.mesh]
    poses = [*(T_camera_hand @ hand.forward_kinematics(grasp.q)), T_camera_object]
    if protocol.backdrop is not None:
        meshes.append(box([4.0, 4.0, 0.01]))
        poses.append(_backdrop(hand, T_camera_hand, protocol.backdrop, rng))
    depth, index = DepthRenderer(meshes, device).render(camera, np.stack(poses))
    meanings = [HAND] * len(hand.links) + [OBJECT, BACKGROUND, NOTHING]
    label = np.array(meanings, dtype=np.uint8)[index]  # index -1, no hit, is the last
    _, alone = DepthRenderer([obj.mesh], device).render(camera, T_camera_object[None])
    shown, silhouette = np.count_nonzero(label == OBJECT), np.count_nonzero(alone >= 0)
    return Scene(
        hand=hand,
        obj=obj,
        camera=camera,
        T_camera_hand=T_camera_hand,
        T_camera_hand_given=T_camera_hand,
        T_camera_object=T_camera_object,
        joint_positions=hand.joint_dict(grasp.q),
        depth=depth,
        label=label,
        visible_share=shown / silhouette if silhouette else 0.0,
    )


def with_errors(scene: Scene, protocol: SceneProtocol, rng: np.random.Generator) -> Scene:
    """The scene as the protocol's sensor sees it, its wrist known as well as the protocol says."""
    return replace(
        scene,
        depth=observe(scene.depth, scene.camera, protocol.sensor, rng),
        T_camera_hand_given=perturb_wrist(
            scene.T_camera_hand, protocol.wrist_translation, protocol.wrist_rotation, rng
        ),
    )


def sample_grasp(hand: Hand, obj: ObjectModel, rng: np.random.Generator) -> Grasp:
    """The object at a random pose between the fingers, with every finger closed onto it.

    Raises:
        InputError: no grasp was found; the object is too large for the hand, or out of its reach.
    """
    open_q = open_configuration(hand, rng)
    for _ in range(PLACEMENTS):
        T_hand_object = _placement(hand, obj, rng)
        if object_gap(hand, obj, T_hand_object, open_q[None], range(len(hand.links)))[0] <= 0:
            continue
        q = close_fingers(hand, obj, T_hand_object, open_q, rng)
        if q is not None:
            return Grasp(T_hand_object, q)
    raise InputError(
        f"no grasp of {obj.name} found in {PLACEMENTS} placements; does it fit between the fingers "
        f"of {hand.name}?"
    )


def open_configuration(hand: Hand, rng: np.random.Generator) -> Array:
    """Joint positions at their limits that spread every finger as far as possible, shape (n,).

    "Far" is the mean distance of a finger's links from the centre of all fingers at mid-range, so
    no convention about the sign of closing is needed.
    """
    at_upper = rng.integers(0, 2, size=(512, len(hand.joint_names))).astype(bool)
    corners = np.where(at_upper, hand.upper, hand.lower)
    q = (hand.lower + hand.upper) / 2
    centre = _centre_of_fingers(hand, q)
    for finger in hand.fingers:
        spread = np.linalg.norm(_link_centres(hand, corners, finger.links) - centre, axis=-1)
        joints = list(finger.joints)
        q[joints] = corners[np.argmax(spread.mean(axis=1))][joints]
    return q


def close_fingers(
    hand: Hand, obj: ObjectModel, T_hand_object: Array, open_q: Array, rng: np.random.Generator
) -> Array | None:
    """Close one finger after another, in random order, from `open_q` until it touches the object.

    A finger moves straight through joint space towards a random configuration. Contact is the
    signed distance between surface samples of either body and the other body.

    Returns:
        Joint positions, shape (n,), or None when a finger cannot touch or would hit another link.
    """
    apart = _pairs_to_check(hand, open_q)
    q = open_q
    for i in rng.permutation(len(hand.fingers)):
        closed = _close_finger(hand, obj, T_hand_object, hand.fingers[i], q, rng)
        if closed is None:
            return None
        moved = set(hand.fingers[i].links)
        at_risk = (pair for pair in apart if moved.intersection(pair))
        if any(link_gap(hand, closed, a, b) < -OVERLAP for a, b in at_risk):
            return None
        q = closed
    return q


def object_gap(
    hand: Hand,
    obj: ObjectModel,
    T_hand_object: Array,
    q: Array,
    links: Iterable[int],
    *,
    from_object: bool = True,
) -> Array:
    """Signed distance [m] between the object and the nearest of some links, shape (b,).

    Args:
        hand: the hand.
        obj: the object.
        T_hand_object: pose of the object, shape (4, 4).
        q: joint positions, shape (b, n).
        links: indices of the links.
        from_object: also measure the object's samples against the links, which finds edges of the
            object that press between a link's samples.
    """
    T_object_links = se3.inverse(T_hand_object) @ hand.forward_kinematics(q)
    gaps = []
    for i in links:
        link, T_object_link = hand.links[i], T_object_links[:, i]
        gaps.append(_nearest(obj.distance_field, T_object_link, link.surface.points))
        if from_object:
            T_link_object = se3.inverse(T_object_link)
            gaps.append(_nearest(link.distance_field, T_link_object, obj.surface.points))
    return np.asarray(np.min(gaps, axis=0))


def link_gap(hand: Hand, q: Array, a: int, b: int) -> float:
    """Signed distance [m] between the links `a` and `b` at joint positions `q`, shape (n,)."""
    poses = hand.forward_kinematics(q)
    T_b_a = se3.inverse(poses[b]) @ poses[a]
    one, other = hand.links[a], hand.links[b]
    return min(
        _nearest(other.distance_field, T_b_a[None], one.surface.points)[0],
        _nearest(one.distance_field, se3.inverse(T_b_a)[None], other.surface.points)[0],
    )


def _close_finger(
    hand: Hand,
    obj: ObjectModel,
    T_hand_object: Array,
    finger: Finger,
    q: Array,
    rng: np.random.Generator,
) -> Array | None:
    """`q` with the joints of `finger` moved until it touches; None when no path touches."""
    joints, along = list(finger.joints), np.linspace(0, 1, PATH_STEPS)
    targets = rng.uniform(hand.lower[joints], hand.upper[joints], size=(PATHS, len(joints)))
    paths = np.tile(q, (PATHS, PATH_STEPS, 1))
    paths[:, :, joints] += along[:, None] * (targets - q[joints])[:, None, :]
    flat = paths.reshape(-1, len(q))
    gaps = object_gap(hand, obj, T_hand_object, flat, finger.links, from_object=False)
    touching = np.flatnonzero((gaps.reshape(PATHS, PATH_STEPS) < 0).any(axis=1))
    if len(touching) == 0:
        return None
    path = paths[rng.choice(touching)]
    gaps = object_gap(hand, obj, T_hand_object, path, finger.links)
    first = int(np.argmax(gaps < 0))
    if first == 0:
        return None
    free, hit = path[first - 1], path[first]
    free_gap = gaps[first - 1]
    while free_gap > TOUCH and np.abs(hit - free).max() > 1e-6:
        middle = (free + hit) / 2
        gap = object_gap(hand, obj, T_hand_object, middle[None], finger.links)[0]
        if gap < 0:
            hit = middle
        else:
            free, free_gap = middle, gap
    return np.asarray(free)


def _pairs_to_check(hand: Hand, open_q: Array) -> list[tuple[int, int]]:
    """Pairs of links of different fingers, or finger and palm, that are apart in the open hand."""
    groups = [hand.palm_links, *(finger.links for finger in hand.fingers)]
    return [
        (a, b)
        for i, one in enumerate(groups)
        for other in groups[i + 1 :]
        for a in one
        for b in other
        if link_gap(hand, open_q, a, b) > CLEARANCE
    ]


def _placement(hand: Hand, obj: ObjectModel, rng: np.random.Generator) -> Array:
    """A random object pose, (4, 4), with some point of its inside between the fingers."""
    q = rng.uniform(hand.lower, hand.upper)
    T = np.eye(4)
    T[:3, :3] = se3.random_rotation(rng)
    held = (obj.centre + rng.choice(obj.surface.points)) / 2
    T[:3, 3] = _centre_of_fingers(hand, q) + rng.normal(scale=0.01, size=3) - T[:3, :3] @ held
    return T


def _centre_of_fingers(hand: Hand, q: Array) -> Array:
    """Mean of the fingers' centres [m], hand frame, at joint positions `q`, (n,); shape (3,)."""
    centres = [_link_centres(hand, q[None], f.links)[0].mean(axis=0) for f in hand.fingers]
    return np.asarray(np.mean(centres, axis=0))


def _link_centres(hand: Hand, q: Array, links: tuple[int, ...]) -> Array:
    """Mean surface points of some links, hand frame [m]; (b, n) -> (b, len(links), 3)."""
    T = hand.forward_kinematics(q)[:, list(links)]
    centres = np.stack([hand.links[i].surface.points.mean(axis=0) for i in links])
    return np.asarray(np.einsum("blij,lj->bli", T[..., :3, :3], centres) + T[..., :3, 3])


def _nearest(distance_field: DistanceField, T: Array, points: NDArray[np.float32]) -> Array:
    """Smallest signed distance [m] of points (k, 3) at poses `T`, (b, 4, 4); shape (b,)."""
    moved = points @ np.swapaxes(T[:, :3, :3], -1, -2) + T[:, None, :3, 3]
    distances = distance_field.distance(moved.reshape(-1, 3))
    return np.asarray(distances.reshape(len(T), -1).min(axis=1))


def _backdrop(
    hand: Hand, T_camera_hand: Array, distance: tuple[float, float], rng: np.random.Generator
) -> Array:
    """Pose, (4, 4), of a wall (normal: its z axis) that stands clear of the hand's reach."""
    centre, radius = hand.reach
    tilt = rng.normal(scale=np.radians(12), size=2)
    T = se3.exp(np.array([tilt[0], tilt[1], 0, 0, 0, 0]))
    T[:3, 3] = se3.transform(T_camera_hand, centre[None])[0]
    T[:3, 3] += (radius + rng.uniform(*distance)) * T[:3, 2]
    return T
