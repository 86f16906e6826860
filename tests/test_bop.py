"""BOP data sets: what is written is read back, others' data sets load, broken files are named."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from inhand.camera import Camera
from inhand.datasets import bop, bop_frames, bop_scene
from inhand.datasets.bop import BopImage, HandInfo, HandTruth, Instance
from inhand.datasets.bop_images import read_image
from inhand.datasets.bop_models import load_model, write_models
from inhand.datasets.bop_results import BopResult, read_results, write_results
from inhand.datasets.bop_writer import finish_scene, write_dataset_files, write_image
from inhand.datasets.exact import metres, millimetres
from inhand.datasets.frames import (
    find_frames,
    find_hand,
    find_objects,
    frame_name,
    load_object,
    read_frame,
)
from inhand.errors import InputError
from inhand.evaluation.bop_export import write_bop_results
from inhand.evaluation.results import FrameResult
from inhand.geometry.mesh import box, cylinder
from inhand.geometry.se3 import exp
from inhand.object_model import ObjectModel

CAMERA = Camera(fx=80.1, fy=80.3, cx=31.7, cy=23.9, width=64, height=48, depth_unit=bop.DEPTH_UNIT)
HAND, BACKGROUND, OBJECT = 1, 254, 255
POSES = st.lists(st.floats(-10, 10, allow_subnormal=True), min_size=3, max_size=3)


def bop_image(seed: int, objects: int = 1, *, hand: bool = True) -> BopImage:
    """An image of nonsense that fits together."""
    rng = np.random.default_rng(seed)
    shape = (CAMERA.height, CAMERA.width)
    depth = np.rint(rng.uniform(0, 12000, shape)) * bop.DEPTH_UNIT
    segmentation = rng.choice([0, HAND, BACKGROUND, OBJECT], shape).astype(np.uint8)
    depth[segmentation == 0] = 0
    instances = []
    for _ in range(objects):
        visible = (segmentation == OBJECT) & (rng.random(shape) < 0.5)
        mask = visible | (rng.random(shape) < 0.2)
        instances.append(
            Instance(
                object_id=int(rng.integers(1, 4)),
                T_camera_object=exp(rng.normal(size=6)),
                mask=mask,
                mask_visible=visible,
                silhouette_pixels=int(mask.sum()) + 7,
                depth=(np.rint(mask * rng.uniform(3000, 9000, shape)) * 1e-4).astype(np.float32),
            )
        )
    truth = HandTruth(
        T_camera_hand=exp(rng.normal(size=6)),
        T_camera_hand_given=exp(rng.normal(size=6)),
        joint_positions={"bend": float(rng.normal()), "turn": float(rng.normal())},
        T_camera_link={name: exp(rng.normal(size=6)) for name in ("palm", "finger")},
    )
    return BopImage(
        camera=replace(CAMERA, cx=float(rng.uniform(20, 40))),
        depth=depth.astype(np.float32),
        instances=tuple(instances),
        rgb=rng.integers(256, size=(*shape, 3), dtype=np.uint8),
        hand=truth if hand else None,
        segmentation=segmentation if hand else None,
    )


def write_scene(scene: Path, images: dict[int, BopImage], *, hand: bool = True) -> None:
    info = HandInfo(
        scene.parents[1] / "hand" / "hand.urdf",
        {HAND: "palm", BACKGROUND: "background", OBJECT: "object"},
        {"robot": scene.parents[2] / "robot"},
    )
    for image_id, image in images.items():
        write_image(scene, image_id, image)
    finish_scene(scene, info if hand else None)


@pytest.fixture(scope="module")
def objects() -> dict[int, ObjectModel]:
    """A brick with a notch that breaks its symmetry, a cuboid, a cylinder."""
    odd = trimesh.creation.box((0.03, 0.05, 0.08)).slice_plane((0.01, 0.01, 0.02), (-1, -2, -3))
    models = {
        "odd": ObjectModel.from_mesh(odd),
        "cuboid": ObjectModel.from_mesh(box((0.03, 0.03, 0.06))),
        "rod": ObjectModel.from_mesh(cylinder(0.02, 0.08)),
    }
    return {i: replace(m, name=n) for i, (n, m) in enumerate(models.items(), start=1)}


@pytest.fixture
def dataset(tmp_path: Path, objects: dict[int, ObjectModel]) -> Path:
    """Two scenes with two images each, the second with two objects in every image."""
    folder = tmp_path / "nonsense"
    scenes = [folder / "test" / f"{s:06d}" for s in (1, 2)]
    for number, scene in enumerate(scenes):
        write_scene(scene, {i: bop_image(10 * number + i, 1 + number) for i in (3, 11)})
    write_models(folder / "models", objects)
    write_dataset_files(folder, CAMERA, scenes)
    return folder


def assert_same(one: Any, other: Any) -> None:
    """Equal to the last bit, arrays and dataclasses too."""
    if isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    elif isinstance(one, tuple | dict):
        assert len(one) == len(other)
        for key in one if isinstance(one, dict) else range(len(one)):
            assert_same(one[key], other[key])
    elif isinstance(one, BopImage | Instance | HandTruth):
        assert_same(vars(one), vars(other))
    else:
        assert one == other


@given(POSES)
def test_lengths_are_exact(lengths: list[float]) -> None:
    assert_same(metres(millimetres(lengths)), np.array(lengths))
    text = json.dumps([float(x) for x in millimetres(lengths)])
    np.testing.assert_allclose(json.loads(text), np.array(lengths) * 1000, rtol=1e-15, atol=1e-300)


@pytest.mark.parametrize(("count", "hand"), [(1, True), (3, True), (2, False), (0, False)])
def test_images_come_back_as_they_were(tmp_path: Path, count: int, hand: bool) -> None:
    written = {i: bop_image(i, count, hand=hand) for i in (0, 7)}
    scene = tmp_path / "set" / "test" / "000001"
    write_scene(scene, written, hand=hand)
    for image_id, image in written.items():
        again = read_image(scene, image_id)
        assert_same(again, image)
        write_image(scene.parent / "000002", image_id, again)
    finish_scene(scene.parent / "000002", bop_scene.read_scene(scene).hand_info)
    for file in scene.rglob("*.*"):
        copy = scene.parent / "000002" / file.relative_to(scene)
        assert copy.read_bytes() == file.read_bytes(), file


def test_depth_is_rounded_to_its_step(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    image = bop_image(0)
    rough = replace(image, depth=rng.uniform(0, 6, image.depth.shape).astype(np.float32))
    scene = tmp_path / "set" / "test" / "000001"
    write_scene(scene, {0: rough})
    again = read_image(scene, 0)
    assert np.abs(again.depth - rough.depth).max() <= bop.DEPTH_UNIT / 2 + 1e-6
    with pytest.raises(InputError, match="does not fit 16 bits"):
        write_image(scene, 1, replace(image, depth=rough.depth + 6))


def test_files_are_bops(dataset: Path) -> None:
    """As BOP's own tools read them: by key, in millimetres, rows of matrices one after another."""
    scene, image = dataset / "test" / "000001", bop_image(3)
    (truth,) = json.loads((scene / "scene_gt.json").read_text())["3"]
    T = image.instances[0].T_camera_object
    np.testing.assert_array_equal(np.reshape(truth["cam_R_m2c"], (3, 3)), T[:3, :3])
    np.testing.assert_allclose(truth["cam_t_m2c"], T[:3, 3] * 1000, rtol=1e-15)
    camera = json.loads((scene / "scene_camera.json").read_text())["3"]
    np.testing.assert_array_equal(np.reshape(camera["cam_K"], (3, 3)), image.camera.matrix)
    pixels = np.asarray(Image.open(scene / "depth" / "000003.png"))
    assert pixels.dtype == np.uint16
    np.testing.assert_allclose(pixels * camera["depth_scale"] / 1000, image.depth, atol=1e-6)
    mask = np.asarray(Image.open(scene / "mask" / "000003_000000.png"))
    np.testing.assert_array_equal(mask, image.instances[0].mask * 255)
    targets = json.loads((dataset / bop.TARGETS).read_text())
    assert sum(t["inst_count"] for t in targets) == 6
    assert set(targets[0]) == {"im_id", "inst_count", "obj_id", "scene_id"}
    assert json.loads((dataset / "camera.json").read_text())["width"] == 64


