from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yourdfpy
from hypothesis import given
from hypothesis import strategies as st
from tiny_urdf import BOX, LIMIT, joint, link, mimic, write

import inhand.hand
from inhand.errors import InputError
from inhand.hand import Hand

HANDS = ["t42/hand_T42b.urdf", "robotiq/robotiq_2f_85.urdf", "robotiq/robotiq_3f.urdf"]


@pytest.fixture(scope="module")
def gripper(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    """A palm with a fixed cover, a finger of two links with an invisible tip, a mimic finger that
    follows its first joint, and a thumb."""
    links = [
        link("palm", '<box size="0.06 0.04 0.02"/>'),
        link("cover"),
        link("near"),
        link("far"),
        link("tip", None),
        link("mirror"),
        link("thumb", '<cylinder radius="0.01" length="0.04"/>'),
    ]
    joints = [
        joint("glue", "palm", "cover", "fixed", inside="", xyz="0 0 -0.02"),
        joint("near_joint", "palm", "near", xyz="0.02 0 0.03"),
        joint("far_joint", "near", "far"),
        joint("to_tip", "far", "tip", "fixed", inside=""),
        joint("mirror_joint", "palm", "mirror", inside=mimic("near_joint", 'multiplier="-1"')),
        joint("thumb_joint", "palm", "thumb", "continuous", inside="", xyz="0 0.03 0"),
    ]
    return Hand.from_urdf(write(tmp_path_factory.mktemp("gripper"), *links, *joints))


def test_links_are_those_with_shapes(gripper: Hand) -> None:
    assert gripper.name == "tiny"
    assert [x.name for x in gripper.links] == ["palm", "cover", "near", "far", "mirror", "thumb"]
    assert gripper.palm_links == (0, 1)


def test_fingers_come_from_the_tree(gripper: Hand) -> None:
    assert gripper.joint_names == ("near_joint", "far_joint", "thumb_joint")
    assert gripper.all_joint_names == ("near_joint", "far_joint", "mirror_joint", "thumb_joint")
    found = [(f.name, f.links, f.joints) for f in gripper.fingers]
    assert found == [("near", (2, 3, 4), (0, 1)), ("thumb", (5,), (2,))]


def test_a_chain_that_cannot_be_seen_is_no_finger(tmp_path: Path) -> None:
    links = [link("palm"), link("finger"), link("ghost", None)]
    joints = [joint("bend", "palm", "finger"), joint("haunt", "palm", "ghost")]
    hand = Hand.from_urdf(write(tmp_path, *links, *joints))
    assert [f.name for f in hand.fingers] == ["finger"]
    assert hand.joint_names == ("bend", "haunt")


def test_limits(gripper: Hand) -> None:
    np.testing.assert_array_equal(gripper.lower, [-1, -1, -np.pi])
    np.testing.assert_array_equal(gripper.upper, [2, 2, np.pi])


def test_surfaces_and_distance_fields_fit_the_mesh(gripper: Hand) -> None:
    for part in gripper.links:
        points, normals = part.surface.points, part.surface.normals
        assert 100 <= len(points) <= 600
        np.testing.assert_allclose(part.distance_field.distance(points), 0, atol=7e-4)
        outside = part.distance_field.distance(points + 0.003 * normals)
        np.testing.assert_allclose(outside, 0.003, atol=7e-4)  # first-order beyond an edge
        inside = part.distance_field.distance(points - 0.003 * normals)
        assert np.median(inside) == pytest.approx(-0.003, abs=1e-5)  # nearer beside an edge
        assert (inside < 7e-4).all()


@pytest.mark.parametrize("name", HANDS)
def test_real_hands_stand_as_in_yourdfpy(shared_data: Path, name: str) -> None:
    path = shared_data / "hands" / name
    hand = Hand.from_urdf(path)
    q = np.random.default_rng(0).uniform(hand.lower, hand.upper)
    urdf = yourdfpy.URDF.load(str(path))
    urdf.update_cfg(dict(zip(hand.joint_names, q, strict=True)))
    nodes = urdf.scene.graph
    for part, T in zip(hand.links, hand.forward_kinematics(q), strict=True):
        expected = []
        for node in nodes.nodes_geometry:
            if nodes.transforms.parents[node] == part.name:
                T_root_shape, shape = nodes.get(node)
                expected.append(
                    trimesh.transform_points(
                        urdf.scene.geometry[shape].triangles_center, T_root_shape
                    )
                )
        ours = trimesh.transform_points(part.mesh.triangles.mean(axis=1), T)
        low, high = np.concatenate(expected).min(0), np.concatenate(expected).max(0)
        np.testing.assert_allclose([ours.min(0), ours.max(0)], [low, high], atol=1e-9)


def test_meshes_get_scale_and_origin(tmp_path: Path) -> None:
    for suffix in ("stl", "obj", "dae"):
        trimesh.creation.box((1, 2, 3)).export(tmp_path / f"a.{suffix}")
        palm = link(
            "palm",
            f'<mesh filename="a.{suffix}" scale="0.01 0.02 -0.03"/>',
            origin='<origin xyz="0.1 0 0" rpy="0 0 1.5707963267948966"/>',
        )
        finger, bend = link("finger"), joint("bend", "palm", "finger")
        hand = Hand.from_urdf(write(tmp_path, palm, finger, bend))
        expected = [[0.08, -0.005, -0.045], [0.12, 0.005, 0.045]]
        np.testing.assert_allclose(hand.links[0].mesh.bounds, expected, atol=1e-9)
        assert hand.links[0].distance_field.distance(np.array([[0.1, 0, 0]]))[0] < 0


def test_open_mesh_has_an_inside(tmp_path: Path) -> None:
    cup = trimesh.creation.box((0.04, 0.04, 0.04))
    cup.update_faces(np.arange(len(cup.faces)) != 0)
    cup.export(tmp_path / "cup.stl")
    palm = link("palm", '<mesh filename="cup.stl"/>')
    hand = Hand.from_urdf(write(tmp_path, palm, link("f"), joint("bend", "palm", "f")))
    distance = hand.links[0].distance_field.distance(np.array([[0, 0, 0], [0.03, 0, 0]]))
    assert distance[0] < 0 < distance[1]


def test_equal_links_share_their_geometry(tmp_path: Path) -> None:
    links = [link("palm"), link("one"), link("two"), link("three", BOX, '<origin xyz="0 0 0.01"/>')]
    joints = [joint(name, "palm", name) for name in ("one", "two", "three")]
    _, one, two, three = Hand.from_urdf(write(tmp_path, *links, *joints)).links
    assert one.mesh is two.mesh
    assert one.distance_field is two.distance_field
    assert three.mesh is not one.mesh
    np.testing.assert_allclose(three.mesh.bounds - one.mesh.bounds, [[0, 0, 0.01]] * 2)


# Cache


def test_second_start_builds_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("INHAND_CACHE_DIR", str(tmp_path / "cache"))
    path = write(tmp_path, link("palm"), link("f"), joint("bend", "palm", "f"))
    first = Hand.from_urdf(path)
    monkeypatch.setattr(inhand.hand, "_build_geometry", None)
    second = Hand.from_urdf(path)
    for a, b in zip(first.links, second.links, strict=True):
        np.testing.assert_array_equal(a.mesh.vertices, b.mesh.vertices)
        np.testing.assert_array_equal(a.surface.normals, b.surface.normals)
        np.testing.assert_array_equal(a.distance_field.values, b.distance_field.values)
        assert a.distance_field.voxel == b.distance_field.voxel


def test_changed_mesh_file_is_built_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("INHAND_CACHE_DIR", str(tmp_path / "cache"))
    palm = link("palm", '<mesh filename="a.stl"/>')
    path = write(tmp_path, palm, link("f"), joint("bend", "palm", "f"))
    for size in (0.02, 0.03):
        trimesh.creation.box((size, size, size)).export(tmp_path / "a.stl")
        hand = Hand.from_urdf(path)
        np.testing.assert_allclose(hand.links[0].mesh.bounds[1], size / 2, atol=1e-6)


# Kinematics and joints


def test_forward_kinematics_shapes(gripper: Hand) -> None:
    q = np.array([[0.3, 0.2, 0.1], [0, 0, 0]])
    poses = gripper.forward_kinematics(q)
    assert poses.shape == (2, 6, 4, 4)
    np.testing.assert_array_equal(gripper.forward_kinematics(q[0]), poses[0])
    np.testing.assert_array_equal(gripper.forward_kinematics([0, 0, 0]), poses[1])


def test_link_poses_has_every_link(gripper: Hand) -> None:
    q = [0.3, 0.2, 0.1]
    poses = gripper.link_poses(dict(zip(gripper.joint_names, q, strict=True)))
    assert list(poses) == ["palm", "cover", "near", "far", "tip", "mirror", "thumb"]
    for part, T in zip(gripper.links, gripper.forward_kinematics(q), strict=True):
        np.testing.assert_allclose(poses[part.name], T, atol=1e-12)
    np.testing.assert_allclose(
        np.linalg.inv(poses["far"]) @ poses["tip"] @ [0, 0, 0, 1], [0, 0, 0.05, 1], atol=1e-12
    )


positions = st.floats(-4, 4)


@given(positions, positions, positions)
def test_joint_dict_and_vector_are_inverse(gripper: Hand, a: float, b: float, c: float) -> None:
    named = gripper.joint_dict([a, b, c])
    assert named == {"near_joint": a, "far_joint": b, "mirror_joint": -a, "thumb_joint": c}
    np.testing.assert_array_equal(gripper.joint_vector(named), [a, b, c])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"thumb": 0.1}, "unknown joint thumb; .*near_joint, far_joint, thumb_joint"),
        ({"thumb_joint": "bent"}, "joint positions must be numbers"),
        ({"thumb_joint": float("nan")}, "NaN or infinite"),
        (
            {"mirror_joint": 0.5},
            "mirror_joint is given as 0.5000, but as a mimic joint it is at 0.0",
        ),
        ({"mirror_joint": float("nan")}, "NaN or infinite"),
        ({"mirror_joint": "open"}, "joint positions must be numbers"),
    ],
)
def test_wrong_joint_positions(gripper: Hand, changes: dict[str, Any], message: str) -> None:
    right = dict.fromkeys(gripper.joint_names, 0.0)
    for use in (gripper.joint_vector, gripper.link_poses):
        with pytest.raises(InputError, match=message):
            use(right | changes)


