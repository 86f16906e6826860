"""Every input wrong in turn: an `InputError` that helps, or `found=False` with a reason."""

import json
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import pytest
import tiny_urdf
import trimesh
from any_answer import check_any_answer
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from inhand import Camera, EstimatorConfig, Hand, InputError, ObjectModel, PoseEstimator
from inhand.builtin.hand import write_hand
from inhand.builtin.objects import OBJECTS
from inhand.cli import main
from inhand.config import HypothesesConfig, Section, SegmentationConfig
from inhand.estimate import PoseEstimate
from inhand.geometry.mesh import TriangleMesh, box
from inhand.geometry.se3 import exp, random_rotation
from inhand.io import read_depth, read_transform
from inhand.kernels.depth import DepthRenderer
from inhand.synth.demo import builtin_hand, builtin_object
from inhand.synth.scene import HAND, OBJECT, Scene

CAMERA = Camera(307.5, 307.5, 159.75, 119.75, width=320, height=240)
"""The camera of the fixed scenes, every second pixel."""
K = CAMERA.matrix
Inputs = dict[str, Any]


@pytest.fixture(scope="module")
def inputs(scenes: list[Scene]) -> Inputs:
    """Good input: a cylinder in the hand, at half resolution."""
    return {
        "depth": scenes[0].depth[::2, ::2].copy(),
        "camera": CAMERA,
        "T_camera_hand": scenes[0].T_camera_hand_given,
    }


@pytest.fixture(scope="module")
def estimator(scenes: list[Scene]) -> PoseEstimator:
    return PoseEstimator(scenes[0].hand, scenes[0].obj, device="cpu")


def changed(inputs: Inputs, name: str, change: Callable[[Any], Any]) -> Inputs:
    return {**inputs, name: change(inputs[name])}


def test_good_input_is_found(estimator: PoseEstimator, inputs: Inputs) -> None:
    assert estimator.estimate(**inputs).found


