"""A BOP data set of nonsense that fits together, for tests."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from inhand.camera import Camera
from inhand.datasets import bop
from inhand.datasets.bop import BopImage, HandInfo, HandTruth, Instance
from inhand.datasets.bop_models import write_models
from inhand.datasets.bop_writer import finish_scene, write_dataset_files, write_image
from inhand.geometry.mesh import box, cylinder
from inhand.geometry.se3 import exp
from inhand.object_model import ObjectModel

CAMERA = Camera(fx=80.1, fy=80.3, cx=31.7, cy=23.9, width=64, height=48, depth_unit=bop.DEPTH_UNIT)
HAND, BACKGROUND, OBJECT = 1, 254, 255


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


@cache
def three_objects() -> dict[int, ObjectModel]:
    """A brick with a notch that breaks its symmetry, a cuboid, a cylinder."""
    odd = trimesh.creation.box((0.03, 0.05, 0.08)).slice_plane((0.01, 0.01, 0.02), (-1, -2, -3))
    models = {
        "odd": ObjectModel.from_mesh(odd),
        "cuboid": ObjectModel.from_mesh(box((0.03, 0.03, 0.06))),
        "rod": ObjectModel.from_mesh(cylinder(0.02, 0.08)),
    }
    return {i: replace(m, name=n) for i, (n, m) in enumerate(models.items(), start=1)}


def write_dataset(folder: Path) -> Path:
    """Two scenes with two images each, the second with two objects in every image."""
    scenes = [folder / "test" / f"{s:06d}" for s in (1, 2)]
    for number, scene in enumerate(scenes):
        write_scene(scene, {i: bop_image(10 * number + i, 1 + number) for i in (3, 11)})
    write_models(folder / "models", three_objects())
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