def test_frames_of_both_layouts_are_one_type(dataset: Path) -> None:
    frames = find_frames([dataset])
    assert len(frames) == 6
    assert frames == find_frames([dataset / "test"])
    assert frames[:2] == find_frames([dataset / "test" / "000001"])
    assert find_frames([frames[3]]) == [frames[3]]
    assert frame_name(frames[0]) == "nonsense/000001/000003_000000"
    image = bop_image(10 + 11, 2)
    frame = read_frame(dataset / "test" / "000002" / "mask_visib" / "000011_000001.png")
    obj, hand = image.instances[1], image.hand
    assert hand is not None
    assert frame.object_name == ("odd", "cuboid", "rod")[obj.object_id - 1]
    assert_same(frame.T_camera_hand_given, hand.T_camera_hand_given)
    assert_same(frame.truth.T_camera_hand, hand.T_camera_hand)
    assert_same(frame.truth.T_camera_object, obj.T_camera_object)
    assert_same(frame.rgb, image.rgb)
    assert frame.truth.joint_positions == hand.joint_positions
    assert frame.truth.visible_share == obj.mask_visible.sum() / obj.silhouette_pixels
    np.testing.assert_array_equal(frame.truth.label == 2, obj.mask_visible)
    assert image.segmentation is not None
    np.testing.assert_array_equal(frame.truth.label == 1, image.segmentation == HAND)
    np.testing.assert_array_equal(frame.truth.label == 0, image.segmentation == 0)
    assert find_hand(dataset, "") == dataset / "hand" / "hand.urdf"
    info = bop_scene.read_scene(dataset / "test" / "000001").hand_info
    assert info is not None
    assert info.package_paths == {"robot": dataset.parent / "robot"}


