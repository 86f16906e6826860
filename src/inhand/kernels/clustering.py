"""Grouping of poses around leaders: poses taken by falling score, each joining the first leader
that is near enough or becoming one.

Unlike single linkage, groups cannot grow along chains of neighbours, and every leader is the best
of its group. The decisions depend on one another, so a group is one work item, and the work stays
on the CPU.
"""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.geometry.symmetry import Symmetry
from inhand.kernels.launch import launch

wp.set_module_options({"enable_backward": False})

DEVICE = "cpu"


@wp.kernel
def lead_by_distance(
    points: wp.array(dtype=wp.vec3),
    reach: float,
    leaders: wp.array(dtype=int),
    leader: wp.array(dtype=int),
    first: int,
):
    """One work item in all: leader of every point, in the order of the points.

    Args (beyond the obvious):
        reach: a leader's group reaches this far [m].
        leaders: scratch.
        leader: out, index of the leading point.
    """
    count = int(first)
    for i in range(points.shape[0]):
        leader[i] = -1
        for k in range(count):
            if wp.length(points[i] - points[leaders[k]]) < reach:
                leader[i] = leaders[k]
                break
        if leader[i] < 0:
            leader[i] = i
            leaders[count] = i
            count += 1
