"""BOP data sets with broken, missing and wrong files: each is named."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from bop_nonsense import bop_image, write_dataset
from PIL import Image

from inhand.datasets import bop
from inhand.datasets.bop import HandInfo
from inhand.datasets.bop_images import read_image
from inhand.datasets.bop_writer import finish_scene, write_image
from inhand.datasets.frames import find_frames, read_frame
from inhand.errors import InputError


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "nonsense")


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
