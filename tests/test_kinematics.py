from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import warp as wp
import yourdfpy
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from tiny_urdf import joint, link, mimic, write

from inhand.errors import InputError
from inhand.geometry.se3 import exp
from inhand.kernels.kinematics import Chain, pose_links
from inhand.kernels.launch import launch, pack
from inhand.kinematics import KinematicArrays, build_chain, independent_joints
from inhand.reach import reach_sphere
from inhand.urdf import read_urdf

HANDS = [
    "t42/hand_T42b.urdf",
    "robotiq/robotiq_2f_85.urdf",
    "robotiq/robotiq_2f_140.urdf",
    "robotiq/robotiq_3f.urdf",
    "allegro/allegro_right.urdf",
]


def load(path: Path) -> tuple[KinematicArrays, list[str], tuple[str, ...]]:
    """The chain with all links, their names, and the names of the independent joints."""
    robot = read_urdf(path)
    links = [x.name for x in robot.links]
    return build_chain(robot, links), links, independent_joints(robot)


def reference(path: Path, joints: tuple[str, ...], links: list[str], q: np.ndarray) -> np.ndarray:
    """The links' poses by yourdfpy, shape (b, L, 4, 4)."""
    urdf = yourdfpy.URDF.load(str(path), load_meshes=False)
    poses = []
    for positions in q.tolist():
        urdf.update_cfg(dict(zip(joints, positions, strict=True)))
        poses.append([urdf.get_transform(name) for name in links])
    return np.array(poses)


def from_elements(*elements: str) -> tuple[KinematicArrays, list[str], tuple[str, ...]]:
    with TemporaryDirectory() as folder:
        return load(write(Path(folder), *elements))


def translation(T: np.ndarray) -> np.ndarray:
    return np.asarray(T[..., :3, 3])


@pytest.mark.parametrize("name", HANDS)
def test_equals_yourdfpy_on_real_hands(shared_data: Path, name: str) -> None:
    path = shared_data / "hands" / name
    chain, links, joints = load(path)
    q = np.random.default_rng(0).uniform(-3, 3, (20, len(joints)))
    expected = reference(path, joints, links, q)
    np.testing.assert_allclose(chain.link_poses(q), expected, rtol=0, atol=1e-9)


numbers = st.floats(-2, 2).map(lambda x: round(x, 6))
triples = st.tuples(numbers, numbers, numbers)


@st.composite
def trees(draw: st.DrawFn) -> list[str]:
    """Elements of a random tree of 2 to 8 links; mimics follow the first joint."""
    elements = [link("l0")]
    for i in range(1, draw(st.integers(2, 8))):
        kind = "revolute"
        inside = mimic("j1", "multiplier='{}' offset='{}'".format(*draw(triples)[:2]))
        if i == 1 or draw(st.booleans()):
            kinds = ["revolute", "continuous", "prismatic", *(["fixed"] if i > 1 else [])]
            kind = draw(st.sampled_from(kinds))
            inside = "<limit lower='-1' upper='1'/>"
        axis = draw(triples)
        if np.linalg.norm(axis) < 0.1:
            axis = (0, 0, 1)
        if kind == "prismatic":  # yourdfpy takes the axis of a prismatic joint as it is
            axis = draw(st.sampled_from([(1, 0, 0), (0, -1, 0), (0, 0.6, 0.8)]))
        elements.append(link(f"l{i}"))
        elements.append(
            joint(
                f"j{i}",
                f"l{draw(st.integers(0, i - 1))}",
                f"l{i}",
                kind,
                inside,
                xyz=" ".join(map(str, draw(triples))),
                rpy=" ".join(map(str, draw(triples))),
                axis=" ".join(map(str, axis)),
            )
        )
    return elements


@given(trees(), st.integers(0, 1000))
@settings(max_examples=40, deadline=None)
def test_equals_yourdfpy_on_random_trees(elements: list[str], seed: int) -> None:
    with TemporaryDirectory() as folder:
        path = write(Path(folder), *elements)
        chain, links, joints = load(path)
        q = np.random.default_rng(seed).uniform(-3, 3, (3, len(joints)))
        expected = reference(path, joints, links, q)
    np.testing.assert_allclose(chain.link_poses(q), expected, rtol=0, atol=1e-9)