# Depth


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: None, "depth must be a floating-point image in metres, got None"),
        (lambda d: "depth.png", "floating-point image in metres, got 'depth.png'"),
        (lambda d: [[0.4, 0.5], [0.4]], r"floating-point image in metres, got \[\[0.4, 0.5\]"),
        (lambda d: d.ravel(), r"shape \(H, W\), got shape \(76800,\)"),
        (lambda d: d[..., None], r"shape \(H, W\), got shape \(240, 320, 1\)"),
        (lambda d: np.dstack([d, d, d]), r"shape \(H, W\), got shape \(240, 320, 3\)"),
        (lambda d: d.T, "240 x 320 pixels but the camera 320 x 240; scale the intrinsics"),
        (lambda d: d[::2, ::2], "160 x 120 pixels but the camera 320 x 240"),
        (lambda d: d[:0], "320 x 0 pixels but the camera 320 x 240"),
        (lambda d: (1000 * d).astype(np.uint16), "got uint16; multiply the counts by .*0.001"),
        (lambda d: d > 0, "floating-point image in metres, got an array of bool"),
        (lambda d: d + 0j, "got an array of complex64"),
        (lambda d: d.astype(object), "got an array of object"),
        (lambda d: d.astype(str), "got an array of <U"),
        (lambda d: 1000 * d, r"median depth is \d\d\d.*millimetres; multiply it by 0.001"),
        (lambda d: -d, "negative numbers; z points away from the camera"),
        (lambda d: np.where(d == d.max(), -1.0, d), "negative numbers"),
    ],
)
def test_bad_depth(
    estimator: PoseEstimator, inputs: Inputs, change: Callable[[Any], Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        estimator.estimate(**changed(inputs, "depth", change))


NO_READINGS = "only 0 depth readings lie in the region of the hand .*check"


@pytest.mark.parametrize(
    "change",
    [
        np.zeros_like,
        lambda d: np.full_like(d, np.nan),
        lambda d: np.full_like(d, np.inf),
        lambda d: np.full_like(d, -np.inf),
        lambda d: np.full_like(d, 1e-30),
        lambda d: np.full_like(d, 3.0),  # a far wall
        lambda d: 10 * d,
        lambda d: np.ma.masked_array(d, np.ones_like(d, dtype=bool)),
    ],
)
def test_depth_without_an_answer(
    estimator: PoseEstimator, inputs: Inputs, change: Callable[[Any], Any]
) -> None:
    assert_no_answer(estimator.estimate(**changed(inputs, "depth", change)), NO_READINGS)


def assert_no_answer(estimate: PoseEstimate, reason: str) -> None:
    assert not estimate.found
    assert re.search(reason, estimate.reason)
    assert estimate.T_camera_object is None
    assert estimate.confidence == 0
    assert estimate.candidates == ()


# Camera


def with_entry(row: int, column: int, value: float) -> np.ndarray:
    matrix = K.copy()
    matrix[row, column] = value
    return matrix


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (None, "K must be a 3x3 matrix of numbers, got None"),
        ("K", "3x3 matrix of numbers, got 'K'"),
        ([[1, 2], [3]], "3x3 matrix of numbers"),
        (K.astype(str), "3x3 matrix of numbers, got an array of <U"),
        (K + 0j, "got an array of complex128"),
        (K > 0, "got an array of bool"),
        (K[:2], r"3x3 intrinsic matrix, got shape \(2, 3\)"),
        (K.ravel(), r"got shape \(9,\)"),
        (np.eye(4), r"got shape \(4, 4\)"),
        (with_entry(0, 2, np.nan), "NaN or infinite"),
        (with_entry(1, 1, np.inf), "NaN or infinite"),
        (with_entry(0, 0, -300), "focal lengths must be positive, got fx=-300.0, fy=307.5"),
        (with_entry(1, 1, 0), "focal lengths must be positive"),
        (with_entry(0, 1, 2.0), "skew is not supported, .* = 2.0; rectify the image"),
        (K.T, "zeros below its diagonal .* a transposed K has its principal point in the last row"),
        (2 * K, r"K\[2, 2\] = 1"),
        (with_entry(0, 2, 2000), r"principal point \(2000.0, 119.8\) lies far outside the 320 x"),
        (with_entry(1, 2, -500), "far outside .* do the intrinsics belong to this image size"),
        (np.diag([0.001, 0.001, 1]) @ K, "fx = 0.3075 pixel does not fit an image 320 pixel wide"),
        (with_entry(1, 1, 3.0), "fy = 3 pixel does not fit an image 240 pixel high"),
        (with_entry(0, 0, 1e5), "fx = 1e.05 pixel does not fit"),
    ],
)
def test_bad_intrinsic_matrix(matrix: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Camera.from_matrix(matrix, width=320, height=240)


GOOD_CAMERA: dict[str, Any] = {
    "fx": 300,
    "fy": 300,
    "cx": 160,
    "cy": 120,
    "width": 320,
    "height": 240,
}
BAD_CAMERAS = [
    ({"fx": "300"}, "fx must be a number, got '300'"),
    ({"fy": True}, "fy must be a number, got True"),
    ({"cx": None}, "cx must be a number, got None"),
    ({"cy": [120]}, r"cy must be a number, got \[120\]"),
    ({"fx": math.nan}, "fx must be a finite number, got nan"),
    ({"cx": math.inf}, "cx must be a finite number, got inf"),
    ({"fx": 10**400}, "fx must be a finite number, got 1000"),
    ({"fx": -300}, "focal lengths must be positive"),
    ({"fy": 0}, "focal lengths must be positive"),
    ({"width": 320.5}, r"width \[pixel\] must be a whole number of at least 1, got 320.5"),
    ({"width": 0}, "width .* at least 1, got 0"),
    ({"height": -240}, "height .* at least 1, got -240"),
    ({"height": "240"}, "height .* must be a number, got '240'"),
]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        *BAD_CAMERAS,
        ({"fx": np.array([300.0, 300.0])}, "fx must be a number"),
        ({"fx": 300j}, "fx must be a number, got 300j"),
        ({"depth_unit": 1000}, "depth_unit is metres per count .0.001 for mm., got 1000"),
        ({"depth_unit": 0}, "depth_unit is metres per count"),
        ({"depth_unit": "mm"}, "depth_unit must be a number, got 'mm'"),
    ],
)
def test_bad_camera(change: Mapping[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Camera(**{**GOOD_CAMERA, **change})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        *BAD_CAMERAS,
        ({"depth_unit_m": 1000}, "depth_unit is metres per count"),
        ({"cx": 2000}, "principal point .* far outside"),
        ({"width": 32, "height": 24}, "do the intrinsics belong to this image size"),
    ],
)
def test_bad_camera_file(tmp_path: Path, change: Mapping[str, Any], message: str) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({**GOOD_CAMERA, **change}))
    with pytest.raises(InputError, match=rf"camera\.json: .*{message}"):
        Camera.from_json(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is not JSON"),
        ("[" * 100_000, "is not JSON"),
        ("\xff", "is not JSON"),
        ("[300]", "lacks fx, fy, cx, cy, width, height"),
        (json.dumps({"K": K.tolist(), "width": 320, "height": 240}), "lacks fx, fy, cx, cy;"),
    ],
)
def test_no_camera_file(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "camera.json"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(InputError, match=message):
        Camera.from_json(path)


def test_numbers_of_any_kind_make_the_same_camera() -> None:
    kinds = {"fx": np.float64(300), "fy": 300.0, "width": np.int64(320), "height": 240.0}
    camera = Camera(**{**GOOD_CAMERA, **kinds})
    assert camera == Camera(**GOOD_CAMERA)
    assert type(camera.width) is type(camera.height) is int


@pytest.mark.parametrize("camera", [None, K, GOOD_CAMERA, "camera.json"])
def test_no_camera(estimator: PoseEstimator, inputs: Inputs, camera: Any) -> None:
    with pytest.raises(InputError, match=r"camera must be an inhand\.Camera, got "):
        estimator.estimate(inputs["depth"], camera, inputs["T_camera_hand"])


@pytest.mark.parametrize("size", [(240, 320), (640, 480), (320, 241), (1, 1)])
def test_camera_of_another_size(
    estimator: PoseEstimator, inputs: Inputs, size: tuple[int, int]
) -> None:
    camera = replace(CAMERA, width=size[0], height=size[1])
    with pytest.raises(InputError, match=f"320 x 240 pixels but the camera {size[0]} x {size[1]}"):
        estimator.estimate(**{**inputs, "camera": camera})


# Wrist pose


def with_rotation(T: np.ndarray, M: np.ndarray) -> np.ndarray:
    return np.block([[T[:3, :3] @ M, T[:3, 3:]], [T[3:]]])


def with_translation(T: np.ndarray, xyz: Any) -> np.ndarray:
    return np.block([[T[:3, :3], np.reshape(xyz, (3, 1))], [T[3:]]])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda T: None, "T_camera_hand must be a 4x4 matrix of numbers, got None"),
        (lambda T: "pose", "4x4 matrix of numbers, got 'pose'"),
        (lambda T: [[1.0], [2.0, 3.0]], "4x4 matrix of numbers"),
        (lambda T: T.astype(str), "4x4 matrix of numbers, got an array of <U"),
        (lambda T: T.astype(object), "got an array of object"),
        (lambda T: T + 0j, "got an array of complex128"),
        (lambda T: T > 0, "got an array of bool"),
        (lambda T: T[:3], r"4x4 homogeneous matrix, got shape \(3, 4\)"),
        (lambda T: T[None], r"got shape \(1, 4, 4\)"),
        (lambda T: np.array([0, 0, 0.5, 0, 0, 0, 1]), r"got shape \(7,\)"),
        (lambda T: with_translation(T, [0, np.nan, 0.5]), "NaN or infinite"),
        (lambda T: with_translation(T, [0, 0, np.inf]), "NaN or infinite"),
        (lambda T: T.T, "last row must be 0 0 0 1, .*a transposed matrix has its translation"),
        (lambda T: np.zeros((4, 4)), "last row must be 0 0 0 1"),
        (lambda T: with_rotation(T, 1.01 * np.eye(3)), "not a rotation .*remove scale and shear"),
        (lambda T: with_rotation(T, np.eye(3) + np.eye(3, k=1)), "not a rotation"),
        (lambda T: with_rotation(T, np.zeros((3, 3))), "not a rotation"),
        (lambda T: with_rotation(T, np.diag([1, 1, -1])), "left-handed .*flip one axis"),
        (
            lambda T: with_translation(T, 1000 * T[:3, 3]),
            r"\d\d\d.* m from the camera: .*millimetres",
        ),
        (lambda T: with_translation(T, [0, 0, 1e300]), "from the camera"),
    ],
)
def test_bad_wrist_pose(
    estimator: PoseEstimator, inputs: Inputs, change: Callable[[Any], Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        estimator.estimate(**changed(inputs, "T_camera_hand", change))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda T: with_translation(T, [0, 0, -0.5]), "hand behind the camera"),
        (np.linalg.inv, "hand behind the camera"),
        (lambda T: with_translation(T, [5, 0, 0.5]), "hand outside the image"),
        (lambda T: with_translation(T, [0, -5, 0.5]), "hand outside the image"),
        (lambda T: with_translation(T, [0, 0, 40]), r"too far away \(40.\d* m\)"),
        (lambda T: with_translation(T, [0, 0, 1.5]), r"region of the hand \(around 1.5\d m\)"),
        (lambda T: with_translation(T, [0, 0, 0]), "in the region of the hand"),
    ],
)
def test_wrist_pose_without_an_answer(
    estimator: PoseEstimator, inputs: Inputs, change: Callable[[Any], Any], reason: str
) -> None:
    assert_no_answer(estimator.estimate(**changed(inputs, "T_camera_hand", change)), reason)


