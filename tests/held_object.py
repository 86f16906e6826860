"""A small scene for the tests of the stages: the built-in hand around one of the built-in objects.

The hand points up in the image, half a metre away, and is seen obliquely; nothing is behind it.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from inhand.builtin.hand import write_hand
from inhand.builtin.objects import OBJECTS
from inhand.camera import Camera
from inhand.config import ObservationConfig
from inhand.geometry.se3 import exp
from inhand.hand import Hand
from inhand.kernels.depth import DepthRenderer
from inhand.object_model import ObjectModel
from inhand.packed import PackedHand, PackedObject
from inhand.stages.observation import Observation, observe
from inhand.stages.results import HandState, Segment

CAMERA = Camera(fx=500, fy=500, cx=159.5, cy=119.5, width=320, height=240)
Q = np.array([1.2, 0.5, 1.0, 0.7])
"""Joint vector: left and right finger, proximal and distal [rad]."""


@dataclass(frozen=True)
class HeldObject:
    """Ground truth and what the first stages make of it."""

    hand: PackedHand
    obj: PackedObject
    T_camera_object: np.ndarray
    """Pose of the object, shape (4, 4)."""
    hand_state: HandState
    """The true state of the hand."""
    depth: np.ndarray
    """Depth image [m]."""
    observation: Observation
    segment: Segment
    """Scene points on the object, with their distances to the hand."""


@cache
def built_in_hand() -> PackedHand:
    with tempfile.TemporaryDirectory() as folder:
        return PackedHand(Hand.from_urdf(write_hand(folder)), "cpu")


@cache
def built_in_object(name: str) -> PackedObject:
    return PackedObject(ObjectModel.from_mesh(OBJECTS[name]()), "cpu")


@cache
def held_object(name: str, aside: float = 0.0) -> HeldObject:
    """The scene; `aside`: how far to the right of its usual place everything is [m]."""
    hand, obj = built_in_hand(), built_in_object(name)
    # The hand's z axis, out of the palm, is up in the image; its y axis points at the camera.
    T_camera_hand = np.eye(4)
    T_camera_hand[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    T_camera_hand[:3, 3] = [0.03 + aside, 0.09, 0.5]
    T_camera_hand = T_camera_hand @ exp(np.array([0.5, -0.3, 0.4, 0, 0, 0]))
    T_hand_object = exp(np.array([0.3, 1.1, -0.4, 0.002, -0.01, 0.15]))
    T_camera_object = T_camera_hand @ T_hand_object
    poses = hand.link_poses(Q[None], T_camera_hand[None])[0]
    state = HandState(Q, T_camera_hand, poses, np.ones(len(poses), dtype=bool))
    meshes = [*(link.mesh for link in hand.hand.links), obj.model.mesh]
    depth, label = DepthRenderer(meshes).render(
        CAMERA, np.concatenate([state.T_camera_link, T_camera_object[None]])
    )
    observation = observe(
        depth,
        CAMERA,
        T_camera_hand,
        hand.hand.reach,
        obj.model.diameter,
        ObservationConfig(),
        "cpu",
    )
    u, v = np.rint(CAMERA.project(observation.points)).astype(int).T
    on_object = label[v, u] == len(meshes) - 1
    points = observation.points[on_object]
    segment = Segment(
        points,
        observation.normals[on_object],
        distance_to_hand(points, hand, state),
        np.ones(len(points), dtype=np.float32),
    )
    return HeldObject(hand, obj, T_camera_object, state, depth, observation, segment)


def distance_to_hand(
    points: np.ndarray, hand: PackedHand, state: HandState, links: Sequence[int] | None = None
) -> np.ndarray:
    """Signed distance [m] of points (n, 3), camera frame, to some links or the hand, shape (n,)."""
    distances = [
        hand.hand.links[i].distance_field.distance(
            (points - state.T_camera_link[i][:3, 3]) @ state.T_camera_link[i][:3, :3]
        )
        for i in (range(len(hand.hand.links)) if links is None else links)
    ]
    return np.min(distances, axis=0).astype(np.float32)
