"""Warp kernels of the scene generator: rendering, surface angles, and gaps between bodies."""

import warp as wp

from inhand.kernels.depth import Pinhole
from inhand.kernels.fields import Fields, field_at

AMBIENT = wp.constant(0.25)
"""Share of its colour that a surface shows without any lamp; the shares add up to 1."""
HEADLIGHT = wp.constant(0.35)
"""Share of its colour that the lamp at the camera adds, seen head-on."""
LAMP = wp.constant(0.4)
"""Share of its colour that the far lamp adds, hit head-on."""


@wp.struct
class Bodies:
    """The posed meshes of a scene, one entry a body."""

    mesh: wp.array(dtype=wp.uint64)
    R_body_camera: wp.array(dtype=wp.mat33)
    eye: wp.array(dtype=wp.vec3)
    """Place of the camera in the body's frame [m]."""
    sphere: wp.array(dtype=wp.vec4)
    """Bounding sphere, camera frame: its centre [m], and the square of the centre's distance from
    the camera minus the square of the radius [m^2]."""
    colour: wp.array(dtype=wp.vec3)
    """Red, green, blue, 0 to 1."""


@wp.struct
class Layers:
    """What is rendered, one entry a pixel; depth [m] is 0 and body -1 where nothing is hit."""

    depth: wp.array(dtype=float)
    body: wp.array(dtype=int)
    depth_alone: wp.array(dtype=float)
    """Depth of body 0 as if there were nothing else [m]."""
    rgb: wp.array(dtype=wp.vec3ub)


