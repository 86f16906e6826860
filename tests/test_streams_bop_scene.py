"""A scene of a BOP data set as a source."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from inhand.camera import Camera
from inhand.datasets import bop
from inhand.datasets.bop import BopImage, HandInfo, HandTruth, Instance
from inhand.datasets.bop_models import write_models
from inhand.datasets.bop_writer import finish_scene, write_image
from inhand.datasets.frame import Frame as LabelledFrame
from inhand.errors import InputError
from inhand.geometry.mesh import TriangleMesh
from inhand.geometry.se3 import exp
from inhand.object_model import ObjectModel
from inhand.streams.config import StreamConfig
from inhand.streams.open_source import open_source
from inhand.streams.source import Frame
from inhand.synth.demo import builtin_object

CAMERA = Camera(fx=40.0, fy=40.0, cx=15.5, cy=11.5, width=32, height=24, depth_unit=bop.DEPTH_UNIT)


def image(number: int, *, hand: bool) -> BopImage:
    mask = np.ones((24, 32), dtype=bool)
    truth = HandTruth(
        T_camera_hand=np.eye(4),
        T_camera_hand_given=exp(np.array([0.1, 0, 0, 0, 0, 0.1 * number])),
        joint_positions={},
        T_camera_link={},
    )
    return BopImage(
        camera=CAMERA,
        depth=np.full((24, 32), 0.4 + 0.01 * number, dtype=np.float32),
        instances=(Instance(1, np.eye(4), mask, mask, silhouette_pixels=mask.size),),
        hand=truth if hand else None,
    )


CAN, CUBOID = builtin_object("can"), builtin_object("cuboid")


def write_scene(folder: Path, *, hand: bool = True) -> Path:
    scene = folder / "test" / "000001"
    for number in (2, 4, 9):
        write_image(scene, number, image(number, hand=hand))
    finish_scene(scene, HandInfo(folder / "hand.urdf", {}) if hand else None)
    return scene


def frames(scene: Path, config: StreamConfig) -> list[Frame]:
    return [arrival.decode() for arrival in open_source(str(scene), config).arrivals()]


def test_images_in_order_with_the_wrist_that_is_given(tmp_path: Path) -> None:
    found = frames(write_scene(tmp_path), StreamConfig(frame_rate=10))
    assert [f.name for f in found] == ["2", "4", "9"]
    assert [f.time_ns for f in found] == [0, 100_000_000, 200_000_000]
    for frame in found:
        assert frame.depth is not None
        assert frame.T_camera_hand is not None
        assert frame.camera == CAMERA
        np.testing.assert_allclose(frame.depth, 0.4 + 0.01 * int(frame.name), rtol=1e-6)
        assert frame.T_camera_hand[2, 3] == pytest.approx(0.1 * int(frame.name))


def test_times_of_a_sequence(tmp_path: Path) -> None:
    scene = write_scene(tmp_path)
    path = scene / "scene_camera.json"
    fields = json.loads(path.read_text())
    for number, entry in fields.items():
        entry["time"] = 0.5 * int(number)
    path.write_text(json.dumps(fields))
    assert [f.time_ns for f in frames(scene, StreamConfig())] == [10**9, 2 * 10**9, 4_500_000_000]


def truth_of(frame: Frame, obj: ObjectModel) -> LabelledFrame:
    assert frame.read_truth is not None
    return frame.read_truth(obj)


def test_ground_truth_is_that_of_the_object_whose_model_is_given(tmp_path: Path) -> None:
    """Wrist and camera are those that the estimator is given."""
    scene = tmp_path / "test" / "000001"
    first = image(2, hand=True)
    T = exp(np.array([0.1, 0.2, 0.3, 0.01, 0.02, 0.5]))
    other = replace(first.instances[0], object_id=7, T_camera_object=T)
    write_image(scene, 2, replace(first, instances=(*first.instances, other)))
    finish_scene(scene, HandInfo(tmp_path / "hand.urdf", {}))
    write_models(tmp_path / "models", {1: CAN, 7: CUBOID})
    wrist = exp(np.array([0, 0, 0, 0, 0, 0.6]))
    (frame,) = frames(scene, StreamConfig(T_camera_hand=wrist, camera=replace(CAMERA, fx=41.0)))
    for obj, pose in ((CAN, np.eye(4)), (CUBOID, T)):
        labelled = truth_of(frame, obj)
        np.testing.assert_array_equal(labelled.truth.T_camera_object, pose)
        np.testing.assert_array_equal(labelled.truth.wrist, np.eye(4))
        np.testing.assert_array_equal(labelled.wrist, wrist)
        np.testing.assert_array_equal(labelled.depth, frame.depth)
        assert labelled.camera == frame.camera


def test_ground_truth_of_what_is_not_known_is_not_guessed(tmp_path: Path) -> None:
    frame, *_ = frames(write_scene(tmp_path), StreamConfig())
    with pytest.raises(InputError, match="has no models to tell its objects by"):
        truth_of(frame, CAN)
    write_models(tmp_path / "models", {1: CAN, 2: CUBOID})
    with pytest.raises(InputError, match="has 0 objects number 2 in image 2"):
        truth_of(frame, CUBOID)
    with pytest.raises(InputError, match=r"the mesh is none of the models in .*models"):
        truth_of(frame, builtin_object("bottle"))
    shifted = TriangleMesh(CAN.mesh.vertices + (0, 0, 0.01), CAN.mesh.faces)
    with pytest.raises(InputError, match="the mesh is none of the models"):
        truth_of(frame, replace(CAN, mesh=shifted))
    shutil.rmtree(tmp_path / "test" / "000001" / "mask")
    with pytest.raises(InputError, match="there is no image"):
        truth_of(frame, CAN)


def test_a_broken_image_is_one_problem(tmp_path: Path) -> None:
    scene = write_scene(tmp_path)
    (scene / "depth" / "000004.png").write_bytes(b"no image")
    found = frames(scene, StreamConfig())
    assert [f.depth is not None for f in found] == [True, False, True]
    assert "cannot read the image" in found[1].problem


def test_the_first_image_may_be_the_broken_one(tmp_path: Path) -> None:
    scene = write_scene(tmp_path)
    (scene / "depth" / "000002.png").write_bytes(b"no image")
    found = frames(scene, StreamConfig())
    assert [f.depth is not None for f in found] == [False, True, True]
    assert {f.camera for f in found} == {CAMERA}


def test_no_ground_truth_of_the_object_is_needed(tmp_path: Path) -> None:
    scene = write_scene(tmp_path)
    shutil.rmtree(scene / "mask")
    shutil.rmtree(scene / "mask_visib")
    assert all(f.depth is not None for f in frames(scene, StreamConfig()))


def test_a_time_that_is_none_is_said(tmp_path: Path) -> None:
    scene = write_scene(tmp_path)
    path = scene / "scene_camera.json"
    fields = json.loads(path.read_text())
    for entry in fields.values():
        entry["time"] = "noon"
    path.write_text(json.dumps(fields))
    with pytest.raises(InputError, match=r"image 2 in .*scene_camera\.json: time must be"):
        open_source(str(scene), StreamConfig())


def test_what_is_missing_is_said(tmp_path: Path) -> None:
    write_scene(tmp_path)
    with pytest.raises(InputError, match=r"name one of its scenes: .*000001"):
        open_source(str(tmp_path), StreamConfig())
    scene = write_scene(tmp_path / "other", hand=False)
    with pytest.raises(InputError, match=r"no wrist pose: it has no scene_hand\.json"):
        open_source(str(scene), StreamConfig())
    T = exp(np.array([0, 0, 0, 0, 0, 0.5]))
    for frame in frames(scene, StreamConfig(T_camera_hand=T)):
        np.testing.assert_array_equal(frame.T_camera_hand, T)


def test_another_camera_takes_the_place_of_the_scenes_own(tmp_path: Path) -> None:
    """Its intrinsics count; readings stay what they are."""
    given = replace(CAMERA, fx=41.0, cx=15.0)
    found = frames(write_scene(tmp_path), StreamConfig(camera=given))
    assert {f.camera for f in found} == {given}
    for frame in found:
        assert frame.depth is not None
        np.testing.assert_allclose(frame.depth, 0.4 + 0.01 * int(frame.name), rtol=1e-6)


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        (replace(CAMERA, depth_unit=0.001), r'write "depth_unit_m": 0\.0001 there'),
        (replace(CAMERA, width=64), r"64 x 24 pixels, but they have 32 x 24 by .*scene_camera"),
    ],
)
def test_a_camera_of_other_images_is_refused(tmp_path: Path, given: Camera, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        open_source(str(write_scene(tmp_path)), StreamConfig(camera=given))


def test_an_image_of_another_depth_unit_is_one_problem(tmp_path: Path) -> None:
    scene = write_scene(tmp_path)
    path = scene / "scene_camera.json"
    fields = json.loads(path.read_text())
    fields["4"]["depth_scale"] = 1.0
    path.write_text(json.dumps(fields))
    found = frames(scene, StreamConfig(camera=CAMERA))
    assert [f.depth is not None for f in found] == [True, False, True]
    assert "it is 0.001 m by" in found[1].problem