def test_targets_choose_the_frames(dataset: Path) -> None:
    instances = [(f.parents[1].name, *bop_frames.frame_ids(f)) for f in find_frames([dataset])]
    assert instances[0] == ("000001", 3, 0)
    targets = json.loads((dataset / bop.TARGETS).read_text())
    (dataset / bop.TARGETS).write_text(json.dumps(targets[:1]))
    (only,) = find_frames([dataset])
    assert bop_frames.frame_target(only) == tuple(
        targets[0][k] for k in ("scene_id", "im_id", "obj_id")
    )
    elsewhere = {**targets[0], "scene_id": 77}
    (dataset / bop.TARGETS).write_text(json.dumps([targets[0], elsewhere]))
    assert find_frames([dataset]) == [only], "a scene that is not here is none to be found"
    (dataset / bop.TARGETS).write_text(json.dumps([targets[0], {**targets[0], "obj_id": 77}]))
    with pytest.raises(InputError, match=r"test_targets_bop19\.json names object 77 in image"):
        find_frames([dataset])


def test_a_data_set_of_others_without_a_hand(tmp_path: Path) -> None:
    """Whole numbers, no counts, millimetre depth as TIFF, grey images, models without names."""
    scene = tmp_path / "lm" / "test" / "000002"
    for name in ("depth", "gray", "mask", "mask_visib"):
        (scene / name).mkdir(parents=True)
    depth = np.zeros((48, 64), np.uint16)
    depth[10:30, 10:30] = 500
    visible = np.zeros((48, 64), np.uint8)
    visible[10:30, 10:20] = 255
    Image.fromarray(depth).save(scene / "depth" / "000000.tif")
    Image.fromarray(visible).save(scene / "gray" / "000000.jpg")
    Image.fromarray((depth > 0).astype(np.uint8) * 255).save(scene / "mask" / "000000_000000.png")
    Image.fromarray(visible).save(scene / "mask_visib" / "000000_000000.png")
    camera = {"cam_K": [60, 0, 32, 0, 60, 24, 0, 0, 1], "depth_scale": 1}
    (scene / "scene_camera.json").write_text(json.dumps({"0": camera}))
    rotation = [0.0, -0.99999999, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    truth = {"cam_R_m2c": rotation, "cam_t_m2c": [1, -2, 500], "obj_id": 5}
    (scene / "scene_gt.json").write_text(json.dumps({"0": [truth]}))

    (path,) = find_frames([tmp_path / "lm"])
    frame = read_frame(path)
    assert frame.object_name == "obj_000005"
    assert frame.depth.max() == np.float32(0.5)
    np.testing.assert_array_equal(frame.truth.T_camera_object[:3, 3], [0.001, -0.002, 0.5])
    assert frame.truth.visible_share == 0.5
    assert frame.rgb is not None
    assert (frame.wrist, frame.truth.wrist, frame.truth.joint_positions) == (None, None, {})
    assert [(frame.truth.label == k).sum() for k in range(4)] == [2672, 0, 200, 200]
    assert find_hand(tmp_path / "lm", "nothing") is None
    for ask in (lambda: frame.T_camera_hand_given, lambda: frame.truth.T_camera_hand):
        with pytest.raises(InputError, match="nothing about a hand"):
            ask()


def test_models_come_back_with_their_symmetries(
    tmp_path: Path, objects: dict[int, ObjectModel]
) -> None:
    write_models(tmp_path / "set" / "models", objects)
    (tmp_path / "set" / "test" / "000001").mkdir(parents=True)
    for number, obj in objects.items():
        again = load_object(tmp_path / "set" / "models", obj.name)
        assert again.name == obj.name
        assert again.diameter == pytest.approx(obj.diameter, rel=1e-14)
        np.testing.assert_allclose(again.mesh.bounds, obj.mesh.bounds, rtol=1e-14, atol=1e-17)
        rotations = again.symmetry.rotations, obj.symmetry.rotations
        np.testing.assert_allclose(*rotations, rtol=1e-14, atol=1e-16)
        np.testing.assert_allclose(again.symmetry.centre, obj.symmetry.centre, atol=2e-5)
        assert (again.symmetry.axis is None) == (obj.symmetry.axis is None)
        if obj.symmetry.axis is not None and again.symmetry.axis is not None:
            np.testing.assert_allclose(again.symmetry.axis, obj.symmetry.axis, atol=1e-15)
        independent = trimesh.load_mesh(tmp_path / "set" / "models" / f"obj_{number:06d}.ply")
        np.testing.assert_allclose(independent.bounds, obj.mesh.bounds * 1000, rtol=1e-12)
        assert len(independent.faces) == len(obj.mesh.faces)
    info = json.loads((tmp_path / "set" / "models" / "models_info.json").read_text())
    assert info["1"].keys() & {"symmetries_discrete", "symmetries_continuous"} == set()
    assert len(info["2"]["symmetries_discrete"]) == 7
    assert np.shape(info["3"]["symmetries_continuous"][0]["axis"]) == (3,)
    assert info["3"]["diameter"] == pytest.approx(objects[3].diameter * 1000)
    with pytest.raises(InputError, match=r'no object "sock".*holds: odd, cuboid, rod'):
        load_model(tmp_path / "set" / "models", "sock")


def test_models_folder_is_found(dataset: Path) -> None:
    assert find_objects(dataset, "") == dataset / "models"
    shutil.move(dataset / "models", dataset / "models_eval")
    assert find_objects(dataset / "test", "") == dataset / "models_eval"


def test_results_come_back_as_they_were(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    results = [
        BopResult(1, i, 2, float(rng.normal()), exp(rng.normal(size=6)), float(rng.random()))
        for i in range(20)
    ]
    path = tmp_path / "new" / "inhand_set-test.csv"
    write_results(path, results)
    lines = path.read_text().splitlines()
    assert lines[0] == "scene_id,im_id,obj_id,score,R,t,time"
    fields = lines[3].split(",")
    assert [len(field.split()) for field in fields] == [1, 1, 1, 1, 9, 3, 1]
    np.testing.assert_allclose(
        [float(x) for x in fields[5].split()], results[2].T_camera_object[:3, 3] * 1000
    )
    again = read_results(path)
    assert len(again) == len(results)
    for one, other in zip(again, results, strict=True):
        assert_same(vars(one), vars(other))
    (tmp_path / "headless.csv").write_text("1,2,3,0.5,1 0 0 0 1 0 0 0 1,0 0 500,-1\n")
    (result,) = read_results(tmp_path / "headless.csv")
    assert result.T_camera_object[2, 3] == 0.5


@pytest.mark.parametrize(
    "line",
    [
        "1,2,3,0.5",
        "1,2,3,high,1 0 0 0 1 0 0 0 1,0 0 500,-1",
        "1,2,3,0.5,1 0 0 0 1 0 0 0,0 0 500,-1",
        "1,2,3,0.5,2 0 0 0 1 0 0 0 1,0 0 500,-1",
        "1,2,3,0.5,1 0 0 0 1 0 0 0 1,0 0,-1",
        "1,2,3,0.5,1 0 0 0 1 0 0 0 1,0 0 far,-1",
        "1,2,3,0.5,1 0 0 0 1 0 0 0 1,0 0 nan,-1",
    ],
)
def test_a_line_that_is_no_result_is_named(tmp_path: Path, line: str) -> None:
    (tmp_path / "bad.csv").write_text(line + "\n")
    with pytest.raises(InputError, match=r"result 0 in .*bad\.csv"):
        read_results(tmp_path / "bad.csv")
    with pytest.raises(InputError, match=r"gone\.csv"):
        read_results(tmp_path / "gone.csv")


def test_a_benchmarks_answers_become_a_csv_file(dataset: Path, tmp_path: Path) -> None:
    path = find_frames([dataset])[-1]
    T = exp(np.array([0.1, 0.2, 0.3, 0.01, 0.02, 0.5]))
    answer = FrameResult(
        "f", str(path), "answer", T_camera_object=T.tolist(), confidence=0.75, seconds=0.25
    )
    no_answer = FrameResult("g", str(path), "no answer")
    other = replace(answer, file=str(tmp_path / "a.npz"))
    (written,) = write_bop_results(tmp_path, "in-hand", [answer, no_answer, other])
    assert written.name == "inhand_nonsense-test.csv"
    (result,) = read_results(written)
    assert (result.scene_id, result.image_id, result.score, result.seconds) == (2, 11, 0.75, 0.25)
    assert_same(result.T_camera_object, T)
    assert not write_bop_results(tmp_path, "inhand", [other])


def edited(name: str, change: Callable[[Any], Any]) -> Callable[[Path], None]:
    """Changes what a JSON file of a scene holds."""

    def edit(scene: Path) -> None:
        content = json.loads((scene / name).read_text())
        change(content)
        (scene / name).write_text(json.dumps(content))

    return edit


def cut(name: str) -> Callable[[Path], None]:
    """Ends a file in the middle."""

    def damage(scene: Path) -> None:
        data = (scene / name).read_bytes()
        (scene / name).write_bytes(data[: len(data) // 2])

    return damage


def lost(name: str) -> Callable[[Path], None]:
    return lambda scene: (scene / name).unlink()


def small(name: str) -> Callable[[Path], None]:
    return lambda scene: Image.new("L", (8, 8)).save(scene / name)


BROKEN = {
    "depth/000003.png": [lost, cut],
    "rgb/000003.png": [cut, small],
    "mask/000003_000000.png": [lost, cut, small],
    "mask_visib/000003_000000.png": [lost, cut, small],
    "segmentation/000003.png": [cut, small],
    "scene_camera.json": [lost, cut],
    "scene_gt.json": [cut],
    "scene_gt_info.json": [cut],
    "scene_hand.json": [cut],
}
WRONG = [
    ("scene_camera.json", lambda c: c.pop("3")),
    ("scene_camera.json", lambda c: c["3"].pop("cam_K")),
    ("scene_camera.json", lambda c: c["3"].update(cam_K=[1, 2, 3])),
    ("scene_camera.json", lambda c: c["3"].update(depth_scale="fine")),
    ("scene_gt.json", lambda c: c["3"][0].pop("cam_R_m2c")),
    ("scene_gt.json", lambda c: c["3"][0].pop("obj_id")),
    ("scene_gt.json", lambda c: c["3"][0].update(cam_R_m2c=[1, 0, 0, 0, 1, 0, 0, 0, 2])),
    ("scene_gt.json", lambda c: c["3"][0].update(cam_t_m2c=[0, float("nan"), 0])),
    ("scene_gt.json", lambda c: c["3"][0].update(cam_t_m2c=[0, 0])),
    ("scene_gt.json", lambda c: c.update({"3": {}})),
    ("scene_gt.json", lambda c: c.update(three=c.pop("3"))),
    ("scene_gt_info.json", lambda c: c.pop("3")),
    ("scene_gt_info.json", lambda c: c["3"].append({})),
    ("scene_hand.json", lambda c: c.pop("urdf")),
    ("scene_hand.json", lambda c: c.pop("images")),
    ("scene_hand.json", lambda c: c["images"].pop("3")),
    ("scene_hand.json", lambda c: c["images"]["3"].pop("T_camera_hand")),
    ("scene_hand.json", lambda c: c["images"]["3"].update(T_camera_hand_given=[[1]])),
    ("scene_hand.json", lambda c: c["images"]["3"].update(joint_positions=[0.1])),
]


@pytest.mark.parametrize(
    ("name", "damage"),
    [(name, damage(name)) for name, damages in BROKEN.items() for damage in damages]
    + [(name, edited(name, change)) for name, change in WRONG],
)
def test_broken_files_are_named(dataset: Path, name: str, damage: Callable[[Path], None]) -> None:
    scene = dataset / "test" / "000001"
    damage(scene)
    with pytest.raises(InputError) as caught:
        read_frame(scene / "mask_visib" / "000003_000000.png")
    assert name.split("/")[-1] in str(caught.value)


def test_frames_that_are_not_there_are_named(dataset: Path) -> None:
    masks = dataset / "test" / "000001" / "mask_visib"
    for name, words in (
        ("000004_000000.png", "no image 4"),
        ("000003_000005.png", "no object number 5"),
        ("first.png", "IMAGE_INSTANCE"),
    ):
        with pytest.raises(InputError, match=words):
            read_frame(masks / name)
    with pytest.raises(InputError, match="no ground truth"):
        read_frame(dataset / "test" / "000009" / "mask_visib" / "000003_000000.png")
    (dataset / "test" / "000001" / "scene_gt.json").write_text("{}")
    (dataset / bop.TARGETS).write_text("[]")
    with pytest.raises(InputError, match="holds no frames"):
        find_frames([dataset])
    (dataset / bop.TARGETS).write_text('["first"]')
    with pytest.raises(InputError, match=bop.TARGETS):
        find_frames([dataset])


def test_a_scene_needs_images(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no images"):
        finish_scene(tmp_path / "set" / "test" / "000001")
    scene = tmp_path / "set" / "test" / "000002"
    write_image(scene, 0, bop_image(0, hand=False))
    with pytest.raises(InputError, match="unfinished"):
        read_image(scene, 0)
    with pytest.raises(InputError, match="without a hand"):
        finish_scene(scene, HandInfo(tmp_path / "hand.urdf", {}))
    finish_scene(scene)
    assert len(read_image(scene, 0).instances) == 1


def test_broken_models_are_named(dataset: Path) -> None:
    models = dataset / "models"
    (models / "obj_000001.ply").write_bytes((models / "obj_000001.ply").read_bytes()[:200])
    with pytest.raises(InputError, match=r"obj_000001\.ply"):
        load_object(models, "odd")
    info = json.loads((models / "models_info.json").read_text())
    info["2"]["symmetries_discrete"] = [[1, 2, 3]]
    (models / "models_info.json").write_text(json.dumps(info))
    with pytest.raises(InputError, match=r"models_info\.json"):
        load_object(models, "cuboid")
    (models / "models_info.json").write_text("{")
    with pytest.raises(InputError, match=r"models_info\.json"):
        load_object(models, "cuboid")
