"""The project's own hand and objects: closed, of the stated size, and a working URDF."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
import yourdfpy

from inhand.builtin import hand as builtin_hand
from inhand.builtin import shapes
from inhand.builtin.objects import OBJECTS
from inhand.geometry.mesh import TriangleMesh
from inhand.hand import Hand

PROXIMAL, DISTAL = builtin_hand.PROXIMAL_LENGTH / 1000, builtin_hand.DISTAL_LENGTH / 1000


def as_trimesh(mesh: TriangleMesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


@pytest.fixture(scope="module")
def urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return builtin_hand.write_hand(tmp_path_factory.mktemp("hand"))


@pytest.fixture(scope="module")
def hand(urdf: Path) -> Hand:
    return Hand.from_urdf(urdf)


# Shapes


def test_a_bored_plate_has_the_volume_of_its_outline_less_its_holes() -> None:
    outline = shapes.divided(shapes.rounded_rectangle(40, 30, 0), 2)
    holes = [shapes.circle(4, (-8, 0)), shapes.circle(3, (9, 4))]
    plate = as_trimesh(shapes.stack(1, [(6, [outline, *holes])]))
    round_area = 32 * np.sin(np.pi / 32) * (16 + 9)  # of 64-gons
    assert plate.is_watertight
    assert plate.volume == pytest.approx(5 * (40 * 30 - round_area))
    assert plate.euler_number == 2 - 2 * len(holes)


def test_a_stack_may_grow_and_shrink() -> None:
    wide, narrow = shapes.circle(10), shapes.circle(5)
    spool = as_trimesh(shapes.stack(0, [(2, [wide]), (6, [narrow]), (9, [wide])]))
    assert spool.is_watertight
    assert spool.volume == pytest.approx(32 * np.sin(np.pi / 32) * (5 * 100 + 4 * 25))


def test_a_slot_is_the_hull_of_two_circles() -> None:
    outline = shapes.slot((0, 0), (30, 0), 8, 5)
    circles = np.concatenate([shapes.circle(8), shapes.circle(5, (30, 0))])
    grown = trimesh.convex.ConvexHull(np.concatenate([outline, circles]))
    assert grown.volume == pytest.approx(trimesh.convex.ConvexHull(outline).volume, rel=2e-3)


def test_inset_moves_every_edge_by_the_depth() -> None:
    square = shapes.rounded_rectangle(10, 6, 0)[[0, 9, 18, 27]]
    np.testing.assert_allclose(np.abs(shapes.inset(square, 0.5)), [[4.5, 2.5]] * 4)


def test_revolution_of_a_line_is_a_cone_frustum() -> None:
    frustum = as_trimesh(shapes.revolve([(2, 0), (1, 3)]))
    assert frustum.volume == pytest.approx(np.pi * 3 / 3 * (4 + 2 + 1), rel=2e-3)


# Objects


@pytest.mark.parametrize("name", OBJECTS)
def test_object_is_closed_and_looks_outward(name: str) -> None:
    mesh = as_trimesh(OBJECTS[name]())
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert mesh.body_count == 1
    assert len(mesh.faces) < 10_000


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("cylinder", (0.035, 0.035, 0.064)),
        ("ellipsoid", (0.035, 0.035, 0.064)),
        ("cuboid", (0.030, 0.030, 0.064)),
        ("industrial_part", (0.081, 0.052, 0.038)),
        ("bottle", (0.087, 0.055, 0.176)),
        ("can", (0.066, 0.066, 0.101)),
    ],
)
def test_object_has_the_stated_size_and_is_centred(name: str, size: tuple[float, ...]) -> None:
    low, high = OBJECTS[name]().bounds
    np.testing.assert_allclose(high - low, size, atol=1e-4)
    np.testing.assert_allclose(high + low, 0, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "volume"),
    [
        ("cylinder", np.pi * 0.0175**2 * 0.064),
        ("ellipsoid", 4 / 3 * np.pi * 0.0175**2 * 0.032),
        ("cuboid", 0.03**2 * 0.064),
    ],
)
def test_primitive_has_its_volume(name: str, volume: float) -> None:
    assert as_trimesh(OBJECTS[name]()).volume == pytest.approx(volume, rel=5e-3)


def test_industrial_part_has_through_bores() -> None:
    # Genus: the keyed bore, the post's bore, three bolt holes and three flange holes.
    assert as_trimesh(OBJECTS["industrial_part"]()).euler_number == 2 - 2 * 8


# Hand


def test_link_meshes_are_closed_bodies() -> None:
    for mesh in (builtin_hand.palm(), builtin_hand.proximal(), builtin_hand.distal()):
        solid = as_trimesh(mesh)
        assert solid.is_watertight
        assert solid.is_winding_consistent
        assert all(body.volume > 0 for body in solid.split())


def test_links_have_the_stated_sizes() -> None:
    palm, proximal, distal = (
        part.bounds
        for part in (builtin_hand.palm(), builtin_hand.proximal(), builtin_hand.distal())
    )
    assert palm[1, 0] - palm[0, 0] == pytest.approx(90)
    assert palm[0, 2] == pytest.approx(0)
    assert palm[1, 2] < 110
    assert proximal[1, 2] - PROXIMAL * 1000 == pytest.approx(7.5, abs=0.1)
    assert distal[1, 2] == pytest.approx(DISTAL * 1000)


def test_both_urdf_readers_agree(urdf: Path, hand: Hand) -> None:
    independent = yourdfpy.URDF.load(str(urdf), load_meshes=False, build_scene_graph=True)
    rng = np.random.default_rng(0)
    for _ in range(5):
        positions = dict(zip(hand.joint_names, rng.uniform(hand.lower, hand.upper), strict=True))
        independent.update_cfg({k: np.float64(v) for k, v in positions.items()})
        for name, pose in hand.link_poses(positions).items():
            np.testing.assert_allclose(pose, independent.get_transform(name), atol=1e-9)


def test_hand_has_two_fingers_of_two_joints(hand: Hand) -> None:
    assert [len(finger.joints) for finger in hand.fingers] == [2, 2]
    assert [len(finger.links) for finger in hand.fingers] == [2, 2]
    assert [hand.links[i].name for i in hand.palm_links] == ["palm"]
    np.testing.assert_allclose(hand.lower, 0)
    np.testing.assert_allclose(hand.upper, [2.6, 1.57, 2.6, 1.57])


def fingertip(hand: Hand, q: list[float], finger: str) -> np.ndarray:
    pose = hand.link_poses(dict(zip(hand.joint_names, q, strict=True)))[f"{finger}_distal"]
    return pose[:3, 3] + DISTAL * pose[:3, 2]


def test_straight_fingers_stand_on_their_mounts(hand: Hand) -> None:
    up = builtin_hand.SPLAY
    tip = fingertip(hand, [up, 0, up, 0], "finger_1")
    height = builtin_hand.AXIS_Z / 1000 + PROXIMAL + DISTAL
    np.testing.assert_allclose(tip, [builtin_hand.AXIS_X / 1000, 0, height], atol=1e-12)


@pytest.mark.parametrize("q", [[0.0, 0.0], [1.2, 0.4], [1.5, 1.2]])
def test_fingers_close_symmetrically(hand: Hand, q: list[float]) -> None:
    one, two = (fingertip(hand, q + q, f"finger_{k}") for k in (1, 2))
    np.testing.assert_allclose(one, two * [-1, 1, 1], atol=1e-12)


def test_positive_joint_motion_closes(hand: Hand) -> None:
    def opening(q: list[float]) -> float:
        return float((fingertip(hand, q, "finger_1") - fingertip(hand, q, "finger_2"))[0])

    assert opening([1.1, 0, 1.1, 0]) < opening([0.9, 0, 0.9, 0])
    assert opening([1.0, 0.3, 1.0, 0.3]) < opening([1.0, 0, 1.0, 0])


def test_links_do_not_collide_while_the_fingers_close(hand: Hand) -> None:
    """Samples of each link stay outside its neighbours over the whole range of a joint."""
    names = [link.name for link in hand.links]
    palm, proximal, distal = (
        names.index(n) for n in ("palm", "finger_1_proximal", "finger_1_distal")
    )
    for share in np.linspace(0, 1, 9):
        poses = hand.forward_kinematics(hand.upper * [share, share, 0, 0])
        for body, moving in ((palm, proximal), (proximal, distal)):
            T = np.linalg.inv(poses[body]) @ poses[moving]
            points = hand.links[moving].surface.points @ T[:3, :3].T + T[:3, 3]
            # Axles sit in their bores: only points away from the joint count.
            away = np.linalg.norm(hand.links[moving].surface.points[:, [0, 2]], axis=1) > 0.010
            assert hand.links[body].distance_field.distance(points[away]).min() > 0.001
