"""Watertight solids from outlines: lofts, solids of revolution and stacked extrusions.

An outline is a closed polygon, shape (k, 2), counter-clockwise, without a repeated end point.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import Delaunay

from inhand.geometry.mesh import TriangleMesh

Array = NDArray[np.float64]

CIRCLE_SEGMENTS = 64


def circle(radius: float, centre: ArrayLike = (0.0, 0.0), segments: int = CIRCLE_SEGMENTS) -> Array:
    """Outline of a circle, shape (segments, 2)."""
    angle = np.arange(segments) * 2 * np.pi / segments
    return np.asarray(centre) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def rounded_rectangle(width: float, height: float, radius: float) -> Array:
    """Outline of a rectangle centred at the origin with rounded corners.

    The number of points does not depend on the sizes, so outlines can be lofted into each other.
    """
    corner = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (
        np.array([width, height]) / 2 - radius
    )
    angle = np.linspace(0, np.pi / 2, CIRCLE_SEGMENTS // 8 + 1)
    arcs = [
        centre + radius * np.stack([np.cos(angle + turn), np.sin(angle + turn)], axis=1)
        for centre, turn in zip(corner, np.arange(4) * np.pi / 2, strict=True)
    ]
    return np.concatenate(arcs)


def slot(start: ArrayLike, end: ArrayLike, start_radius: float, end_radius: float) -> Array:
    """Outline of a straight link: the convex hull of two circles."""
    a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    along = b - a
    heading = np.arctan2(along[1], along[0])
    # The common tangents touch both circles at this angle from the line of centres.
    tangent = np.arccos((start_radius - end_radius) / np.linalg.norm(along))
    half = CIRCLE_SEGMENTS // 2
    end_angle = heading + np.linspace(-tangent, tangent, half)
    start_angle = heading + np.linspace(tangent, 2 * np.pi - tangent, half)
    arcs = [
        centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        for centre, radius, angle in ((b, end_radius, end_angle), (a, start_radius, start_angle))
    ]
    return np.concatenate(arcs)


def inset(outline: Array, depth: float) -> Array:
    """The outline moved inwards by `depth`, point by point along the corner bisectors."""
    before, after = np.roll(outline, 1, axis=0), np.roll(outline, -1, axis=0)
    normals = [
        np.stack([-edge[:, 1], edge[:, 0]], axis=1) / np.linalg.norm(edge, axis=1, keepdims=True)
        for edge in (outline - before, after - outline)
    ]
    bisector = normals[0] + normals[1]
    return outline + depth * 2 * bisector / np.sum(bisector**2, axis=1, keepdims=True)


def loft(sections: Sequence[Array]) -> TriangleMesh:
    """The solid through closed loops of equally many points, capped at both ends.

    Args:
        sections: loops, each (k, 3), counter-clockwise as seen against the direction of travel. A
            cap is a fan around the loop's mean, so the end loops must be star-shaped about it.
    """
    rings, points = len(sections), len(sections[0])
    centres = [sections[0].mean(axis=0), sections[-1].mean(axis=0)]
    vertices = np.concatenate([*sections, centres])
    i, j = np.meshgrid(np.arange(rings - 1), np.arange(points), indexing="ij")
    here, right = i * points + j, i * points + (j + 1) % points
    around = np.arange(points)
    beside, top, first_centre = (around + 1) % points, (rings - 1) * points, rings * points
    faces = [
        np.stack([here, right, right + points], axis=-1).reshape(-1, 3),
        np.stack([here, right + points, here + points], axis=-1).reshape(-1, 3),
        np.stack([beside, around, np.full(points, first_centre)], axis=-1),
        np.stack([top + around, top + beside, np.full(points, first_centre + 1)], axis=-1),
    ]
    return TriangleMesh(vertices, np.concatenate(faces).astype(np.int32))


def at_height(outline: Array, z: float) -> Array:
    """The outline as a loop in the plane `z`, shape (k, 3)."""
    return np.column_stack([outline, np.full(len(outline), z)])


def bevelled(outline: Array, bottom: float, top: float, bevel: float) -> TriangleMesh:
    """Extrusion of a star-shaped outline from z = `bottom` to `top` with bevelled rims."""
    small = inset(outline, bevel)
    return loft(
        [
            at_height(small, bottom),
            at_height(outline, bottom + bevel),
            at_height(outline, top - bevel),
            at_height(small, top),
        ]
    )


def revolve(profile: ArrayLike) -> TriangleMesh:
    """The solid of revolution about z of a profile of (radius, z) from its bottom to its top.

    The surface is closed by flat discs at both ends; end a dome with a small radius, not with 0.
    """
    return loft([at_height(circle(radius), z) for radius, z in np.asarray(profile)])


def stack(base: float, layers: Sequence[tuple[float, Sequence[Array]]]) -> TriangleMesh:
    """Extrusions with holes, one upon another along z, as one watertight solid.

    Args:
        base: height of the lowest face.
        layers: for each layer its top height and its rings: outlines and holes, all
            counter-clockwise. Rings of neighbouring layers must be the same array (the wall goes
            on) or lie strictly inside one another; edges must be short compared with the gaps
            between rings (see `divided`).
    """
    heights = [base, *(top for top, _ in layers)]
    ring_lists: list[Sequence[Array]] = [[], *(rings for _, rings in layers), []]
    triangles = []
    for k, z in enumerate(heights):
        triangles.append(_shelf(ring_lists[k], ring_lists[k + 1], z))
    for k, rings in enumerate(ring_lists[1:-1]):
        triangles += [_wall(ring, rings, heights[k], heights[k + 1]) for ring in rings]
    corners = np.concatenate(triangles)
    vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return TriangleMesh(vertices, index.reshape(-1, 3).astype(np.int32))


def divided(outline: Array, longest: float) -> Array:
    """The same outline with edges of at most `longest`."""
    after = np.roll(outline, -1, axis=0)
    pieces = np.ceil(np.linalg.norm(after - outline, axis=1) / longest).astype(int)
    return np.concatenate(
        [
            a + (b - a) * np.arange(n)[:, None] / n
            for a, b, n in zip(outline, after, pieces, strict=True)
        ]
    )


def _shelf(below: Sequence[Array], above: Sequence[Array], z: float) -> Array:
    """Horizontal faces where one layer ends and the next is wider or narrower; (m, 3, 3)."""
    rings = [r for r in below if not any(r is s for s in above)]
    rings += [r for r in above if not any(r is s for s in below)]
    if not rings:
        return np.empty((0, 3, 3))
    points = np.concatenate(rings)
    # Corners far outside keep the outlines off the hull, where rounding would hide points that
    # lie on a straight edge.
    low, high = points.min(axis=0), points.max(axis=0)
    far = rounded_rectangle(1, 1, 0)[:: CIRCLE_SEGMENTS // 8 + 1] * 4 * (high - low)
    points = np.concatenate([points, far + (low + high) / 2])
    faces = Delaunay(points).simplices
    a, b, c = (points[faces[:, k]] for k in range(3))
    clockwise = (b - a)[:, 0] * (c - a)[:, 1] < (b - a)[:, 1] * (c - a)[:, 0]
    faces[clockwise] = faces[clockwise, ::-1]
    centres = points[faces].mean(axis=1)
    faces, centres = (x[_inside(centres, rings)] for x in (faces, centres))
    looks_down = _inside(centres, above)
    faces[looks_down] = faces[looks_down, ::-1]
    return at_height(points, z)[faces]


def _wall(ring: Array, rings: Sequence[Array], bottom: float, top: float) -> Array:
    """Vertical faces over one ring of a layer, looking away from its material; (m, 3, 3)."""
    low, high = at_height(ring, bottom), at_height(ring, top)
    next_low, next_high = np.roll(low, -1, axis=0), np.roll(high, -1, axis=0)
    faces = np.concatenate(
        [np.stack([low, next_low, next_high], axis=1), np.stack([low, next_high, high], axis=1)]
    )
    is_hole = _inside(ring[:1], [r for r in rings if r is not ring])[0]
    return faces[:, ::-1] if is_hole else faces


def _inside(points: Array, rings: Sequence[Array]) -> NDArray[np.bool_]:
    """Whether points, shape (n, 2), lie inside by the even-odd rule; shape (n,)."""
    crossings = np.zeros(len(points), dtype=np.int64)
    for ring in rings:
        (ax, ay), (bx, by) = ring.T, np.roll(ring, -1, axis=0).T
        x, y = points[:, :1], points[:, 1:]
        straddles = (ay > y) != (by > y)
        rise = np.where(by == ay, 1.0, by - ay)
        crossings += np.sum(straddles & (x < ax + (y - ay) * (bx - ax) / rise), axis=1)
    return crossings % 2 == 1
