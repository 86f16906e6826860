"""BOP data sets: what is written is read back, and others' data sets load."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bop_nonsense import HAND, assert_same, bop_image, write_dataset, write_scene
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from inhand.datasets import bop, bop_frames, bop_scene
from inhand.datasets.bop_images import read_image
from inhand.datasets.bop_writer import finish_scene, write_image
from inhand.datasets.exact import metres, millimetres
from inhand.datasets.frames import find_frames, find_hand, frame_name, read_frame
from inhand.errors import InputError

POSES = st.lists(st.floats(-10, 10, allow_subnormal=True), min_size=3, max_size=3)


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "nonsense")


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