@wp.kernel
def render_layers(camera: Pinhole, bodies: Bodies, lamp: wp.vec3, layers: Layers, first: int):
    """One work item a pixel.

    Args (beyond the obvious):
        lamp: unit direction to a far lamp, camera frame.
    """
    i = first + wp.tid()
    ray = wp.normalize(
        wp.vec3(
            (float(i % camera.width) - camera.cx) / camera.fx,
            (float(i // camera.width) - camera.cy) / camera.fy,
            1.0,
        )
    )
    nearest = float(1.0e6)
    alone = float(0.0)
    winner = int(-1)
    normal = wp.vec3(0.0, 0.0, 0.0)
    for b in range(bodies.mesh.shape[0]):
        s = bodies.sphere[b]
        along = wp.dot(wp.vec3(s[0], s[1], s[2]), ray)
        if along * along > s[3] and (along > 0.0 or s[3] < 0.0):
            R = bodies.R_body_camera[b]
            hit = wp.mesh_query_ray(bodies.mesh[b], bodies.eye[b], R * ray, nearest)
            if hit.result:
                nearest = hit.t
                winner = b
                normal = wp.transpose(R) * hit.normal
        if b == 0 and winner == 0:
            alone = nearest * ray[2]
    layers.depth_alone[i] = alone
    layers.body[i] = winner
    if winner < 0:
        layers.depth[i] = 0.0
        layers.rgb[i] = wp.vec3ub(wp.uint8(0), wp.uint8(0), wp.uint8(0))
        return
    layers.depth[i] = nearest * ray[2]
    normal = wp.normalize(normal)
    facing = -wp.dot(normal, ray)
    if facing < 0.0:  # a face seen from behind
        normal = -normal
        facing = -facing
    light = AMBIENT + HEADLIGHT * facing + LAMP * wp.max(wp.dot(normal, lamp), 0.0)
    c = bodies.colour[winner] * light * 255.0
    layers.rgb[i] = wp.vec3ub(wp.uint8(c[0]), wp.uint8(c[1]), wp.uint8(c[2]))


@wp.func
def point_at(camera: Pinhole, depth: wp.array2d(dtype=float), v: int, u: int):
    """The point that pixel (u, v) shows [m], camera frame; zero if none, or outside the image."""
    z = float(0.0)
    if u >= 0 and v >= 0 and u < camera.width and v < camera.height:
        z = depth[v, u]
    return wp.vec3(
        z * (float(u) - camera.cx) / camera.fx, z * (float(v) - camera.cy) / camera.fy, z
    )


@wp.func
def smaller_step(p: wp.vec3, ahead: wp.vec3, behind: wp.vec3):
    """`ahead - p` or `p - behind`, whichever changes depth less; zero if both show nothing."""
    step = wp.vec3(0.0, 0.0, 0.0)
    if ahead[2] > 0.0:
        step = ahead - p
    if behind[2] > 0.0 and (ahead[2] == 0.0 or wp.abs(p[2] - behind[2]) < wp.abs(step[2])):
        step = p - behind
    return step


@wp.kernel
def incidence_angles(
    camera: Pinhole, depth: wp.array2d(dtype=float), angle: wp.array(dtype=float), first: int
):
    """One work item a pixel: angle between line of sight and surface normal [rad].

    From differences to the neighbours that are nearer in depth, so that a depth edge is not taken
    for a grazing surface; pi/2 without surface or neighbours.
    """
    i = first + wp.tid()
    u = i % camera.width
    v = i // camera.width
    angle[i] = wp.half_pi
    p = point_at(camera, depth, v, u)
    if p[2] == 0.0:
        return
    right = point_at(camera, depth, v, u + 1)
    left = point_at(camera, depth, v, u - 1)
    below = point_at(camera, depth, v + 1, u)
    above = point_at(camera, depth, v - 1, u)
    normal = wp.cross(smaller_step(p, right, left), smaller_step(p, below, above))
    length = wp.length(normal) * wp.length(p)
    if length > 0.0:
        angle[i] = wp.acos(wp.min(wp.abs(wp.dot(normal, p)) / length, 1.0))


@wp.func
def nearest_sample(
    fields: Fields,
    body: int,
    points: wp.array(dtype=wp.vec3),
    start: int,
    end: int,
    T_body_points: wp.mat44,
    nearest: float,
    stop: float,
):
    """The smaller of `nearest` and the signed distance of points[start:end] to a body [m]."""
    k = start
    while k < end and nearest >= stop:
        p = wp.transform_point(T_body_points, points[k])
        nearest = wp.min(nearest, field_at(fields, body, p)[0])
        k += 1
    return nearest


@wp.kernel
def body_gaps(
    fields: Fields,
    points: wp.array(dtype=wp.vec3),
    start: wp.array(dtype=int),
    most: int,
    stop: float,
    one: wp.array(dtype=int),
    other: wp.array(dtype=int),
    T_other_one: wp.array(dtype=wp.mat44),
    gap: wp.array(dtype=float),
    first: int,
):
    """One work item a pair of bodies: signed distance between their surfaces [m].

    Surface samples of either body are held against the distance field of the other. Where the
    bounding spheres are apart, their distance stands for the bodies'.

    Args (beyond the obvious):
        points, start: surface samples of all bodies, body frame, and where each body's begin.
        most: how many samples of a body are used.
        stop: a distance below this need not be exact [m].
        one, other: the bodies of every pair.
    """
    i = first + wp.tid()
    a = one[i]
    b = other[i]
    T = T_other_one[i]
    s = fields.sphere[a]
    t = fields.sphere[b]
    centre = wp.transform_point(T, wp.vec3(s[0], s[1], s[2]))
    apart = wp.length(centre - wp.vec3(t[0], t[1], t[2])) - s[3] - t[3]
    if apart > 0.0:
        gap[i] = apart
        return
    nearest = float(1.0e6)
    end = wp.min(start[a] + most, start[a + 1])
    nearest = nearest_sample(fields, b, points, start[a], end, T, nearest, stop)
    end = wp.min(start[b] + most, start[b + 1])
    back = wp.inverse(T)
    gap[i] = nearest_sample(fields, a, points, start[b], end, back, nearest, stop)
