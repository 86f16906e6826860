"""The paper's search of the finger angles: a particle swarm per finger on the cost of Alg. 1
(section IV-A)."""

from collections.abc import Callable
from functools import partial

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.config import HandStateConfig
from inhand.geometry.se3 import Array
from inhand.hand import Finger
from inhand.kernels.launch import launch
from inhand.kernels.lcp import SceneCloud, match_finger_points
from inhand.packed import PackedHand, device_poses
from inhand.stages.observation import Observation
from inhand.stages.results import HandState, Wrist

GRID_CELLS = 64


def search_fingers(
    observation: Observation,
    wrist: Wrist,
    hand: PackedHand,
    config: HandStateConfig,
    rng: np.random.Generator,
) -> HandState:
    """Joint angles, one finger after the other, the nearest to the camera first."""
    model, T = hand.hand, wrist.T_camera_hand
    cost = FingerCost(observation, wrist, hand, config)
    q = (model.lower + model.upper) / 2
    placed = list(model.palm_links)
    for finger in _nearest_first(hand, q, T):
        joints = list(finger.joints)
        finger_cost = partial(cost, finger, q, placed)
        q[joints] = minimise(finger_cost, model.lower[joints], model.upper[joints], config, rng)
        placed += finger.links
    poses = hand.link_poses(q[None], T[None])[0]
    return HandState(q, T, poses, np.ones(len(poses), dtype=bool))


def minimise(
    cost: Callable[[Array], Array],
    lower: Array,
    upper: Array,
    config: HandStateConfig,
    rng: np.random.Generator,
) -> Array:
    """Particle swarm: the best position found, shape (n,).

    Args:
        cost: costs, shape (p,), of positions, shape (p, n).
        lower: lower limits, shape (n,).
        upper: upper limits, shape (n,).
        config: number of particles and generations, and weights.
        rng: source of randomness.
    """
    x = rng.uniform(lower, upper, (config.particles, len(lower)))
    velocity = np.zeros_like(x)
    own, own_cost = x, cost(x)
    for _ in range(config.generations):
        swarm = own[own_cost.argmin()]
        keep, to_own, to_swarm = rng.uniform(size=(3, *x.shape))
        velocity = (
            config.swarm_inertia * keep * velocity
            + config.swarm_pull * to_own * (own - x)
            + config.swarm_pull * to_swarm * (swarm - x)
        )
        x = np.clip(x + velocity, lower, upper)
        new_cost = cost(x)
        better = new_cost < own_cost
        own = np.where(better[:, None], x, own)
        own_cost = np.where(better, new_cost, own_cost)
    return np.asarray(own[own_cost.argmin()])


class FingerCost:
    """The cost of Alg. 1 for configurations of one finger.

    The algorithm moves the scene cloud into the finger's frame; here the finger's points move into
    the camera's, so one index of the cloud serves all configurations. The published penalty reads
    -lambda - lambda d with d negative; the text asks for a cost that grows with the penetration, so
    it is lambda + lambda |d| here.
    """

    def __init__(
        self, observation: Observation, wrist: Wrist, hand: PackedHand, config: HandStateConfig
    ) -> None:
        self.wrist, self.hand, self.config = wrist, hand, config
        device = hand.device
        self.scene = SceneCloud()
        self.scene.points, self.scene.normals = observation.cloud_on_device
        self._grid = wp.HashGrid(GRID_CELLS, GRID_CELLS, GRID_CELLS, device=device)
        self._grid.build(self.scene.points, config.lcp_distance)
        self.scene.grid = self._grid.id
        self.scene.distance = config.lcp_distance
        self.scene.cosine = float(np.cos(config.lcp_normal_angle))

    def __call__(self, finger: Finger, q: Array, placed: list[int], particles: Array) -> Array:
        """Costs, shape (p,).

        Args:
            finger: the finger.
            q: joint vector of the hand, for the links in `placed`, shape (n,).
            placed: links that the finger must not penetrate.
            particles: configurations of the finger [rad], shape (p, finger's joints).
        """
        hand, device = self.hand, self.hand.device
        configurations = np.repeat(q[None], len(particles), axis=0)
        configurations[:, list(finger.joints)] = particles
        wrists = np.broadcast_to(self.wrist.T_camera_hand, (len(particles), 4, 4))
        ranges = [np.arange(*hand.point_start[[i, i + 1]]) for i in finger.links]
        samples = wp.array(np.concatenate(ranges), dtype=int, device=device)
        size = len(particles) * len(samples)
        match = wp.empty(size, dtype=int, device=device)
        clearance = wp.empty(size, dtype=float, device=device)
        inputs = [
            self.scene,
            device_poses(hand.link_poses(configurations, wrists), device),
            hand.points,
            hand.normals,
            hand.link,
            samples,
            hand.fields,
            wp.array(_obstacles(hand, finger, placed).reshape(-1), dtype=int, device=device),
            match,
            clearance,
        ]
        launch(match_finger_points, size, inputs, device, work_per_item=100)
        lcp = match.numpy().reshape(len(particles), -1).sum(axis=1)
        depth = -clearance.numpy().reshape(len(particles), -1).min(axis=1)
        penalty = self.config.collision_penalty * (1 + depth)
        return np.where(depth > self.config.collision_distance, penalty, -lcp).astype(np.float64)


def _obstacles(hand: PackedHand, finger: Finger, placed: list[int]) -> NDArray[np.int32]:
    """Which links, columns, each link of the finger, rows, must not penetrate, shape (L, L).

    A finger's first visible link overlaps the palm in the joint between them by construction.
    """
    chain = hand.hand.chain
    obstacles = np.zeros((len(hand.hand.links),) * 2, dtype=np.int32)
    obstacles[np.ix_(finger.links, placed)] = 1
    for link in finger.links:
        if not np.isin(chain.link_joint, chain.path(link)[1:]).any():
            obstacles[link, list(hand.hand.palm_links)] = 0
    return obstacles


def _nearest_first(hand: PackedHand, q: Array, T_camera_hand: Array) -> list[Finger]:
    """The fingers by the distance of their middle from the camera."""
    poses = hand.link_poses(q[None], T_camera_hand[None])[0]
    middles = np.stack([link.mesh.bounds.mean(axis=0) for link in hand.hand.links])
    middles = np.einsum("lij,lj->li", poses[:, :3, :3], middles) + poses[:, :3, 3]
    return sorted(
        hand.hand.fingers,
        key=lambda finger: float(np.linalg.norm(middles[list(finger.links)].mean(axis=0))),
    )
