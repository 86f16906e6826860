"""The project's own hand: two adaptive fingers of two joints each, of the Yale T42's class.

Frames. `palm` (the root): origin at the centre of the mounting face, +z out of the palm, fingers
at +x and -x, joint axes along y. `finger_k_proximal` and `finger_k_distal`: origin on the link's
own joint axis, +z along the link, +x the inner side that carries the pad, so a positive joint
angle closes the finger.

Angles. Proximal 0 .. 2.6 rad: 0 is splayed 60 degrees outwards, 1.05 straight up, 2.6 flat across
the palm. Distal 0 .. 1.57 rad: 0 is straight. One tendon would pull both joints of a finger; how
they share its travel depends on contact, so all four joints are independent here.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh

from inhand.builtin.shapes import (
    Array,
    at_height,
    bevelled,
    circle,
    divided,
    loft,
    revolve,
    rounded_rectangle,
    slot,
    stack,
)
from inhand.geometry.mesh import TriangleMesh, concatenate, transformed

# Sizes in millimetres.
AXIS_X = 38.0
"""Distance of the proximal joint axes from the middle of the palm."""
AXIS_Z = 96.0
"""Height of the proximal joint axes above the mounting face."""
PROXIMAL_LENGTH = 60.0
"""Distance between the two joint axes of a finger."""
DISTAL_LENGTH = 45.0
"""Distance of the fingertip from the distal joint axis."""
SPLAY = np.pi / 3
"""How far the proximal link leans outwards at joint angle 0 [rad]."""
PROXIMAL_LIMIT = 2.6
"""Upper limit of the proximal joints [rad]; the lower is 0."""
DISTAL_LIMIT = 1.57
"""Upper limit of the distal joints [rad]; the lower is 0."""


class Part(NamedTuple):
    """A link's mesh [mm] and its colour."""

    mesh: TriangleMesh
    colour: tuple[float, float, float]


def write_hand(folder: str | Path) -> Path:
    """Write the hand's URDF and STL meshes (in millimetres) into `folder`.

    Returns:
        Path of the URDF.
    """
    folder = Path(folder)
    parts = {
        "palm": Part(palm(), (0.20, 0.22, 0.26)),
        "proximal": Part(proximal(), (0.85, 0.85, 0.83)),
        "distal": Part(distal(), (0.25, 0.42, 0.62)),
    }
    (folder / "meshes").mkdir(parents=True, exist_ok=True)
    for name, part in parts.items():
        solid = trimesh.Trimesh(part.mesh.vertices, part.mesh.faces, process=False)
        solid.export(folder / "meshes" / f"{name}.stl")
    urdf = folder / "adaptive_hand.urdf"
    urdf.write_text(_urdf(parts))
    return urdf


def palm() -> TriangleMesh:
    """Flange, housing, covers and finger mounts [mm], palm frame."""
    flange_holes = [
        circle(2.75, 25 * np.array([np.cos(a), np.sin(a)]), 16)
        for a in np.arange(4) * np.pi / 2 + np.pi / 4
    ]
    flange = stack(0, [(7, [circle(32), *flange_holes])])
    neck = revolve([(24, 6), (24, 13)])
    housing = loft(
        [
            at_height(rounded_rectangle(width, depth, radius), z)
            for width, depth, radius, z in (
                (78, 48, 6, 12),
                (86, 56, 8, 16),
                (90, 60, 10, 22),
                (90, 60, 10, 66),
                (88, 54, 9, 73),
                (84, 46, 7, 80),
            )
        ]
    )
    pad = bevelled(rounded_rectangle(36, 40, 6), 79, 82.5, 1.5)
    cover_outline = divided(rounded_rectangle(64, 40, 5), 4)
    vents = [divided(rounded_rectangle(2.6, 22, 1.2), 2) + [x, 4] for x in (-18, -9, 0, 9, 18)]
    cover = stack(0, [(3, [cover_outline, *vents])])
    plug = bevelled(rounded_rectangle(18, 9, 1.5), 0, 15, 1)
    sides = [
        transformed(cover, _facing_y(+1, (0, 29.5, 43))),
        transformed(cover, _facing_y(-1, (0, -29.5, 43))),
        # The connector is on one side only: the two sides of the palm can be told apart.
        transformed(plug, _facing_y(+1, (-20, 26, 27))),
    ]
    mount, half_turn = _finger_mount(), np.diag([-1.0, -1.0, 1.0, 1.0])
    return concatenate([flange, neck, housing, pad, *sides, mount, transformed(mount, half_turn)])


def proximal() -> TriangleMesh:
    """Side plates, core, pad, tendon pulleys and axles of a proximal link [mm], link frame."""
    outline = divided(slot((0, 0), (0, PROXIMAL_LENGTH), 9, 7.5), 4)
    window = divided(slot((-2, 18), (-2, 42), 3.4, 2.8), 2)
    plate = stack(-1.75, [(1.75, [outline, window])])
    core = bevelled(slot((-1, 17), (-1, 43), 5, 4.5), -8.2, 8.2, 0.5)
    return concatenate(
        [
            _upright(plate, -9.75),
            _upright(plate, 9.75),
            _upright(core),
            _upright(bevelled(_pad_outline(3, 11, 13, 47), -9, 9, 1.5)),
            _upright(_pulley(9, 10)),
            _upright(_pulley(3.5, 16.4), x=4.5, z=12),
            _upright(_pin(3.4, 25)),
            _upright(_pin(3.0, 25), z=PROXIMAL_LENGTH),
        ]
    )


