"""Point-to-plane ICP of rigid models with a distance field, many poses at once."""

import warp as wp

from inhand.kernels.bodies import nearest_body
from inhand.kernels.fields import Fields
from inhand.kernels.transforms import rigid

# Relative damping: directions that the points leave open do not move.
DAMPING = 1.0e-3


@wp.struct
class RigidModel:
    """One rigid body made of parts."""

    fields: Fields
    """Distance fields of the parts."""
    T_model_part: wp.array(dtype=wp.mat44)
    used: wp.array(dtype=int)
    """Per part, 0 leaves it out."""
    centre: wp.vec3
    """Point that rotations are about [m], model frame."""
    radius: float
    """Size of the model [m]; makes rotations and translations comparable."""


@wp.kernel
def align_to_points(
    model: RigidModel,
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    max_distance: float,
    cosine: float,
    iterations: int,
    T_camera_model: wp.array(dtype=wp.mat44),
    first: int,
):
    """One work item a pose: Gauss-Newton iterations of point-to-plane ICP, in place.

    A point x in the model's frame corresponds to the surface point x - d g, with normal g, where d
    is the signed distance and g its gradient. Its plane distance is then d itself.

    Args (beyond the obvious):
        max_distance: points farther from the surface do not take part [m].
        cosine: nor do points whose normal's cosine to g is smaller.
    """
    i = first + wp.tid()
    T = T_camera_model[i]
    rotation = wp.normalize(wp.quat_from_matrix(T[:3, :3]))
    origin = T[:3, 3]
    for _iteration in range(iterations):
        # Blocks of the normal equations, for rotation a times radius and translation b.
        aa = wp.mat33()
        ab = wp.mat33()
        bb = wp.mat33()
        ra = wp.vec3()
        rb = wp.vec3()
        count = float(0.0)
        for k in range(points.shape[0]):
            x = wp.quat_rotate_inv(rotation, points[k] - origin)
            d, g, _link = nearest_body(
                model.fields, model.T_model_part, 0, model.used, 0, x, max_distance
            )
            if wp.abs(d) >= max_distance:
                continue
            if wp.dot(g, wp.quat_rotate_inv(rotation, normals[k])) < cosine:
                continue
            moment = wp.cross(x - model.centre, g) / model.radius
            aa += wp.outer(moment, moment)
            ab += wp.outer(moment, g)
            bb += wp.outer(g, g)
            ra -= d * moment
            rb -= d * g
            count += 1.0
        if count < 6.0:
            break
        damping = DAMPING * count * wp.identity(n=3, dtype=float)
        # Solved by the Schur complement of the translation's block.
        bb_inverse = wp.inverse(bb + damping)
        eliminated = ab * bb_inverse
        turn = wp.inverse(aa + damping - eliminated * wp.transpose(ab)) * (ra - eliminated * rb)
        shift = bb_inverse * (rb - wp.transpose(ab) * turn)
        # The points move by (turn, shift) in the model's frame; the model moves the other way.
        angle = wp.length(turn) / model.radius
        step = wp.quat_from_axis_angle(wp.normalize(turn), angle)
        pivot = origin + wp.quat_rotate(rotation, model.centre)
        rotation = wp.normalize(rotation * wp.quat_inverse(step))
        origin = pivot - wp.quat_rotate(rotation, model.centre + shift)
        if wp.length(shift) + wp.length(turn) < 1.0e-6:
            break
    T_camera_model[i] = rigid(wp.quat_to_matrix(rotation), origin)