def test_missing_joint_positions(gripper: Hand) -> None:
    with pytest.raises(
        InputError, match="missing joint far_joint, thumb_joint; the joints of tiny"
    ):
        gripper.joint_vector({"near_joint": 0.1})


@pytest.mark.parametrize("q", [[0, 0], np.zeros((1, 1, 3)), 0.0, [0, 0, np.inf], ["a", "b", "c"]])
def test_wrong_q(gripper: Hand, q: object) -> None:
    with pytest.raises(InputError, match="joint positions"):
        gripper.forward_kinematics(q)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="joint positions"):
        gripper.joint_dict(q)  # type: ignore[arg-type]


def test_reach_holds_the_hand(gripper: Hand) -> None:
    centre, radius = gripper.reach
    q = np.random.default_rng(0).uniform(gripper.lower, gripper.upper, (3000, 3))
    poses = gripper.forward_kinematics(q)
    farthest = 0.0
    for i, part in enumerate(gripper.links):
        corners = np.einsum("bij,vj->bvi", poses[:, i, :3, :3], part.mesh.vertices)
        corners += poses[:, i, None, :3, 3]
        farthest = max(farthest, np.linalg.norm(corners - centre, axis=-1).max())
    assert farthest <= radius < 1.15 * farthest


# Errors: those of the file itself are tested with urdf.py