# Object and hand


def changed_box(change: Callable[[np.ndarray], np.ndarray]) -> trimesh.Trimesh:
    mesh = box((0.03, 0.05, 0.02))
    return trimesh.Trimesh(change(mesh.vertices), mesh.faces, process=False)


def with_nan(vertices: np.ndarray) -> np.ndarray:
    return np.where(np.arange(len(vertices))[:, None] == 3, np.nan, vertices)


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        (None, "expected a triangle mesh, got a NoneType"),
        (b"object.ply", "expected a triangle mesh, got a bytes"),
        (np.zeros((8, 3)), "expected a triangle mesh, got a ndarray"),
        (trimesh.PointCloud(np.eye(3)), "expected a triangle mesh, got a PointCloud"),
        (trimesh.Trimesh(), "no faces"),
        (trimesh.Scene(), "no faces"),
        (changed_box(lambda v: 1000 * v), r'diameter is 61.64 m .*between 0.005 m .*unit="mm"'),
        (changed_box(lambda v: v / 1000), "diameter is 6.164e-05 m"),
        (changed_box(with_nan), "vertices that are NaN or infinite"),
        (changed_box(lambda v: 0 * v), "zero area"),
        (changed_box(lambda v: v + 1e6), r"1e.06 m away from the origin .* move the mesh"),
    ],
)
def test_bad_object(mesh: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        ObjectModel.from_mesh(mesh)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.ply", "", "cannot read mesh file"),
        ("a.ply", "ply\nformat ascii 1.0\nelement vertex 3\nend_header\n0 0", "cannot read mesh"),
        ("a.stl", "solid\nfacet", r"a\.stl"),
        ("a.obj", "no mesh", "no faces"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nf 1 2 9", "cannot read mesh file"),
        ("a.obj", "v 0 0\nv 1 0\nv 0 1\nv 1 1\nf 1 2 3", "vertices must have 3 coordinates"),
        ("a.obj", "v 0 0 nan\nv .1 0 0\nv 0 .1 0\nf 1 2 3", "NaN or infinite"),
        ("a.glb", "glTF", "cannot read mesh file"),
        ("a.dae", "<COLLADA", "cannot read mesh file"),
        ("a.json", "{}", "cannot read mesh file"),
        ("noending", "x", "cannot read mesh file"),
    ],
)
def test_broken_object_files(tmp_path: Path, name: str, content: str, message: str) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=message) as error:
        ObjectModel.from_mesh(tmp_path / name)
    assert name in str(error.value)


