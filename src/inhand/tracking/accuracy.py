"""How well a pose is known, and how likely it is right."""

import numpy as np
from scipy.special import gammainc

from inhand.tracking.gaussian import Array


def surface_within(covariance: Array, form: Array, distance: float) -> float:
    """Probability that the surface is off by less than a distance [m], root mean square.

    The square is a weighted sum of chi squares. It is taken to be distributed as the gamma
    distribution of the same mean and variance (Satterthwaite, 1946).

    Args:
        covariance: of the pose's twist about the object's centre, in its frame, shape (6, 6).
        form: the object's `surface_form`, shape (6, 6).
        distance: the distance [m].
    """
    product = form @ covariance
    mean, variance = np.trace(product), 2 * np.trace(product @ product)
    return float(gammainc(mean**2 / variance, distance**2 * mean / variance))


def sensor_covariance(T: Array, centre: Array, along: float, across: float) -> Array:
    """Covariance (6, 6) of a pose's twist by what a sensor is off by everywhere.

    Args:
        T: the pose, camera frame, shape (4, 4).
        centre: the object's centre, object frame [m], shape (3,).
        along, across: sds along and across the line of sight [m].
    """
    sight = T[:3, :3] @ centre + T[:3, 3]
    sight /= np.linalg.norm(sight)
    covariance = np.zeros((6, 6))
    covariance[3:, 3:] = across**2 * np.eye(3) + (along**2 - across**2) * np.outer(sight, sight)
    return covariance
