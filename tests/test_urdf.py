from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from tiny_urdf import BOX, LIMIT, joint, link, mimic, write

from inhand.errors import InputError
from inhand.urdf import Robot, Shape, read_urdf

PALM, TIP = link("palm"), link("tip")
BEND = joint("bend", "palm", "tip")


def only_shape(robot: Robot, name: str = "palm") -> Shape:
    (shape,) = next(x for x in robot.links if x.name == name).shapes
    return shape


def write_mesh(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.creation.box((0.02, 0.03, 0.04)).export(path)
    return path


def mesh_link(address: str, attributes: str = "") -> str:
    return link("palm", f'<mesh filename="{address}" {attributes}/>')


def test_reads_links_and_joints(tmp_path: Path) -> None:
    bend = joint("bend", "palm", "tip", xyz="1 2 3", rpy="0.1 0.2 0.3", axis="0 0 2")
    robot = read_urdf(write(tmp_path, PALM, TIP, bend))
    assert (robot.name, robot.root) == ("tiny", "palm")
    assert [x.name for x in robot.links] == ["palm", "tip"]
    (read,) = robot.joints
    assert (read.name, read.kind, read.parent, read.child) == ("bend", "revolute", "palm", "tip")
    assert (read.lower, read.upper, read.mimic) == (-1, 2, None)
    np.testing.assert_array_equal(read.axis, [0, 0, 1])
    expected = np.eye(4)
    expected[:3, :3] = Rotation.from_euler("xyz", [0.1, 0.2, 0.3]).as_matrix()
    expected[:3, 3] = [1, 2, 3]
    np.testing.assert_allclose(read.T_parent_child, expected, atol=1e-12)


def test_joint_order_is_depth_first_in_file_order(tmp_path: Path) -> None:
    links = [link(name) for name in ("palm", "a1", "a2", "b1", "b2")]
    joints = [
        joint("a_far", "a1", "a2"),
        joint("b_near", "palm", "b1"),
        joint("a_near", "palm", "a1"),
        joint("b_far", "b1", "b2"),
    ]
    robot = read_urdf(write(tmp_path, *joints, *links))
    assert [j.name for j in robot.joints] == ["b_near", "b_far", "a_near", "a_far"]


def test_kinds_of_joints_and_their_limits(tmp_path: Path) -> None:
    links = [link(name) for name in "abcde"]
    joints = [
        joint("turn", "a", "b", "continuous", inside=""),
        joint("slide", "b", "c", "prismatic", inside='<limit upper="0.04"/>'),
        joint("stay", "c", "d", "fixed", inside=""),
        joint("follow", "d", "e", inside='<mimic joint="slide" multiplier="-2" offset="0.1"/>'),
    ]
    turn, slide, stay, follow = read_urdf(write(tmp_path, *links, *joints)).joints
    assert (turn.lower, turn.upper) == (-np.pi, np.pi)
    assert (slide.lower, slide.upper) == (0.0, 0.04)
    assert [j.movable for j in (turn, slide, stay, follow)] == [True, True, False, True]
    assert follow.mimic is not None
    assert (follow.mimic.joint, follow.mimic.multiplier, follow.mimic.offset) == ("slide", -2, 0.1)


def test_transmissions_and_comments_are_no_joints(tmp_path: Path) -> None:
    extra = '<!-- a note --><transmission name="t"><joint name="bend"/></transmission>'
    assert len(read_urdf(write(tmp_path, PALM, TIP, BEND, extra)).joints) == 1


@pytest.mark.parametrize(
    ("geometry", "kind", "size"),
    [
        ('<box size="0.1 0.2 0.3"/>', "box", (0.1, 0.2, 0.3)),
        ('<cylinder radius="0.1" length="0.2"/>', "cylinder", (0.1, 0.2)),
        ('<sphere radius="0.1"/>', "sphere", (0.1,)),
    ],
)
def test_primitives(tmp_path: Path, geometry: str, kind: str, size: tuple[float, ...]) -> None:
    shape = only_shape(read_urdf(write(tmp_path, link("palm", geometry), TIP, BEND)))
    assert (shape.kind, shape.size, shape.mesh_path) == (kind, size, None)


def test_visuals_before_collisions(tmp_path: Path) -> None:
    geometry = f"<geometry>{BOX}</geometry>"
    both = (
        f'<link name="palm">{f"<visual>{geometry}</visual>" * 2}<collision><geometry>'
        '<sphere radius="1"/></geometry></collision></link>'
    )
    tip = link("tip", '<sphere radius="0.01"/>', tag="collision")
    robot = read_urdf(write(tmp_path, both, tip, BEND))
    assert [[s.kind for s in x.shapes] for x in robot.links] == [["box", "box"], ["sphere"]]


# Mesh files


def test_mesh_paths_relative_to_the_urdf_absolute_and_file(tmp_path: Path) -> None:
    mesh = write_mesh(tmp_path / "meshes" / "my palm.stl")
    for address in ("meshes/my palm.stl", str(mesh), f"file://{mesh}", mesh.as_uri()):
        path = write(tmp_path, mesh_link(address, 'scale="1 2 -3"'), TIP, BEND)
        shape = only_shape(read_urdf(path))
        assert shape.kind == "mesh"
        assert shape.mesh_path is not None
        assert shape.mesh_path.resolve() == mesh.resolve()
        assert shape.scale == (1, 2, -3)


def test_one_scale_for_all_axes(tmp_path: Path) -> None:
    write_mesh(tmp_path / "a.stl")
    path = write(tmp_path, mesh_link("a.stl", 'scale="0.001"'), TIP, BEND)
    assert only_shape(read_urdf(path)).scale == (0.001, 0.001, 0.001)


@pytest.mark.parametrize(
    ("urdf", "mesh", "manifest"),
    [
        ("ws/my_hand/urdf/x/hand.urdf", "ws/my_hand/meshes/a.stl", None),  # above, by its name
        ("ws/robot/hand.urdf", "ws/my_hand/meshes/a.stl", None),  # beside a folder above
        ("ws/robot/urdf/x/hand.urdf", "ws/robot/meshes/a.stl", "ws/robot/package.xml"),
        ("ws/copy/hand.urdf", "ws/copy/meshes/a.stl", None),  # copied out of its package
        ("ws/copy/urdf/hand.urdf", "ws/copy/meshes/a.stl", None),
    ],
)
def test_packages_above_the_urdf(
    tmp_path: Path, urdf: str, mesh: str, manifest: str | None
) -> None:
    expected = write_mesh(tmp_path / mesh)
    if manifest:
        (tmp_path / manifest).write_text("<package><name>my_hand</name></package>")
    palm = mesh_link("package://my_hand/meshes/a.stl")
    shape = only_shape(read_urdf(write(tmp_path, palm, TIP, BEND, name=urdf)))
    assert shape.mesh_path is not None
    assert shape.mesh_path.resolve() == expected.resolve()


def test_package_paths_go_first(tmp_path: Path) -> None:
    write_mesh(tmp_path / "my_hand" / "a.stl")
    expected = write_mesh(tmp_path / "elsewhere" / "a.stl")
    path = write(tmp_path, mesh_link("package://my_hand/a.stl"), TIP, BEND)
    shape = only_shape(read_urdf(path, {"my_hand": tmp_path / "elsewhere"}))
    assert shape.mesh_path == expected


def test_missing_package_says_how_to_give_it(tmp_path: Path) -> None:
    path = write(tmp_path, mesh_link("package://my_hand/a.stl"), TIP, BEND)
    with pytest.raises(InputError, match=r"palm.*package://my_hand/a\.stl") as error:
        read_urdf(path)
    assert str(tmp_path / "my_hand" / "a.stl") in str(error.value)
    assert 'package_paths={"my_hand": folder}' in str(error.value)


# Errors


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot read the URDF file .*hand\.urdf: No such file"):
        read_urdf(tmp_path / "hand.urdf")
    with pytest.raises(InputError, match="cannot read the URDF file"):
        read_urdf(tmp_path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not well-formed XML"),
        (b"\x00\x01\x02", "not well-formed XML"),
        (b'<robot name="x"><link', "not well-formed XML"),
        (b'<?xml version="1.0" encoding="klingon"?><robot/>', "not well-formed XML"),
        (b"<mujoco/>", "root element is <mujoco>"),
        (b'<robot name="x"/>', "has no <link>"),
        (
            b'<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include/></robot>',
            "xacro file: expand it first",
        ),
    ],
)
def test_not_a_urdf(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "hand.urdf"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_urdf(path)


A, B, C = link("a"), link("b"), link("c")
AB = joint("ab", "a", "b")
STUCK = joint("ab", "a", "b", "fixed", inside="")


def limited(limit: str, kind: str = "revolute") -> list[str]:
    return [A, B, joint("ab", "a", "b", kind, inside=limit)]


@pytest.mark.parametrize(
    ("elements", "message"),
    [
        ([A], "no movable joint"),
        ([A, B, STUCK], "no movable joint"),
        ([A, A, B, AB], "more than one link named a"),
        ([A, B, C, AB, joint("ab", "b", "c")], "more than one joint named ab"),
        ([A, B, C, AB], "2 root links, expected one: a, c"),
        ([A, B, C, AB, joint("cb", "c", "b")], 'link "b" is the child of two joints, "ab" and'),
        ([A, B, AB, joint("ba", "b", "a")], "ab, ba form a kinematic loop"),
        ([A, B, C, joint("bc", "b", "c"), joint("cb", "c", "b")], "bc, cb form a kinematic loop"),
        ([A, joint("ab", "a", "x")], 'joint "ab" names the link "x".*its links: a'),
        ([A, B, '<joint name="ab" type="fixed"/>'], 'joint "ab": <parent> lacks .* "link"'),
        ([A, B, '<joint name="ab"/>'], 'joint "ab": <joint> lacks the attribute "type"'),
        (["<link/>"], '<link> lacks the attribute "name"'),
        ([A, B, joint("ab", "a", "b", "planar")], 'joint "ab" has the unsupported type "planar"'),
        ([A, B, joint("ab", "a", "b", "floating")], 'unsupported type "floating"'),
        ([A, B, joint("ab", "a", "b", "hinge")], 'unsupported type "hinge"'),
        ([A, B, joint("ab", "a", "b", axis="0 0 0")], "axis is the zero vector"),
        ([A, B, joint("ab", "a", "b", xyz="0 nan 0")], "origin xyz: .* holds NaN"),
        ([A, B, joint("ab", "a", "b", rpy="0 0")], 'origin rpy: expected 3 .*, got "0 0"'),
        ([A, B, joint("ab", "a", "b", axis="1 x 0")], 'axis xyz: expected 3 .*, got "1 x 0"'),
        (limited(""), "needs <limit lower upper>"),
        (limited("", "prismatic"), "needs <limit lower upper>"),
        (limited('<limit lower="2" upper="1"/>'), "lower limit 2.0 is above its upper limit 1.0"),
        (limited('<limit lower="nan" upper="1"/>'), "limit lower: .* holds NaN"),
        (limited('<limit lower="0" upper="inf"/>'), "limit upper: .* an infinite number"),
        (limited(LIMIT + '<mimic multiplier="1"/>'), '<mimic> lacks the attribute "joint"'),
        (limited(mimic("bc", 'offset="nan"')), "mimic offset: .* holds NaN"),
        ([link("a", None), link("b", None), AB], "no link has a <visual> or <collision>"),
        ([link("a", "<capsule/>"), B, AB], 'link "a": .* got <capsule>'),
        ([link("a", ""), B, AB], 'link "a": .* got nothing'),
        ([link("a", '<box size="1 1"/>'), B, AB], 'box size: expected 3 .*, got "1 1"'),
        ([link("a", '<box size="1 0 1"/>'), B, AB], "sizes of a box must be positive"),
        ([link("a", '<sphere radius="-1"/>'), B, AB], "sizes of a sphere must be positive"),
        ([link("a", "<sphere/>"), B, AB], '<sphere> lacks the attribute "radius"'),
        ([link("a", "<mesh/>"), B, AB], '<mesh> lacks the attribute "filename"'),
        ([link("a", '<mesh filename="a.stl"/>'), B, AB], 'link "a": mesh file a.stl not found'),
        ([link("a", '<mesh filename="http://x/a.stl"/>'), B, AB], "cannot read mesh address http"),
    ],
)
def test_errors(tmp_path: Path, elements: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_urdf(write(tmp_path, *elements))


def test_mesh_scale_of_zero(tmp_path: Path) -> None:
    write_mesh(tmp_path / "a.stl")
    path = write(tmp_path, mesh_link("a.stl", 'scale="1 0 1"'), TIP, BEND)
    with pytest.raises(InputError, match="flattens the mesh"):
        read_urdf(path)
