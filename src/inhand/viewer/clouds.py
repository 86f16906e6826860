"""Clouds of points, coloured as the camera sees them or by what a stage made of them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.geometry.se3 import Array, transform
from inhand.hand import Hand
from inhand.overlay import HAND_COLOUR, OBJECT_COLOUR, Colour, Pixels
from inhand.packed import PackedHand, device_poses
from inhand.stages.observation import Observation
from inhand.stages.results import HandState, Segment
from inhand.stages.segmentation import FAR

EXPLAINED = 0.003
"""Points this near to the hand are drawn as the hand's [m], as the segmentation counts them."""
GREY: Colour = (150, 150, 155)
DIM: Colour = (70, 70, 78)


@dataclass(frozen=True, eq=False)
class Cloud:
    """Coloured points."""

    points: NDArray[np.float32]
    """Points [m], camera frame, shape (n, 3)."""
    colours: Pixels
    """Red, green, blue, 0 to 255, shape (n, 3)."""


def plain(observation: Observation) -> Cloud:
    """The scene cloud, lit from the camera so that its shape can be seen."""
    towards = -observation.points / np.linalg.norm(observation.points, axis=1, keepdims=True)
    facing = np.clip((observation.normals * towards).sum(axis=1, keepdims=True), 0, 1)
    return Cloud(observation.points, ((0.3 + 0.7 * facing) * 220 + np.zeros(3)).astype(np.uint8))


def by_hand(observation: Observation, state: HandState, hand: PackedHand) -> Cloud:
    """The scene cloud, the hand's points in its colour."""
    links = np.ones(len(hand.hand.links), dtype=bool)
    poses = device_poses(state.T_camera_link, hand.device)
    distance = hand.distances(observation.points, poses, links, FAR)[0]
    colours = np.where(distance[:, None] < EXPLAINED, HAND_COLOUR, GREY)
    return Cloud(observation.points, colours.astype(np.uint8))


def by_weight(observation: Observation, segment: Segment) -> Cloud:
    """The scene cloud, dim, with the object segment in the object's colour by weight."""
    share = 0.3 + 0.7 * segment.weight[:, None] / max(float(segment.weight.max()), 1e-6)
    of_segment = share * np.array(OBJECT_COLOUR)
    dim = np.broadcast_to(DIM, observation.points.shape)
    return Cloud(
        np.concatenate([observation.points, segment.points]),
        np.concatenate([dim, of_segment]).astype(np.uint8),
    )


def scene_cloud(
    depth: NDArray[np.float32],
    camera: Camera,
    pixels: Pixels,
    *,
    sphere: tuple[Array, float] | None = None,
    step: int = 1,
) -> tuple[NDArray[np.float32], Pixels, NDArray[np.intp]]:
    """The points of a depth image with their colours.

    Args:
        depth: depth image [m], shape (H, W), 0 where there is no reading.
        camera: its camera.
        pixels: colours by pixel, shape (H, W, 3).
        sphere: only points in the sphere of this centre [m] and radius [m], camera frame.
        step: only every so-many-th pixel along either side.

    Returns:
        points [m], camera frame, shape (n, 3); their colours, shape (n, 3); and the flat index of
        the pixel of each, shape (n,).
    """
    v, u = np.nonzero(depth[::step, ::step] > 0)
    v, u = v * step, u * step
    z = depth[v, u].astype(np.float64)
    points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], axis=1)
    if sphere is not None:
        near = np.linalg.norm(points - sphere[0], axis=1) < sphere[1]
        points, v, u = points[near], v[near], u[near]
    return points.astype(np.float32), pixels[v, u], v * depth.shape[1] + u


def reach_sphere(hand: Hand, T_camera_hand: Array, margin: float = 0.05) -> tuple[Array, float]:
    """Centre [m], camera frame, and radius [m] of a sphere around all that the hand can reach.

    Args:
        hand: the hand.
        T_camera_hand: its wrist pose, shape (4, 4).
        margin: added to the radius [m].
    """
    centre, radius = hand.reach
    return transform(T_camera_hand, centre[None])[0], radius + margin


def score_colours(scores: NDArray[np.float64]) -> Pixels:
    """Colours of scores, shape (m, 3): the lowest violet, the highest yellow."""
    low, high = np.array([90, 40, 140]), np.array([255, 225, 60])
    span = np.ptp(scores) if len(scores) else 0.0
    t = (scores - scores.min()) / span if span > 0 else np.ones(len(scores))
    return np.asarray(low + t[:, None] * (high - low)).astype(np.uint8)