@pytest.mark.parametrize("unit", ["M", "meters", "", None, 0.001, ["mm"]])
def test_bad_unit(unit: Any) -> None:
    with pytest.raises(InputError, match=r"unknown unit .*known: m, cm, mm, inch"):
        ObjectModel.from_mesh(box((0.03, 0.05, 0.02)), unit=unit)


@pytest.mark.parametrize("symmetry", ["round", True, np.eye(4)])
def test_bad_symmetry(symmetry: Any) -> None:
    with pytest.raises(InputError, match="symmetry must be None"):
        ObjectModel.from_mesh(box((0.03, 0.05, 0.02)), symmetry=symmetry)


@pytest.mark.parametrize("path", [None, 3, b"hand.urdf"])
def test_no_path(path: Any) -> None:
    for read in (
        Hand.from_urdf,
        Camera.from_json,
        read_transform,
        lambda path: read_depth(path, CAMERA),
    ):
        with pytest.raises(InputError, match=f"must be a path, got {path}"):
            read(path)


# Estimator and configuration


def test_bad_estimator() -> None:
    hand, obj = builtin_hand(), builtin_object("cuboid")
    wrong: list[tuple[list[Any], str]] = [
        ([None, obj], r"hand must be an inhand\.Hand, got None"),
        (["hand.urdf", obj], r"hand must be an inhand\.Hand, got 'hand.urdf'"),
        ([obj, hand], r"hand must be an inhand\.Hand, got ObjectModel"),
        ([hand, obj.mesh], r"obj must be an inhand\.ObjectModel, got TriangleMesh"),
        ([hand, obj, {}], r"config must be an inhand\.EstimatorConfig, got {}"),
        ([hand, obj, EstimatorConfig], "config must be an"),
        ([hand, obj, None, "toaster"], 'no device "toaster" here; available: cpu'),
        ([hand, obj, None, "cuda:99"], 'no device "cuda:99" here'),
        ([hand, obj, None, ""], "no device"),
        ([hand, obj, None, 0], "no device"),
    ]
    for arguments, message in wrong:
        with pytest.raises(InputError, match=message):
            PoseEstimator(*arguments)


