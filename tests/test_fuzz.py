"""Anything goes in; an answer, a reason or an `InputError` comes out, and it comes soon.

`test_bad_input.py` has images of common sizes and cameras, and every argument wrong in turn. Here
are the extremes: images of a few pixels and of a million, any focal length, any parameters, any
grasp, and files with damaged bytes.
"""

import json
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from any_answer import check_any_answer
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from inhand import Camera, EstimatorConfig, Hand, InputError, PoseEstimator
from inhand.builtin.hand import write_hand
from inhand.builtin.objects import OBJECTS
from inhand.datasets.frames import read_frame
from inhand.evaluation.results import read_results
from inhand.geometry.mesh import load_mesh
from inhand.geometry.se3 import exp, random_rotation
from inhand.io import read_depth, read_transform
from inhand.kernels.depth import DepthRenderer
from inhand.synth.demo import builtin_hand, builtin_object
from inhand.synth.scene import Scene

seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module", params=["default", "paper"])
def estimator(request: pytest.FixtureRequest) -> PoseEstimator:
    config = EstimatorConfig.paper() if request.param == "paper" else EstimatorConfig()
    return PoseEstimator(builtin_hand(), builtin_object("can"), config, "cpu")


def hand_in_view(
    estimator: PoseEstimator, camera: Camera, z: float, rng: np.random.Generator
) -> np.ndarray:
    """A wrist pose for which the middle of the hand's reach is seen in a random pixel."""
    u, v = rng.uniform(0, (camera.width, camera.height))
    middle = np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1]) * z
    T = np.eye(4)
    T[:3, :3] = random_rotation(rng)
    T[:3, 3] = middle - T[:3, :3] @ estimator.hand.hand.reach[0]
    return T


sides = st.one_of(st.integers(1, 12), st.integers(9, 120), st.integers(9, 120))


@settings(max_examples=60, database=None)
@given(sides, sides, st.floats(-1, 4), st.floats(-1, 1), st.floats(-2, 0.7), seeds)
def test_few_pixels_and_any_lens(
    estimator: PoseEstimator,
    width: int,
    height: int,
    log_zoom: float,
    log_aspect: float,
    log_distance: float,
    seed: int,
) -> None:
    """The hand is a tenth of the image wide to thousands of times as wide."""
    rng = np.random.default_rng(seed)
    z = 10**log_distance
    f = 10**log_zoom * max(width, height) * z / (2 * estimator.hand.hand.reach[1])
    cx, cy = rng.normal(0.5, 1.0, size=2) * (width, height)
    camera = Camera(f, f * 10**log_aspect, cx, cy, width, height)
    depth = rng.choice([z, z + 0.01, z - 0.005], size=(height, width))
    depth += rng.choice([0.0, 0.002]) * rng.normal(size=depth.shape)
    depth[rng.random(depth.shape) < rng.choice([0.0, 0.3])] = rng.choice([0.0, np.nan, 1e-3, 1e30])
    check_any_answer(estimator, np.abs(depth), camera, hand_in_view(estimator, camera, z, rng))