def posed(
    chain: KinematicArrays, q: np.ndarray, T_camera_hand: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Poses of the joints' frames (c, j, 4, 4) and of the links (c, L, 4, 4), by the kernel."""
    joints = wp.empty((len(q), len(chain.parent)), dtype=wp.mat44d, device="cpu")
    links = wp.empty(len(q) * len(chain.link_joint), dtype=wp.mat44, device="cpu")
    wrists = wp.array(T_camera_hand, dtype=wp.mat44d, device="cpu")
    positions = wp.array(q, dtype=wp.float64, device="cpu")
    packed = pack(Chain, "cpu", **vars(chain))
    launch(pose_links, len(q), [packed, positions, wrists, joints, links], "cpu")
    return joints.numpy(), links.numpy().reshape(len(q), -1, 4, 4)


@given(trees(), st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_the_kernel_poses_joints_and_links(elements: list[str], seed: int) -> None:
    rng = np.random.default_rng(seed)
    with TemporaryDirectory() as folder:
        path = write(Path(folder), *elements)
        chain, names, independent = load(path)
        q = rng.uniform(-3, 3, (3, len(independent)))
        expected = reference(path, independent, names, q)
    wrists = exp(rng.normal(size=(3, 6)))
    joints, links = posed(chain, q, wrists)
    np.testing.assert_allclose(links, wrists[:, None] @ expected, rtol=0, atol=1e-5)
    np.testing.assert_allclose(joints, wrists[:, None] @ chain.joint_poses(q), rtol=0, atol=1e-12)
    one_wrist = posed(chain, q, wrists[:1])[1]
    np.testing.assert_allclose(one_wrist, wrists[0] @ expected, rtol=0, atol=1e-5)


@given(trees(), st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_poses_are_rigid_and_batches_are_rows(elements: list[str], seed: int) -> None:
    chain, _, joints = from_elements(*elements)
    q = np.random.default_rng(seed).uniform(-3, 3, (3, 2, len(joints)))
    poses = chain.link_poses(q)
    assert poses.shape == (3, 2, len(chain.link_joint), 4, 4)
    R = poses[..., :3, :3]
    np.testing.assert_allclose(
        R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(R), 1)
    np.testing.assert_allclose(poses[2, 1], chain.link_poses(q[2, 1]), atol=1e-12)


@given(st.floats(-3, 3), st.floats(-3, 3))
def test_turns_about_one_axis_add_up(first: float, second: float) -> None:
    ab = joint("ab", "a", "b", axis="1 2 2", xyz="0 0 0")
    bc = joint("bc", "b", "c", axis="1 2 2", xyz="0 0 0")
    chain, _, _ = from_elements(link("a"), link("b"), link("c"), ab, bc)
    turned = chain.link_poses(np.array([first, second]))[2, :3, :3]
    expected = Rotation.from_rotvec((first + second) * np.array([1, 2, 2]) / 3).as_matrix()
    np.testing.assert_allclose(turned, expected, atol=1e-12)


def test_prismatic_axis_is_a_direction() -> None:
    slide = joint("slide", "a", "b", "prismatic", xyz="1 0 0", axis="0 0 7")
    chain, _, _ = from_elements(link("a"), link("b"), slide)
    np.testing.assert_allclose(translation(chain.link_poses(np.array([0.5]))[1]), [1, 0, 0.5])


def test_fixed_joints_are_folded_in() -> None:
    fixed = joint("mount", "world", "palm", "fixed", inside="", xyz="0 1 0")
    bend = joint("bend", "palm", "finger")
    pad = joint("glue", "finger", "pad", "fixed", inside="")
    names = ("world", "palm", "finger", "pad")
    chain, _, joints = from_elements(*map(link, names), fixed, bend, pad)
    assert joints == ("bend",)
    assert chain.parent.tolist() == [-1]
    assert chain.link_joint.tolist() == [-1, -1, 0, 0]
    poses = chain.link_poses(np.array([np.pi / 2]))
    expected = [[0.0, 1.0, 0.0], [0.0, 1.0, 0.05], [0.0, 0.95, 0.05]]
    np.testing.assert_allclose(translation(poses[1:]), expected)


# Mimic joints


@given(st.floats(-3, 3))
def test_mimic_of_a_mimic(position: float) -> None:
    joints = [
        joint("first", "a", "b"),
        joint("third", "a", "d", inside=mimic("second", "multiplier='3' offset='0.2'")),
        joint("second", "a", "c", inside=mimic("first", "multiplier='-2' offset='0.1'")),
    ]
    chain, _, names = from_elements(*map(link, "abcd"), *joints)
    assert names == ("first",)
    second = -2 * position + 0.1
    np.testing.assert_allclose(
        chain.joint_positions(np.array([position])), [position, 3 * second + 0.2, second]
    )


def test_mimic_without_a_rule_moves_alike() -> None:
    chain, _, _ = from_elements(
        *map(link, "abc"), joint("ab", "a", "b"), joint("ac", "a", "c", inside=mimic("ab"))
    )
    poses = chain.link_poses(np.array([0.7]))
    np.testing.assert_array_equal(poses[1], poses[2])


@pytest.mark.parametrize(
    ("sources", "message"),
    [
        (("x", None), 'joint "ab" mimics "x", which is no movable joint.*: ab, ac'),
        (("ad", None), 'joint "ab" mimics "ad", which is no movable joint'),
        (("ab", None), "follow each other in a circle: ab"),
        (("ac", "ab"), "follow each other in a circle: ab, ac"),
    ],
)
def test_wrong_mimics(sources: tuple[str | None, ...], message: str) -> None:
    joints = [
        joint(name, "a", name[1], inside=mimic(source) if source else mimic("").split("<mimic")[0])
        for name, source in zip(("ab", "ac"), sources, strict=True)
    ]
    stuck = joint("ad", "a", "d", "fixed", inside="")
    with pytest.raises(InputError, match=message):
        from_elements(*map(link, "abcd"), *joints, stuck)


# Reach


@given(trees(), st.integers(0, 1000))
@settings(max_examples=40, deadline=None)
def test_reach_holds_every_configuration(elements: list[str], seed: int) -> None:
    chain, links, joints = from_elements(*elements)
    rng = np.random.default_rng(seed)
    lower, extent = rng.uniform(-3, 1, len(joints)), rng.uniform(0, 3, len(joints))
    centres, radii = rng.normal(size=(len(links), 3)), rng.uniform(0, 1, len(links))
    middle, radius = reach_sphere(chain, centres, radii, lower, lower + extent)
    share = np.clip(rng.uniform(-0.5, 1.5, (2000, len(joints))), 0, 1)  # half are at a limit
    poses = chain.link_poses(lower + share * extent)
    moved = np.einsum("blij,lj->bli", poses[..., :3, :3], centres) + translation(poses)
    assert (np.linalg.norm(moved - middle, axis=-1) + radii <= radius + 1e-9).all()


def test_reach_is_tight_for_a_finger() -> None:
    chain, links, _ = from_elements(
        *map(link, "abc"), joint("ab", "a", "b", xyz="0 0 0"), joint("bc", "b", "c", xyz="0 0 1")
    )
    lower, upper = np.array([0.0, 0.0]), np.array([np.pi / 2, np.pi / 2])
    tips = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 1.0]])
    middle, radius = reach_sphere(chain, tips, np.zeros(len(links)), lower, upper)
    # The finger bends in a plane from (0, 0, 2) through (0, -2, 0) to (0, -1, -1).
    np.testing.assert_allclose(middle, [0.0, -1.0, 0.5], atol=0.01)
    assert np.hypot(1, 1.5) < radius < np.hypot(1, 1.5) * 1.01


def test_reach_of_a_chain_too_long_for_a_grid() -> None:
    names = [f"l{i}" for i in range(15)]
    joints = [joint(f"j{i}", names[i], names[i + 1], xyz="0 0 1") for i in range(14)]
    chain, links, _ = from_elements(*map(link, names), *joints)
    n = len(links)
    middle, radius = reach_sphere(
        chain, np.zeros((n, 3)), np.ones(n), np.full(14, -2.0), np.full(14, 2.0)
    )
    assert radius == pytest.approx(13 + 1 + np.linalg.norm(middle - [0, 0, 1]))
