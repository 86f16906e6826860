"""Queries against one mesh: open directions, signed distance, and even subsets of its points.

They run once per model, while it is built, and always on the CPU.
"""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.kernels.launch import computed, launch

DEVICE = "cpu"
DIRECTIONS = 32
"""Rays over the half space in front of a surface point."""


@wp.kernel
def count_open_directions(
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    offset: float,
    reach: float,
    counts: wp.array(dtype=int),
    first: int,
):
    """One work item a point: how many of `directions` leave the mesh on the normal's side."""
    i = first + wp.tid()
    normal = normals[i]
    origin = points[i] + offset * normal
    count = wp.int32(0)
    for k in range(directions.shape[0]):
        ray = directions[k]
        # The set holds every direction with its opposite: exactly one of the two looks out.
        if wp.dot(ray, normal) > 0.02:
            hit = wp.mesh_query_ray(mesh, origin, ray, reach)
            if not hit.result:
                count += 1
    counts[i] = count


@wp.kernel
def fill_distance_field(
    mesh: wp.uint64,
    origin: wp.vec3,
    voxel: float,
    ny: int,
    nz: int,
    lower: wp.vec3,
    upper: wp.vec3,
    reach: float,
    values: wp.array(dtype=wp.vec4),
    first: int,
):
    """One work item a voxel: signed distance [m] and its unit gradient at the voxel's centre.

    `lower`, `upper`: corners of the mesh's bounding box [m]; beyond it, all is outside.
    """
    i = first + wp.tid()
    cell = wp.vec3(float(i // (ny * nz)), float((i // nz) % ny), float(i % nz))
    point = origin + voxel * cell
    query = wp.mesh_query_point_no_sign(mesh, point, reach)
    sign = float(1.0)
    if wp.min(point - lower) > 0.0 and wp.min(upper - point) > 0.0:
        sign = wp.mesh_query_point_sign_winding_number(mesh, point, reach, 2.0, 0.55).sign
    closest = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
    away = point - closest
    distance = wp.length(away)
    gradient = wp.mesh_eval_face_normal(mesh, query.face)
    # Closer than this the direction is rounding noise; the face's own normal is exact.
    if distance > 1.0e-4 * voxel:
        gradient = sign * away / distance
    values[i] = wp.vec4(sign * distance, gradient[0], gradient[1], gradient[2])


@wp.kernel
def find_closest(
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    reach: float,
    closest: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    first: int,
):
    """One work item a point: closest point of the mesh and the face normal there; both NaN where
    the mesh is farther than `reach` [m]."""
    i = first + wp.tid()
    query = wp.mesh_query_point_no_sign(mesh, points[i], reach)
    closest[i] = wp.vec3(wp.nan, wp.nan, wp.nan)
    normals[i] = wp.vec3(wp.nan, wp.nan, wp.nan)
    if query.result:
        closest[i] = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
        normals[i] = wp.mesh_eval_face_normal(mesh, query.face)


@wp.kernel
def farthest_points(
    points: wp.array(dtype=wp.vec3),
    squared: wp.array(dtype=float),
    chosen: wp.array(dtype=int),
    first: int,
):
    """One work item in all: greedy farthest-point order; `chosen[0]` is given.

    `squared`: squared distance [m^2] of every point to the chosen ones, infinite at the start.
    """
    last = chosen[first + wp.tid()]
    for k in range(1, chosen.shape[0]):
        pivot = points[last]
        best = float(-1.0)
        for i in range(points.shape[0]):
            away = points[i] - pivot
            d = wp.min(squared[i], wp.dot(away, away))
            squared[i] = d
            if d > best:
                best = d
                last = i
        chosen[k] = last


def device_mesh(
    vertices: NDArray[Any], faces: NDArray[Any], device: str = DEVICE, *, winding: bool = False
) -> Any:
    """A Warp mesh; `winding`: prepare it for winding-number queries."""
    return wp.Mesh(
        points=wp.array(vertices, dtype=wp.vec3, device=device),
        indices=wp.array(faces.reshape(-1), dtype=int, device=device),
        support_winding_number=winding,
    )


def open_directions(
    mesh: Any, points: NDArray[Any], normals: NDArray[Any], diameter: float
) -> NDArray[np.int32]:
    """Number of the `DIRECTIONS` rays from each point, on its normal's side, that leave the mesh.

    Args:
        mesh: from `device_mesh`.
        points: points on the surface [m], shape (n, 3).
        normals: unit normals, shape (n, 3).
        diameter: of the mesh [m].
    """
    vectors = (points, normals, _opposite_directions())
    arrays = [wp.array(x, dtype=wp.vec3, device=DEVICE) for x in vectors]
    inputs = [mesh.id, *arrays, 1e-4 * diameter, 2.0 * diameter]
    shape, work = (len(points),), 50 * DIRECTIONS
    return computed(count_open_directions, shape, int, inputs, DEVICE, work_per_item=work)


def _opposite_directions() -> NDArray[np.float64]:
    """Directions spread evenly over the sphere, each with its opposite, (2 * DIRECTIONS, 3)."""
    k = np.arange(DIRECTIONS) + 0.5
    z, turn = k / DIRECTIONS, np.pi * (1 + 5**0.5) * k  # a Fibonacci spiral on the half sphere
    ring = np.sqrt(1 - z**2)
    half = np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)
    return np.concatenate([half, -half])


def signed_distance_grid(
    mesh: Any,
    bounds: NDArray[Any],
    origin: NDArray[Any],
    voxel: float,
    shape: tuple[int, int, int],
    reach: float,
) -> NDArray[np.float32]:
    """Signed distance [m] and unit gradient at voxel centres, shape (*shape, 4).

    Args:
        mesh: from `device_mesh` with winding numbers, faces oriented outward.
        bounds: of the mesh [m], shape (2, 3).
        origin: centre of voxel (0, 0, 0) [m], shape (3,).
        voxel: edge length [m].
        shape: number of voxels along x, y, z.
        reach: no voxel is farther than this from the surface [m].
    """
    corner, lower, upper = (wp.vec3(*map(float, x)) for x in (origin, *bounds))
    inputs = [mesh.id, corner, voxel, shape[1], shape[2], lower, upper, reach]
    return computed(fill_distance_field, shape, wp.vec4, inputs, DEVICE, work_per_item=1000)


def closest_points(
    mesh: Any, points: NDArray[Any], reach: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Closest points of the mesh [m] and face normals there, both shaped as `points`, (..., 3).

    Both are NaN where the mesh is farther than `reach` [m].
    """
    queries = wp.array(points.reshape(-1, 3), dtype=wp.vec3, device=DEVICE)
    closest, normals = wp.empty_like(queries), wp.empty_like(queries)
    inputs = [mesh.id, queries, reach, closest, normals]
    launch(find_closest, len(queries), inputs, DEVICE, work_per_item=1000)
    return closest.numpy().reshape(points.shape), normals.numpy().reshape(points.shape)


def farthest_point_order(points: NDArray[Any], count: int, start: int) -> NDArray[np.int32]:
    """Indices of `count` points, each the farthest from all before it, beginning with `start`."""
    chosen = wp.full(count, start, dtype=int, device=DEVICE)
    squared = wp.full(len(points), np.inf, dtype=float, device=DEVICE)
    on_device = wp.array(points, dtype=wp.vec3, device=DEVICE)
    launch(farthest_points, 1, [on_device, squared, chosen], DEVICE)
    return np.asarray(chosen.numpy())