@settings(max_examples=4, database=None)
@given(st.sampled_from(["wall", "noise", "slope"]), st.floats(0.15, 0.6), seeds)
def test_a_million_pixels(
    estimator: PoseEstimator, surface: str, distance: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    camera = Camera(900, 900, 639.5, 359.5, 1280, 720)
    depth = np.full((720, 1280), distance)
    if surface == "noise":
        depth += rng.normal(scale=0.02, size=depth.shape)
    if surface == "slope":
        depth += np.linspace(-0.1, 0.1, 1280)
    T = hand_in_view(estimator, camera, distance, rng)
    check_any_answer(estimator, np.abs(depth).astype(np.float32), camera, T)


@settings(max_examples=25, database=None)
@given(
    seeds,
    st.lists(st.floats(0, 1), min_size=4, max_size=4),
    st.floats(0, 0.15),
    st.sampled_from([0.0, 0.01, 0.1]),
)
def test_any_grasp(
    estimator: PoseEstimator,
    seed: int,
    bent: list[float],
    away: float,
    wrist_error: float,
) -> None:
    """Fingers anywhere, and the object anywhere, also in them or out of their reach."""
    rng = np.random.default_rng(seed)
    hand, obj = estimator.hand.hand, estimator.object.model
    camera = Camera(150, 150, 79.5, 59.5, 160, 120)
    T = hand_in_view(estimator, camera, rng.uniform(0.3, 0.7), rng)
    q = hand.lower + np.array(bent) * (hand.upper - hand.lower)
    T_hand_object = exp(np.array([*rng.normal(size=3), *hand.reach[0]]))
    T_hand_object[:3, 3] += away * rng.normal(size=3)
    meshes = [*(link.mesh for link in hand.links), obj.mesh]
    poses = [*(T @ hand.forward_kinematics(q)), T @ T_hand_object]
    depth = DepthRenderer(meshes).render(camera, np.stack(poses))[0]
    given_wrist = T @ exp(wrist_error * rng.normal(size=6))
    check_any_answer(estimator, depth, camera, given_wrist)


@settings(max_examples=15, database=None)
@given(st.sampled_from(["default", "paper"]), st.integers(0, 7), st.integers(3, 8), seeds)
def test_any_parameters(
    scenes: list[Scene], preset: str, number: int, step: int, seed: int
) -> None:
    """Counts down to 1, and lengths and weights a thousand times smaller or larger."""
    rng = np.random.default_rng(seed)
    start = EstimatorConfig.paper() if preset == "paper" else EstimatorConfig()
    scene = scenes[number]
    estimator = PoseEstimator(scene.hand, scene.obj, any_config(start, rng), "cpu")
    depth = scene.depth[::step, ::step]
    check_any_answer(estimator, depth, scene.camera.subsampled(step), scene.T_camera_hand_given)


def any_config(section: Any, rng: np.random.Generator) -> Any:
    """The section with about half of its fields changed to something that it accepts."""
    for name in (field.name for field in fields(section)):
        value = getattr(section, name)
        if is_dataclass(value):
            section = replace(section, **{name: any_config(value, rng)})
        elif rng.random() < 0.5:
            continue
        elif isinstance(value, bool):
            section = replace(section, **{name: not value})
        elif isinstance(value, int):
            section = replace(section, **{name: int(rng.integers(1, 4))})
        elif isinstance(value, float):
            try:
                section = replace(section, **{name: value * 10 ** rng.uniform(-3, 3)})
            except InputError:
                continue  # out of the field's range
    return section


# Files


@pytest.fixture(scope="module")
def good_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one good file of every kind that a user brings."""
    folder = tmp_path_factory.mktemp("good")
    depth = (400 + np.arange(768).reshape(24, 32) % 9).astype(np.uint16)
    for suffix in ("png", "tif"):
        Image.fromarray(depth).save(folder / f"depth.{suffix}")
    np.save(folder / "depth.npy", depth / 1000)
    camera = {"fx": 30, "fy": 30, "cx": 16, "cy": 12, "width": 32, "height": 24}
    (folder / "camera.json").write_text(json.dumps(camera))
    T = np.eye(4)
    T[2, 3] = 0.4
    (folder / "pose.json").write_text(json.dumps({"T_camera_hand": T.tolist()}))
    mesh = OBJECTS["cuboid"]()
    for suffix in ("ply", "obj", "stl", "off", "glb"):
        trimesh.Trimesh(mesh.vertices, mesh.faces).export(folder / f"object.{suffix}")
    write_hand(folder).rename(folder / "hand.urdf")
    np.savez(
        folder / "frame.npz",
        obj="cuboid",
        depth=depth,
        K=Camera(**camera).matrix,
        T_camera_hand_given=T,
        T_camera_hand=T,
        T_camera_object=T,
        q=np.zeros(2),
        joints=np.array(["left", "right"]),
        label=np.ones(depth.shape, np.uint8),
        visib=np.array(0.5),
    )
    result = {"frame": "a/b", "file": "b.npz", "outcome": "answer", "adi": 0.001}
    (folder / "results.jsonl").write_text(f'{{"settings": {{}}}}\n{json.dumps(result)}\n')
    return folder


CAMERA = Camera(30, 30, 16, 12, 32, 24)
READERS: dict[str, Callable[[Path], object]] = {
    **{f"depth.{s}": lambda path: read_depth(path, CAMERA) for s in ("png", "tif", "npy")},
    **{f"object.{s}": load_mesh for s in ("ply", "obj", "stl", "off", "glb")},
    "camera.json": Camera.from_json,
    "pose.json": read_transform,
    "hand.urdf": Hand.from_urdf,
    "frame.npz": read_frame,
    "results.jsonl": read_results,
}
WORDS = (b"nan", b"-1", b"1e400", b"99999999999", b'"', b"[]", b"{", b"null", b"true", b"\xff")


@pytest.mark.parametrize("name", READERS)
def test_the_good_files_are_good(good_files: Path, name: str) -> None:
    READERS[name](good_files / name)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", READERS)
def test_damaged_files(good_files: Path, tmp_path: Path, name: str) -> None:
    """Cut short, overwritten, or with something put in or left out: read or refused."""
    good, damaged = (good_files / name).read_bytes(), tmp_path / name
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(60):
        data = bytearray(good)
        for _ in range(rng.integers(1, 6)):
            damage(data, rng)
        damaged.write_bytes(data)
        try:
            READERS[name](damaged)
        except InputError:
            refused += 1
    assert refused > 0


def damage(data: bytearray, rng: np.random.Generator) -> None:
    """Change the bytes a little, in one of five ways."""
    at = int(rng.integers(len(data) + 1))
    match rng.integers(5):
        case 0:
            del data[max(at, 1) :]
        case 1:
            data[at : at + 1] = rng.bytes(1)
        case 2:
            data[at:at] = rng.bytes(int(rng.integers(1, 9)))
        case 3:
            del data[at : at + rng.integers(1, 40)]
        case 4:  # a number of a text is another word
            digits = [i for i, byte in enumerate(data) if chr(byte).isdigit()] or [0]
            i = digits[rng.integers(len(digits))]
            data[i : i + 1] = WORDS[rng.integers(len(WORDS))]
