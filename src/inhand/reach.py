"""A sphere that holds the whole hand in every configuration within its joint limits.

The squared distance f between a fixed point and a point carried by joints is a smooth function of
the joint positions q. Between the nodes of a grid with steps h_i it exceeds the largest value at a
node by at most sum_i h_i^2 / 8 max |d2f / dq_i^2| (the error of multilinear interpolation), and
the second derivatives are bounded by the lengths of the chain. So a coarse grid gives a true
bound, a few percent above the smallest one. Chains of too many joints for a grid fall back on
their stretched length.
"""

from dataclasses import dataclass

import numpy as np

from inhand.geometry.se3 import Array
from inhand.kinematics import PRISMATIC, KinematicArrays

GRID_NODES = 2048  # configurations per link, at most


@dataclass(frozen=True, eq=False)
class _Journey:
    """Where the centre of one link's bounding sphere goes."""

    base: Array
    """A point of the root frame that stays within `length` of the centre, shape (3,)."""
    length: float
    """Stretched length of the chain from `base` to the centre [m]."""
    nodes: Array
    """The centre at the nodes of the grid, shape (k, 3); k = 0 where no grid is possible."""
    turn: Array
    """h M of each joint that moves the link: the step of its grid times the sum M of the
    multipliers of the joints that follow it, shape (d,)."""
    lever: Array
    """Bound on the centre's displacement per unit of those joints' motion, shape (d,)."""

    def distance(self, point: Array) -> float:
        """Bound on the distance of the centre from `point` of the root frame [m]."""
        stretched = float(np.linalg.norm(self.base - point)) + self.length
        if not len(self.nodes):
            return stretched
        at_nodes = ((self.nodes - point) ** 2).sum(axis=1).max()
        # d2f/dq2 = 2 (speed^2 + (centre - point) . acceleration), where speed <= M lever and
        # acceleration <= M^2 lever.
        between = (self.turn**2 / 4 * self.lever * (self.lever + stretched)).sum()
        return min(stretched, float(np.sqrt(at_nodes + between)))


def reach_sphere(
    chain: KinematicArrays, centres: Array, radii: Array, lower: Array, upper: Array
) -> tuple[Array, float]:
    """Centre (3,) and radius [m], in the root frame, of a sphere around all configurations.

    Args:
        chain: the hand's joints and links.
        centres: centres of the links' bounding spheres in the links' frames [m], shape (L, 3).
        radii: their radii [m], shape (L,).
        lower: limits of the independent joints [rad, m], shape (n,).
        upper: limits of the independent joints [rad, m], shape (n,).
    """
    journeys = [_travel(chain, i, c, lower, upper) for i, c in enumerate(centres)]
    low, high = [], []
    for journey, radius in zip(journeys, radii, strict=True):
        points = journey.nodes
        if not len(points):
            points = journey.base + np.array([[-journey.length], [journey.length]])
        low.append(points.min(axis=0) - radius)
        high.append(points.max(axis=0) + radius)
    middle = (np.min(low, axis=0) + np.max(high, axis=0)) / 2
    return middle, max(j.distance(middle) + float(r) for j, r in zip(journeys, radii, strict=True))


def _travel(
    chain: KinematicArrays, link: int, centre: Array, lower: Array, upper: Array
) -> _Journey:
    path, sources = chain.part([link])
    lower, upper = lower[sources], upper[sources]
    count = len(sources)
    if count == 0:
        fixed = path.link_poses(np.zeros(0))[0]
        point = fixed[:3, :3] @ centre + fixed[:3, 3]
        return _Journey(point, 0.0, point[None], np.zeros(0), np.zeros(0))

    # Stretched length behind each joint: offsets and slides up to the link's centre.
    slides = np.abs([path.joint_positions(lower), path.joint_positions(upper)]).max(axis=0)
    slides[path.kind != PRISMATIC] = 0.0
    tip = path.T_joint_link[0, :3, :3] @ centre + path.T_joint_link[0, :3, 3]
    hops = np.append(np.linalg.norm(path.T_parent_joint[1:, :3, 3], axis=1), np.linalg.norm(tip))
    stretched = np.cumsum((hops + np.append(slides[1:], 0.0))[::-1])[::-1]
    lever = np.where(path.kind == PRISMATIC, 1.0, stretched)

    steps = min(int(GRID_NODES ** (1 / count) + 1e-9), 65)
    nodes = np.zeros((0, 3))
    if steps >= 2:
        axes = [np.linspace(a, b, steps) for a, b in zip(lower, upper, strict=True)]
        q = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, count)
        poses = path.link_poses(q)[:, 0]
        nodes = poses[:, :3, :3] @ centre + poses[:, :3, 3]
    followers = np.arange(count)[:, None] == path.source
    return _Journey(
        base=path.T_parent_joint[0, :3, 3],
        length=float(stretched[0] + slides[0]),
        nodes=nodes,
        turn=(upper - lower) / max(steps - 1, 1) * (followers * np.abs(path.multiplier)).sum(1),
        lever=(followers * lever).max(axis=1),
    )
