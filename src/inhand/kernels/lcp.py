"""Largest common pointset (LCP): how many points of one surface lie on the other."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.kernels.bodies import nearest_body
from inhand.kernels.fields import Fields, field_at
from inhand.kernels.launch import computed
from inhand.kernels.transforms import to_local


@wp.kernel
def count_points_on_model(
    T_camera_model: wp.array(dtype=wp.mat44),
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    fields: Fields,
    distance: float,
    cosine: float,
    share: wp.array(dtype=float),
    first: int,
):
    """One work item a pose: share of the points that lie on the model with agreeing normals."""
    i = first + wp.tid()
    T = T_camera_model[i]
    count = int(0)
    for k in range(points.shape[0]):
        value = field_at(fields, 0, to_local(T, points[k]))
        if wp.abs(value[0]) >= distance:
            continue
        if wp.dot(normals[k], wp.transform_vector(T, value[1:4])) > cosine:
            count += 1
    share[i] = float(count) / float(points.shape[0])


def pose_lcp(
    T_camera_model: NDArray[Any],
    points: NDArray[np.float32],
    normals: NDArray[np.float32],
    fields: Any,
    distance: float,
    normal_angle: float,
    device: str,
) -> NDArray[np.float32]:
    """LCP of poses: share of the points nearer than `distance` to the model, shape (m,), 0 to 1.

    Args:
        T_camera_model: poses of the model, shape (m, 4, 4).
        points: observed points [m], camera frame, shape (n, 3).
        normals: their unit normals, shape (n, 3).
        fields: the model's distance field, from `pack_fields`.
        distance: [m].
        normal_angle: largest angle between the normals of point and model [rad].
        device: Warp device name.
    """
    inputs = [
        wp.array(T_camera_model, dtype=wp.mat44, device=device),
        wp.array(points, dtype=wp.vec3, device=device),
        wp.array(normals, dtype=wp.vec3, device=device),
        fields,
        distance,
        float(np.cos(normal_angle)),
    ]
    shape, work = (len(T_camera_model),), 2 * len(points)
    return computed(count_points_on_model, shape, float, inputs, device, work_per_item=work)


@wp.struct
class SceneCloud:
    """The scene cloud P_S, indexed for nearest-neighbour queries."""

    grid: wp.uint64
    points: wp.array(dtype=wp.vec3)
    normals: wp.array(dtype=wp.vec3)
    distance: float
    """Neighbours beyond this do not count [m]."""
    cosine: float
    """Smallest cosine of the angle between agreeing normals."""


@wp.func
def lies_on_scene(scene: SceneCloud, p: wp.vec3, n: wp.vec3):
    """1 if the scene point nearest to `p` is near enough and its normal agrees with `n`, else 0."""
    nearest = int(-1)
    squared = scene.distance * scene.distance
    query = wp.hash_grid_query(scene.grid, p, scene.distance)
    candidate = int(0)
    while wp.hash_grid_query_next(query, candidate):
        d = wp.length_sq(scene.points[candidate] - p)
        if d < squared:
            squared = d
            nearest = candidate
    if nearest < 0 or wp.dot(scene.normals[nearest], n) <= scene.cosine:
        return 0
    return 1


@wp.kernel
def match_finger_points(
    scene: SceneCloud,
    T_camera_link: wp.array(dtype=wp.mat44),
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    link: wp.array(dtype=int),
    samples: wp.array(dtype=int),
    fields: Fields,
    obstacle: wp.array(dtype=int),
    match: wp.array(dtype=int),
    clearance: wp.array(dtype=float),
    first: int,
):
    """One work item a configuration and surface sample: the two judgements of Alg. 1.

    Args (beyond the obvious):
        T_camera_link: link poses of all configurations, flat (c * links).
        points, normals, link: surface samples of all links.
        samples: indices of the finger's own samples, shape (s,).
        obstacle: flat (links, links), 1 where the first link must not penetrate the second.
        match: out, flat (c, s), 1 where the sample lies on the scene.
        clearance: out, flat (c, s), signed distance to the nearest obstacle [m], at most 0.
    """
    item = first + wp.tid()
    n_links = fields.start.shape[0]
    first_pose = (item // samples.shape[0]) * n_links
    i = samples[item % samples.shape[0]]
    T = T_camera_link[first_pose + link[i]]
    p = wp.transform_point(T, points[i])
    match[item] = lies_on_scene(scene, p, wp.transform_vector(T, normals[i]))
    depth, _gradient, _link = nearest_body(
        fields, T_camera_link, first_pose, obstacle, link[i] * n_links, p, 0.0
    )
    clearance[item] = depth
