"""How well a pose is known, and how likely it is right."""

import numpy as np
from scipy.special import gammainc

from inhand.object_model import ObjectModel
from inhand.tracking.gaussian import Array


def surface_form(obj: ObjectModel) -> Array:
    """Quadratic form, shape (6, 6), of what a twist does to the object's surface.

    `twist @ form @ twist` is the mean square [m^2] of how far the surface moves along its normals;
    the twist is about the object's centre, in its frame. What moves a surface in itself, such as
    the turn of a can about its axis, counts as nothing.
    """
    points, normals = obj.surface.points - obj.centre, obj.surface.normals
    J = np.concatenate([np.cross(points, normals), normals], axis=1)
    return np.asarray(J.T @ J / len(J))


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