def distal() -> TriangleMesh:
    """Knuckle, body with rounded tip, pad and tendon pulleys of a distal link [mm], link frame."""
    knuckle = bevelled(slot((0, 0), (-0.5, 18), 6.3, 5.2), -4, 4, 0.5)
    tip = np.radians(np.linspace(0, 180, 25))
    arc = [-0.25, DISTAL_LENGTH - 6] + 6 * np.stack([np.cos(tip), np.sin(tip)], axis=1)
    body = np.concatenate([[(-4.5, 10), (3.5, 10), (5.75, 12.5)], arc, [(-6.25, 12.5)]])
    return concatenate(
        [
            _upright(knuckle),
            _upright(bevelled(body, -9, 9, 1.5)),
            _upright(bevelled(_pad_outline(3, 9.5, 13, 42), -8, 8, 1.5)),
            _upright(_pulley(7.2, 3), -5.7),
            _upright(_pulley(7.2, 3), 5.7),
        ]
    )


def _finger_mount() -> TriangleMesh:
    """The two ears and the axle that carry the finger at +x [mm], palm frame."""
    outline = slot((AXIS_X - 4, 76), (AXIS_X, AXIS_Z), 9.5, 7)
    ears = [_upright(bevelled(outline, -3, 3, 0.8), y) for y in (-16.5, 16.5)]
    return concatenate([*ears, _upright(_pin(4, 43), x=AXIS_X, z=AXIS_Z)])


def _pad_outline(back: float, front: float, low: float, high: float) -> Array:
    """Side view of a finger pad from z = `low` to `high`, bulging from x = `back` to `front`."""
    along = np.linspace(-1, 1, 21)
    bulge = back + (front - back) * (1 - 0.15 * along**2) * np.sqrt(1 - 0.8 * along**8)
    z = (low + high) / 2 + along * (high - low) / 2
    return np.concatenate([np.column_stack([bulge, z]), [(back, high), (back, low)]])


def _pulley(radius: float, width: float) -> TriangleMesh:
    """A grooved pulley about z, centred at the origin."""
    groove = radius - min(1.5, 0.25 * radius)
    rim, floor = 0.32 * width, 0.1 * width
    half = [(radius, 0.5 * width), (radius, rim), (groove, floor)]
    return revolve([(r, -z) for r, z in half] + half[::-1])


def _pin(radius: float, length: float) -> TriangleMesh:
    """A pin with bevelled ends about z, centred at the origin."""
    return bevelled(circle(radius, segments=32), -length / 2, length / 2, 0.5)


def _upright(mesh: TriangleMesh, y: float = 0.0, *, x: float = 0.0, z: float = 0.0) -> TriangleMesh:
    """The solid with its own x-y plane stood up in the x-z plane and its origin at (x, y, z)."""
    return transformed(mesh, _facing_y(-1, (x, y, z)))


def _facing_y(side: int, origin: tuple[float, float, float]) -> Array:
    """A frame whose z axis looks along +y or -y (`side`) and whose y axis points up."""
    T = np.eye(4)
    T[:3, :3] = [[-side, 0, 0], [0, 0, side], [0, 1, 0]]
    T[:3, 3] = origin
    return T


def _urdf(parts: dict[str, Part]) -> str:
    """The URDF text; lengths in metres."""
    materials = [
        f'  <material name="{name}"><color rgba="{" ".join(map(str, part.colour))} 1"/></material>'
        for name, part in parts.items()
    ]
    body = [*materials, _link("palm", "palm")]
    for finger, side, turn in (("finger_1", 1, np.pi), ("finger_2", -1, 0.0)):
        proximal_name, distal_name = f"{finger}_proximal", f"{finger}_distal"
        mount = (side * AXIS_X, 0.0, AXIS_Z)
        body += [
            _link(proximal_name, "proximal"),
            _link(distal_name, "distal"),
            _joint("palm", proximal_name, mount, (0.0, -SPLAY, turn), PROXIMAL_LIMIT),
            _joint(
                proximal_name, distal_name, (0.0, 0.0, PROXIMAL_LENGTH), (0.0,) * 3, DISTAL_LIMIT
            ),
        ]
    return "\n".join(['<?xml version="1.0"?>', '<robot name="adaptive_hand">', *body, "</robot>\n"])


def _link(name: str, part: str) -> str:
    geometry = (
        f'<geometry><mesh filename="meshes/{part}.stl" scale="0.001 0.001 0.001"/></geometry>'
    )
    return (
        f'  <link name="{name}">\n'
        f'    <visual>{geometry}<material name="{part}"/></visual>\n'
        f"    <collision>{geometry}</collision>\n"
        "  </link>"
    )


def _joint(
    parent: str,
    child: str,
    origin: tuple[float, ...],
    rpy: tuple[float, ...],
    upper: float,
) -> str:
    """A revolute joint about y named `<child>_joint`; origin in millimetres."""
    xyz = " ".join(f"{length / 1000:.6g}" for length in origin)
    angles = " ".join(f"{angle:.12g}" for angle in rpy)
    return (
        f'  <joint name="{child}_joint" type="revolute">\n'
        f'    <parent link="{parent}"/>\n'
        f'    <child link="{child}"/>\n'
        f'    <origin xyz="{xyz}" rpy="{angles}"/>\n'
        '    <axis xyz="0 1 0"/>\n'
        f'    <limit lower="0" upper="{upper}" effort="5" velocity="3"/>\n'
        "  </joint>"
    )
