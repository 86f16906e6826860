"""How precisely an image determines a pose of the object."""

import numpy as np

from inhand.config import PrecisionConfig
from inhand.geometry.se3 import Array, moved
from inhand.object_model import ObjectModel
from inhand.packed import PackedObject
from inhand.stages.evidence import Evidence
from inhand.stages.refinement import fit_to_field

LOOSE = 3
"""So many twists are probed, to both sides."""


def probes(
    T_camera_object: Array, evidence: Evidence, obj: PackedObject, config: PrecisionConfig
) -> Array:
    """Poses to either side of a pose, (2 * `LOOSE`, 4, 4), along the twists that are loosest.

    An image that hardly determines a direction does not pull a pose along it, but the score of
    where it may have slid to tells: it counts what the camera would see if the object were there.

    Args:
        T_camera_object: the pose, shape (4, 4).
        evidence: the image.
        obj: the object.
        config: parameters.
    """
    c, T = config, T_camera_object
    _, A, _ = fit_to_field(evidence, obj, c.image_weight, T[None], c.points, 1, (c.width, c.width))
    known = np.repeat([c.turn, c.shift], 3) ** -2.0
    twists, _ = loosest_twists(c.point_information * A[0] + np.diag(known), obj.model, T)
    ways = c.probe * twists[:LOOSE]
    return moved(T, np.concatenate([ways, -ways]), obj.model.centre)


def loosest_twists(
    information: Array, obj: ObjectModel, T_camera_object: Array
) -> tuple[Array, Array]:
    """Twists, (6, 6), along which the object's surface may be off, and by what sds [m], (6,).

    They are independent of each other, the loosest first; each moves the surface by 1 m, root mean
    square along its normals.

    Args:
        information: inverse covariance of the twist about the object's centre, shape (6, 6),
            camera axes.
        obj: the object.
        T_camera_object: its pose, shape (4, 4).
    """
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = T_camera_object[:3, :3]
    # Twists that are as likely lie on a sphere after this.
    whiten = np.linalg.inv(np.linalg.cholesky(information))
    root = whiten @ turn
    variances, axes = np.linalg.eigh(root @ obj.surface_form @ root.T)
    sds = np.sqrt(np.maximum(variances[::-1], 1e-18))
    return axes.T[::-1] @ whiten / sds[:, None], sds