SECTIONS = [
    (name, kind)
    for name, kind in get_type_hints(EstimatorConfig).items()
    if isinstance(kind, type) and issubclass(kind, Section)
]


NONSENSE: list[Any] = [None, "nonsense", 0.5j, math.nan, math.inf, [1]]


@pytest.mark.parametrize("kind", [kind for _, kind in SECTIONS])
def test_every_parameter_is_checked(kind: type) -> None:
    for field in fields(kind):
        for value in NONSENSE:
            with pytest.raises(InputError, match=rf"{kind.__name__}\.{field.name} must be"):
                kind(**{field.name: value})
    assert kind() == kind(**{field.name: getattr(kind(), field.name) for field in fields(kind)})


@pytest.mark.parametrize(("name", "kind"), SECTIONS)
def test_every_section_is_checked(name: str, kind: type) -> None:
    wrong: list[Any] = [None, {}, kind, EstimatorConfig()]
    for value in wrong:
        with pytest.raises(InputError, match=rf"EstimatorConfig\.{name} must be a {kind.__name__}"):
            EstimatorConfig(**{name: value})


@pytest.mark.parametrize(
    ("make", "values", "message"),
    [
        (EstimatorConfig, {"seed": -1}, "seed must be a whole number of at least 0, got -1"),
        (EstimatorConfig, {"seed": 0.5}, "seed must be a whole number"),
        (EstimatorConfig, {"seed": None}, "seed must be a number, got None"),
        (EstimatorConfig.paper, {"seed": "x"}, "seed must be a number, got 'x'"),
        (HypothesesConfig, {"pairs": 0}, "pairs must be a whole number of at least 1, got 0"),
        (HypothesesConfig, {"pairs": -1}, "pairs must be a whole number of at least 1, got -1"),
        (HypothesesConfig, {"pairs": 10.5}, "pairs must be a whole number"),
        (HypothesesConfig, {"pairs": True}, "pairs must be a number, got True"),
        (HypothesesConfig, {"method": "magic"}, 'must be "pairs" or "congruent_sets", got .magic'),
        (HypothesesConfig, {"coplanarity": 0}, "coplanarity must be above 0, got 0"),
        (HypothesesConfig, {"coplanarity": -0.003}, "coplanarity must be above 0, got -0.003"),
        (HypothesesConfig, {"min_width": -0.1}, "min_width must be between 0 and inf, got -0.1"),
        (HypothesesConfig, {"sampling_discount": 2}, "must be between 0 and 1, got 2"),
        (HypothesesConfig, {"lcp_normal_angle": 30}, "must be between 0 and 3.14159, got 30"),
        (HypothesesConfig, {"min_width": 0.9}, "min_width = 0.9 must be below max_width = 0.9"),
        (SegmentationConfig, {"hand_distance": 1}, "must be below certain_distance"),
    ],
)
def test_nonsense_parameters(
    make: Callable[..., Any], values: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        make(**values)


def test_numbers_of_any_kind_make_the_same_parameters() -> None:
    kinds: dict[str, Any] = {"pairs": np.int32(10), "matches": 7.0, "max_width": np.float32(1)}
    config = HypothesesConfig(**kinds)
    assert config == HypothesesConfig(pairs=10, matches=7, max_width=1.0)
    assert type(config.pairs) is type(config.matches) is int
    assert type(config.max_width) is float


# Images without an answer


def test_empty_hand(scenes: list[Scene]) -> None:
    for scene in scenes:
        depth = rendered(scene, [link.mesh for link in scene.hand.links], link_poses(scene))
        estimate = PoseEstimator(scene.hand, scene.obj, device="cpu").estimate(
            depth, scene.camera, scene.T_camera_hand
        )
        assert_no_answer(estimate, "the object is hidden, is not in the hand, or gives no depth")
        assert estimate.T_camera_hand is not None
        assert set(estimate.joint_positions) == set(scene.joint_positions)


def test_something_hides_hand_and_object(scenes: list[Scene]) -> None:
    scene = scenes[0]
    board = np.eye(4)
    board[2, 3] = 0.15
    links = [link.mesh for link in scene.hand.links]
    depth = rendered(
        scene,
        [*links, scene.obj.mesh, box((0.4, 0.4, 0.001))],
        [*link_poses(scene), scene.T_camera_object, board],
    )
    estimate = PoseEstimator(scene.hand, scene.obj, device="cpu").estimate(
        depth, scene.camera, scene.T_camera_hand
    )
    assert_no_answer(estimate, NO_READINGS)


@pytest.mark.parametrize("q", [(0.0, 0.0, 0.0, 0.0), (0.5, 0.3, 0.5, 0.3), (1.0, 0.5, 1.0, 0.5)])
def test_object_behind_the_hand(q: tuple[float, ...]) -> None:
    """The camera looks at the back of the palm, and the object is in front of it."""
    hand, obj = builtin_hand(), builtin_object("cuboid")
    T_camera_hand, T_camera_object = np.eye(4), np.eye(4)
    T_camera_hand[2, 3], T_camera_object[2, 3] = 0.35, 0.47
    meshes = [*(link.mesh for link in hand.links), obj.mesh]
    poses = [*(T_camera_hand @ hand.forward_kinematics(q)), T_camera_object]
    depth, index = DepthRenderer(meshes, "cpu").render(CAMERA, np.stack(poses))
    assert not (index == len(hand.links)).any()
    estimate = PoseEstimator(hand, obj, device="cpu").estimate(depth, CAMERA, T_camera_hand)
    assert_no_answer(estimate, "the object is hidden")


def test_hand_that_is_not_there(scenes: list[Scene]) -> None:
    """Only what is behind the hand is left, wall or nothing."""
    for scene in scenes:
        background = np.where(np.isin(scene.label, [HAND, OBJECT]), 0, scene.depth)
        estimate = PoseEstimator(scene.hand, scene.obj, device="cpu").estimate(
            background.astype(np.float32), scene.camera, scene.T_camera_hand_given
        )
        assert_no_answer(
            estimate, "does not show the hand|depth readings (lie in the region of|near) the hand"
        )


def test_wall_in_place_of_the_hand(estimator: PoseEstimator, inputs: Inputs) -> None:
    """A wall where the hand should be is not taken for the hand."""
    estimate = estimator.estimate(**changed(inputs, "depth", lambda d: np.full_like(d, 0.45)))
    assert_no_answer(estimate, "does not show the hand")


def link_poses(scene: Scene) -> list[np.ndarray]:
    q = scene.hand.joint_vector(scene.joint_positions)
    return list(scene.T_camera_hand @ scene.hand.forward_kinematics(q))


def rendered(scene: Scene, meshes: list[TriangleMesh], poses: list[np.ndarray]) -> np.ndarray:
    return DepthRenderer(meshes, "cpu").render(scene.camera, np.stack(poses))[0]


# Anything at all


@pytest.fixture(scope="module", params=["default", "paper"])
def any_estimator(request: pytest.FixtureRequest) -> PoseEstimator:
    config = EstimatorConfig.paper() if request.param == "paper" else EstimatorConfig()
    return PoseEstimator(builtin_hand(), builtin_object("can"), config, "cpu")


@settings(max_examples=40, deadline=None, derandomize=True, database=None)
@given(
    width=st.integers(8, 160),
    height=st.integers(8, 120),
    field_of_view=st.floats(0.2, 2.0),
    distance=st.floats(0.03, 10.0),
    surface=st.sampled_from(["wall", "waves", "stairs", "noise", "any float"]),
    strewn=st.lists(st.sampled_from([0.0, np.nan, np.inf, -np.inf, 1e-30, 1e-3, 1e30])),
    dtype=st.sampled_from([np.float16, np.float32, np.float64]),
    seed=st.integers(0, 2**32 - 1),
)
def test_made_up_images(
    any_estimator: PoseEstimator,
    width: int,
    height: int,
    field_of_view: float,
    distance: float,
    surface: str,
    strewn: list[float],
    dtype: type,
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    f = width / (2 * np.tan(field_of_view / 2))
    cx, cy = rng.uniform(0, (width, height))
    camera = Camera(f, f * rng.uniform(0.8, 1.2), cx, cy, width, height)
    v, u = np.mgrid[:height, :width]
    depth = {
        "wall": np.full(u.shape, distance),
        "waves": distance + 0.02 * (np.sin(u / 7) + np.cos(v / 5)),
        "stairs": distance + 0.01 * (u // 9 % 4),
        "noise": rng.uniform(0.01, 2 * distance, u.shape),
        "any float": 10.0 ** rng.uniform(-44, 38, u.shape),
    }[surface]
    for value in strewn:
        depth[rng.random(depth.shape) < rng.random()] = value
    T = np.eye(4)
    T[:3, :3] = random_rotation(rng)
    T[:3, 3] = rng.normal(scale=0.05, size=3) + [0, 0, distance]
    T[:3, 3] -= T[:3, :3] @ any_estimator.hand.hand.reach[0]
    with np.errstate(over="ignore"):
        check_any_answer(any_estimator, np.abs(depth).astype(dtype), camera, T)


@settings(max_examples=20, deadline=None, derandomize=True, database=None)
@given(
    number=st.integers(0, 7),
    step=st.integers(3, 12),
    holes=st.floats(0, 1),
    strewn=st.lists(st.sampled_from([0.0, np.nan, np.inf, 1e-30, 1e30])),
    wrist_error=st.floats(0, 0.3),
    seed=st.integers(0, 2**32 - 1),
)
def test_broken_images(
    any_estimator: PoseEstimator,
    scenes: list[Scene],
    number: int,
    step: int,
    holes: float,
    strewn: list[float],
    wrist_error: float,
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    scene = scenes[number]
    depth = scene.depth[::step, ::step].copy()
    for value in strewn:
        depth[rng.random(depth.shape) < holes] = value
    T = scene.T_camera_hand @ exp(rng.normal(size=6) * wrist_error * [1, 1, 1, 0.2, 0.2, 0.2])
    check_any_answer(any_estimator, depth, scene.camera.subsampled(step), T)


# The command line


@pytest.fixture(scope="module")
def good_files(inputs: Inputs, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The five input files of `inhand estimate`, by option."""
    folder = tmp_path_factory.mktemp("files")
    Image.fromarray((inputs["depth"] * 1000).astype(np.uint16)).save(folder / "depth.png")
    (folder / "camera.json").write_text(
        json.dumps({name: getattr(CAMERA, name) for name in GOOD_CAMERA})
    )
    (folder / "pose.json").write_text(
        json.dumps({"T_camera_hand": inputs["T_camera_hand"].tolist()})
    )
    mesh = OBJECTS["cylinder"]()
    trimesh.Trimesh(mesh.vertices, mesh.faces).export(folder / "object.ply")
    return {
        "--depth": folder / "depth.png",
        "--camera": folder / "camera.json",
        "--hand": write_hand(folder / "hand"),
        "--object": folder / "object.ply",
        "--hand-pose": folder / "pose.json",
    }


def estimate(files: Mapping[str, Any]) -> int:
    words = [str(word) for pair in files.items() for word in pair]
    return main(["estimate", "--device", "cpu", *words])


def npy(folder: Path, depth: Any) -> Path:
    np.save(folder / "depth.npy", depth)
    return folder / "depth.npy"


def text(folder: Path, name: str, content: str) -> Path:
    (folder / name).write_text(content)
    return folder / name


def pose(folder: Path, T: Any) -> Path:
    return text(folder, "pose.json", json.dumps({"T_camera_hand": np.asarray(T).tolist()}))


def mesh(folder: Path, trimesh_mesh: trimesh.Trimesh) -> Path:
    trimesh_mesh.export(folder / "mesh.obj")
    return folder / "mesh.obj"


PALM, TIP = tiny_urdf.link("palm"), tiny_urdf.link("tip")
NO_MESH = tiny_urdf.link("palm", '<mesh filename="missing.stl"/>')


@pytest.mark.parametrize(
    ("option", "make", "message"),
    [
        ("--depth", lambda f: npy(f, np.full((240, 320), 450.0)), "seems to be in millimetres"),
        ("--depth", lambda f: npy(f, np.full((240, 320), -0.5)), "negative numbers"),
        ("--depth", lambda f: npy(f, np.full((480, 640), 0.5)), "but the camera 320 x 240"),
        ("--camera", lambda f: text(f, "c.json", json.dumps({**GOOD_CAMERA, "fx": 0})), "positive"),
        ("--camera", lambda f: text(f, "c.json", "{"), "is not JSON"),
        ("--hand-pose", lambda f: pose(f, np.diag([1, 1, -1, 1])), "left-handed"),
        ("--hand-pose", lambda f: pose(f, np.diag([2, 2, 2, 1])), "not a rotation"),
        ("--hand-pose", lambda f: pose(f, np.full((4, 4), math.nan)), "NaN"),
        ("--hand-pose", lambda f: pose(f, with_translation(np.eye(4), [0, 0, 450])), "millimetres"),
        ("--hand", lambda f: tiny_urdf.write(f, PALM), "no movable joint"),
        (
            "--hand",
            lambda f: tiny_urdf.write(f, NO_MESH, TIP, tiny_urdf.joint("bend", "palm", "tip")),
            "mesh file missing.stl not found",
        ),
        ("--object", lambda f: mesh(f, changed_box(lambda v: 1000 * v)), 'Try unit="mm"'),
        ("--object", lambda f: mesh(f, changed_box(with_nan)), "NaN"),
        ("--object", lambda f: text(f, "a.stl", ""), "a.stl"),
        ("--unit", lambda f: "metres", "known: m, cm, mm, inch"),
        ("--device", lambda f: "toaster", "available: cpu"),
        ("--seed", lambda f: "-1", "at least 0"),
        ("--rgb", lambda f: f / "missing.png", "there is no colour image"),
        ("--out", lambda f: f, "cannot write"),
        ("--picture", lambda f: f / "picture.xyz", "cannot write .*unknown file extension"),
    ],
)
def test_bad_files(
    good_files: dict[str, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    option: str,
    make: Callable[[Path], Any],
    message: str,
) -> None:
    assert estimate({**good_files, option: make(tmp_path)}) == 2
    *waited_for, complaint = capsys.readouterr().err.splitlines()
    assert re.fullmatch(f"inhand: .*{message}.*", complaint)
    on_slow_machines = ("Building the models", "Loading kernels")
    assert all(line.startswith(on_slow_machines) for line in waited_for)


def test_files_without_an_answer(
    good_files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert estimate(good_files) == 0
    for option, file in (
        ("--depth", npy(tmp_path, np.zeros((240, 320), dtype=np.uint16))),
        ("--hand-pose", pose(tmp_path, with_translation(np.eye(4), [5, 0, 0.5]))),
    ):
        assert estimate({**good_files, option: file}) == 1
        assert "Not found: " in capsys.readouterr().out