def tiny(folder: Path, palm: str, finger: str = link("finger")) -> Path:
    return write(folder, palm, finger, joint("bend", "palm", "finger", inside=LIMIT))


def test_no_movable_link_with_a_shape(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="none of the links that its joints move"):
        Hand.from_urdf(tiny(tmp_path, link("palm"), link("finger", None)))


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.usdz", b"?", 'link "palm": cannot read mesh file .*a.usdz'),
        ("a.stl", b"", 'link "palm": .*a.stl'),
        ("a.obj", b"v 0 0 0\n", 'link "palm": .*a.obj'),
        ("a.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", 'link "palm": .*a.obj'),
    ],
)
def test_broken_meshes(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message):
        Hand.from_urdf(tiny(tmp_path, link("palm", f'<mesh filename="{name}"/>')))


def test_mesh_in_millimetres(tmp_path: Path) -> None:
    trimesh.creation.box((60, 40, 20)).export(tmp_path / "a.stl")
    with pytest.raises(InputError, match=r'link "palm": it is 74\.\d+ m across.*0.001'):
        Hand.from_urdf(tiny(tmp_path, link("palm", '<mesh filename="a.stl"/>')))


def test_scaled_down_twice(tmp_path: Path) -> None:
    small = '<box size="0.00006 0.00004 0.00002"/>'
    with pytest.raises(InputError, match="all links are less than"):
        Hand.from_urdf(tiny(tmp_path, link("palm", small), link("finger", small)))


def test_package_paths(shared_data: Path, tmp_path: Path) -> None:
    package = shared_data / "hands" / "allegro" / "allegro_hand_description"
    text = (package / "allegro_hand_description_right.urdf").read_text()
    path = tmp_path / "hand.urdf"
    path.write_text(text)
    with pytest.raises(InputError, match=r'package_paths=\{"allegro_hand_description": folder\}'):
        Hand.from_urdf(path)
    hand = Hand.from_urdf(path, package_paths={"allegro_hand_description": package})
    assert len(hand.joint_names) == 16
    assert [len(f.joints) for f in hand.fingers] == [4, 4, 4, 4]
