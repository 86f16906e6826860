"""Images to be labelled are found in every layout, and what is wrong with them is said."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from labelling_data import write_camera, write_folder, write_mesh
from PIL import Image

from inhand.annotation.images import find_images
from inhand.annotation.objects import find_objects
from inhand.camera import Camera
from inhand.datasets.bop_models import write_models
from inhand.errors import InputError
from inhand.geometry.mesh import box, cylinder
from inhand.object_model import ObjectModel
from inhand.synth.scene import Scene

CAMERA = Camera(fx=80, fy=80, cx=31.5, cy=23.5, width=64, height=48)


@pytest.fixture
def folder(tmp_path: Path, scenes: list[Scene]) -> Path:
    write_folder(tmp_path / "images", scenes[:3])
    return tmp_path / "images"


def test_a_folder_of_images(folder: Path, scenes: list[Scene]) -> None:
    files = find_images(folder)
    assert [(f.name, f.scene_id, f.image_id) for f in files] == [
        ("a", 1, 0),
        ("b", 1, 1),
        ("c", 1, 2),
    ]
    raw = files[1].read()
    np.testing.assert_allclose(raw.depth, scenes[1].depth, atol=5e-5)
    np.testing.assert_array_equal(raw.rgb, scenes[1].images.rgb)
    assert raw.T_camera_hand is not None
    np.testing.assert_allclose(raw.T_camera_hand, scenes[1].T_camera_hand_given, atol=1e-12)


def test_colour_and_wrist_may_be_missing_for_some_images(folder: Path) -> None:
    (folder / "rgb" / "a.png").unlink()
    poses = json.loads((folder / "hand_poses.json").read_text())
    del poses["b"]
    (folder / "hand_poses.json").write_text(json.dumps(poses))
    a, b, _ = (file.read() for file in find_images(folder))
    assert a.rgb is None
    assert a.T_camera_hand is not None
    assert b.rgb is not None
    assert b.T_camera_hand is None


def test_one_wrist_pose_may_hold_for_all_images(folder: Path) -> None:
    pose = json.loads((folder / "hand_poses.json").read_text())["c"]
    (folder / "hand_poses.json").unlink()
    (folder / "hand_pose.json").write_text(json.dumps(pose))
    for file in find_images(folder):
        T = file.read().T_camera_hand
        assert T is not None
        np.testing.assert_allclose(T, pose["T_camera_hand"], atol=1e-12)


@pytest.mark.parametrize("suffix", [".npy", ".tif", ".png"])
def test_a_single_image_in_the_folder_itself(suffix: str, tmp_path: Path) -> None:
    write_camera(tmp_path / "camera.json", CAMERA, 0.001)
    counts = np.full((48, 64), 500, dtype=np.uint16)
    if suffix == ".npy":
        np.save(tmp_path / "depth.npy", counts)
    else:
        Image.fromarray(counts).save(tmp_path / f"depth{suffix}")
    (file,) = find_images(tmp_path)
    assert file.name == "depth"
    assert file.read().depth == pytest.approx(0.5)


def write_bop(dataset: Path) -> Path:
    """An unlabelled scene of two images with wrist poses, and models of two objects."""
    scene = dataset / "test" / "000007"
    (scene / "depth").mkdir(parents=True)
    entry = {"cam_K": CAMERA.matrix.ravel().tolist(), "depth_scale": 1.0}
    (scene / "scene_camera.json").write_text(json.dumps({"3": entry, "12": entry}))
    for number in (3, 12):
        pixels = np.full((48, 64), 400 + number, dtype=np.uint16)
        Image.fromarray(pixels).save(scene / "depth" / f"{number:06d}.png")
    T = np.eye(4)
    T[2, 3] = 0.4
    hands = {"images": {"3": {"T_camera_hand_given": T.tolist()}}}
    (scene / "scene_hand.json").write_text(json.dumps(hands))
    brick = ObjectModel.from_mesh(box((0.03, 0.04, 0.06)))
    rod = ObjectModel.from_mesh(cylinder(0.02, 0.08))
    models = {4: replace(brick, name="brick"), 9: replace(rod, name="rod")}
    write_models(dataset / "models", models)
    return scene


@pytest.mark.parametrize("where", ["", "test", "test/000007"])
def test_a_bop_data_set_without_truth(where: str, tmp_path: Path) -> None:
    write_bop(tmp_path)
    files = find_images(tmp_path / where)
    assert [(f.name, f.scene_id, f.image_id) for f in files] == [
        ("000007/000003", 7, 3),
        ("000007/000012", 7, 12),
    ]
    first, second = (file.read() for file in files)
    assert first.depth == pytest.approx(0.403)
    assert first.T_camera_hand is not None
    assert first.T_camera_hand[2, 3] == 0.4
    assert second.T_camera_hand is None
    assert files[0].object_name is None


def test_truth_names_the_object_and_nothing_else(tmp_path: Path) -> None:
    scene = write_bop(tmp_path)
    pose = {"cam_R_m2c": np.eye(3).ravel().tolist(), "cam_t_m2c": [0, 0, 500]}
    truth = {"3": [{**pose, "obj_id": 9}], "12": [{**pose, "obj_id": i} for i in (4, 9)]}
    (scene / "scene_gt.json").write_text(json.dumps(truth))
    assert [f.object_name for f in find_images(tmp_path)] == ["rod", None]


def test_npz_frames(shared_data: Path) -> None:
    files = find_images(shared_data / "dev" / "clean")
    assert len(files) == 60
    raw = files[0].read()
    assert raw.depth.shape == (480, 640)
    assert raw.T_camera_hand is not None


def no_depth(folder: Path) -> None:
    shutil.rmtree(folder / "depth")


def doubled(folder: Path) -> None:
    shutil.copy(folder / "depth" / "a.png", folder / "depth" / "a.tif")


def no_camera(folder: Path) -> None:
    (folder / "camera.json").unlink()


def scene_without_number(folder: Path) -> None:
    (folder / "scene_camera.json").write_text("{}")


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (no_depth, r"holds no depth images: expected \.png"),
        (no_camera, "holds no depth images to label"),
        (doubled, 'are called "a"'),
        (scene_without_number, "must be called by its number"),
        (shutil.rmtree, "there is no folder"),
    ],
)
def test_what_is_wrong_with_a_folder(
    damage: Callable[[Path], None], message: str, folder: Path
) -> None:
    damage(folder)
    with pytest.raises(InputError, match=message):
        find_images(folder)


def test_a_broken_image_is_an_error_only_when_it_is_read(folder: Path) -> None:
    (folder / "depth" / "b.png").write_bytes(b"no picture")
    (folder / "rgb" / "c.png").write_bytes(b"no picture")
    files = find_images(folder)
    files[0].read()
    for file in files[1:]:
        with pytest.raises(InputError, match="cannot read the image"):
            file.read()


def test_objects_of_a_data_set_and_meshes(tmp_path: Path) -> None:
    scene = write_bop(tmp_path)
    found = find_objects(scene)
    assert {name: source.number for name, source in found.items()} == {"brick": 4, "rod": 9}
    mesh = tmp_path / "brick.ply"
    write_mesh(mesh, box((30, 40, 60)))
    found = find_objects(scene, [mesh], "mm")
    assert found["brick"].number == 1
    obj = found["brick"].load()
    assert obj.name == "brick"
    assert obj.diameter == pytest.approx(np.linalg.norm([0.03, 0.04, 0.06]))
    assert found["brick"].load() is obj


def test_objects_that_are_not_there(tmp_path: Path, folder: Path) -> None:
    with pytest.raises(InputError, match=r"no mesh .*mug\.ply"):
        find_objects(folder, [folder / "mug.ply"])
    with pytest.raises(InputError, match="--objects"):
        find_objects(folder)
    (tmp_path / "objects").mkdir()
    with pytest.raises(InputError, match="no meshes"):
        find_objects(folder)
    meshes = [tmp_path / name / "brick.ply" for name in ("a", "b")]
    for mesh in meshes:
        mesh.parent.mkdir()
        write_mesh(mesh, box((0.03, 0.04, 0.06)))
    with pytest.raises(InputError, match="same name"):
        find_objects(folder, meshes)
