"""Six objects to grasp, of the kinds the paper uses (its figure of objects), in metres.

Every object stands along z with its origin at the centre of its bounding box.
"""

from collections.abc import Callable

import numpy as np
from scipy.interpolate import PchipInterpolator

from inhand.builtin.shapes import (
    Array,
    at_height,
    circle,
    divided,
    loft,
    revolve,
    slot,
    stack,
)
from inhand.geometry.mesh import TriangleMesh, box

MM = 1e-3


def cylinder() -> TriangleMesh:
    """A cylinder, diameter 35 mm, length 64 mm."""
    return revolve([(0.0175, -0.032), (0.0175, 0.032)])


def ellipsoid() -> TriangleMesh:
    """An ellipsoid of revolution, diameter 35 mm, length 64 mm."""
    latitude = np.linspace(-1, 1, 47) * (np.pi / 2 - 0.02)
    return revolve(np.stack([0.0175 * np.cos(latitude), 0.032 * np.sin(latitude)], axis=1))


def cuboid() -> TriangleMesh:
    """A cuboid, 30 x 30 x 64 mm."""
    return box([0.03, 0.03, 0.064])


def industrial_part() -> TriangleMesh:
    """A flanged bearing bracket, about 81 x 52 x 38 mm, without any symmetry.

    A drop-shaped base plate carries a hollow boss with a keyway and a bolted flange, and a
    bored post.
    """
    boss, post = np.array([-14.0, 0.0]), np.array([26.0, 7.0])
    plate = divided(slot(boss, post, 26, 15), 3)
    bore, relief = _keyed_bore(boss, 9), circle(13, boss)
    post_bore = circle(3.5, post, 32)
    bolt_holes = [circle(2.6, at, 24) for at in ([-14, -21.5], [2, 19], [14, -11])]
    flange_holes = [circle(1.8, boss + at, 20) for at in ([0, 20.5], [-20.5, 0], [0, -20.5])]
    part = stack(
        -19,
        [
            (-15, [plate, relief, post_bore, *bolt_holes]),
            (-11, [plate, bore, post_bore, *bolt_holes]),
            (1, [circle(17.5, boss), bore, circle(8, post), post_bore]),
            (13, [circle(16, boss), bore]),
            (19, [_flat_sided(boss, 25, 21), bore, *flange_holes]),
        ],
    )
    return _centred(part)


def bottle() -> TriangleMesh:
    """A squeeze bottle with a waisted body, a round shoulder, a cap and a spout; 176 mm tall."""
    # Height, half width, half depth [mm] and exponent of the superellipse (2: ellipse).
    body = np.array(
        [
            (0, 36, 20, 2.8),
            (1.5, 40, 24, 2.8),
            (5, 42.5, 26.5, 2.8),
            (20, 43.5, 27.5, 2.8),
            (40, 42, 26.5, 2.7),
            (60, 39.5, 25.5, 2.6),
            (78, 39, 25.5, 2.5),
            (92, 40, 26.5, 2.5),
            (104, 40, 27, 2.4),
            (113, 38, 26, 2.3),
            (121, 33, 24, 2.2),
            (127, 26, 20.5, 2.1),
            (131, 19, 16.5, 2.0),
            (133, 14.5, 14.5, 2.0),
        ]
    )
    cap = [(137, 13.5), (137.5, 18.5), (138.5, 19), (150, 18.2), (152, 16.5), (153.5, 11)]
    spout = [(158, 7.5), (174, 4), (176, 2.5)]
    heights = np.union1d(body[:, 0], np.linspace(0, 133, 30))
    rows = np.column_stack([heights, PchipInterpolator(body[:, 0], body[:, 1:])(heights)]).tolist()
    rows += [(z, r, r, 2.0) for z, r in cap + spout]
    return _centred(loft([at_height(_superellipse(a, b, p), z) for z, a, b, p in rows]))


def can() -> TriangleMesh:
    """A tin can with rims, recessed ends and a beaded body; diameter 66 mm, length 101 mm."""
    end = [(27.5, 47.0), (28.5, 48.2), (31.0, 48.2), (31.4, 50.5), (33.0, 50.5), (33.0, 47.6)]
    bead_heights = np.arange(-13.5, 14, 4.5)
    beads = [(32.4 - 0.7 * k, z + dz) for z in bead_heights for k, dz in ((0, -1.5), (1, 0))]
    upper = [(32.4, 46.8), (32.4, 16.0)]
    half = [*end, *upper]
    profile = [(r, -z) for r, z in half] + beads + [(32.4, 15.0)] + half[::-1]
    return _centred(revolve(np.array(profile)))


OBJECTS: dict[str, Callable[[], TriangleMesh]] = {
    "cylinder": cylinder,
    "ellipsoid": ellipsoid,
    "cuboid": cuboid,
    "industrial_part": industrial_part,
    "bottle": bottle,
    "can": can,
}
"""Builder of every object's mesh [m], by name."""


def _centred(mesh: TriangleMesh) -> TriangleMesh:
    """A mesh in millimetres, in metres with the centre of its bounding box at the origin."""
    return TriangleMesh((mesh.vertices - mesh.bounds.mean(axis=0)) * MM, mesh.faces)


def _superellipse(half_width: float, half_depth: float, exponent: float) -> Array:
    """Outline with |x / half_width|^exponent + |y / half_depth|^exponent = 1."""
    unit = circle(1.0, segments=72)
    return np.sign(unit) * np.abs(unit) ** (2 / exponent) * [half_width, half_depth]


def _keyed_bore(centre: Array, radius: float) -> Array:
    """A circle with a keyway, 4 wide and 2.5 deep [mm], towards -y."""
    opening = np.arcsin(2.0 / radius)
    angle = np.linspace(opening, 2 * np.pi - opening, 48) - np.pi / 2
    arc = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return centre + np.concatenate([arc, [[-2.0, -radius - 2.5], [2.0, -radius - 2.5]]])


def _flat_sided(centre: Array, radius: float, flat: float) -> Array:
    """A circle cut off straight at x = `flat` from its centre."""
    opening = np.arccos(flat / radius)
    angle = np.linspace(opening, 2 * np.pi - opening, 80)
    arc = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return centre + divided(arc, 3)
