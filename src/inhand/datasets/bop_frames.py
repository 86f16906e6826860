"""Frames of a data set in BOP's format: one object in one image, named by its visible part's mask.

The layout is described in `datasets.bop`.
"""

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inhand.datasets.bop import SPLIT, TARGETS, TRUTH, HandInfo, Instance
from inhand.datasets.bop_images import (
    depth_path,
    read_camera,
    read_hand,
    read_instance,
    read_rgb,
    read_segmentation,
    read_time,
)
from inhand.datasets.bop_models import find_models, model_alike, model_name
from inhand.datasets.bop_scene import SceneFiles, dataset_folder, entry, find_scenes, read_scene
from inhand.datasets.frame import (
    LABEL_BACKGROUND,
    LABEL_HAND,
    LABEL_NOTHING,
    LABEL_OBJECT,
    Frame,
    Truth,
)
from inhand.errors import InputError
from inhand.geometry.mesh import TriangleMesh
from inhand.io import read_depth

Target = tuple[int, int, int]
"""Numbers of scene, image and object."""


def find_frames(folder: Path) -> list[Path]:
    """The frames of a BOP data set, of a split or of a scene: masks of the visible objects.

    Where the folder is a data set's and holds targets, only the objects in them. Scenes that only
    the targets speak of are left out: a data set need not be there as a whole.

    Raises:
        InputError: a JSON file is broken, or the targets name an object that a scene lacks.
    """
    scenes, targets = find_scenes(folder), _read_targets(folder / TARGETS)
    if targets is not None:
        scenes = [scene for scene in scenes if scene.parent.name.startswith(SPLIT)]
    frames = [
        ((int(scene.name), image_id, int(instance["obj_id"])), _frame_path(scene, image_id, i))
        for scene in scenes
        for image_id, instances in sorted(read_scene(scene).truth.items())
        for i, instance in enumerate(instances)
    ]
    if targets is not None:
        here = {int(scene.name) for scene in scenes}
        lost = targets - {target for target, _ in frames}
        for scene_id, image_id, object_id in sorted(t for t in lost if t[0] in here):
            raise InputError(
                f"{folder / TARGETS} names object {object_id} in image {image_id} of scene "
                f"{scene_id}, which the scene's {TRUTH} lacks"
            )
    return [path for target, path in frames if targets is None or target in targets]


def frame_of_object(files: SceneFiles, image_id: int, mesh: TriangleMesh) -> Path:
    """The frame of the object in an image whose model a mesh is like.

    Raises:
        InputError: there is no such model, or the image does not show that object once.
    """
    models = find_models(dataset_folder(files.folder))
    if models is None:
        raise InputError(f"the data set of {files.folder} has no models to tell its objects by")
    object_id = model_alike(models, mesh)
    numbers = [int(i["obj_id"]) for i in entry(files.truth, image_id, files.folder / TRUTH)]
    if numbers.count(object_id) != 1:
        raise InputError(
            f"{files.folder / TRUTH} has {numbers.count(object_id)} objects number {object_id} in "
            f"image {image_id}"
        )
    return _frame_path(files.folder, image_id, numbers.index(object_id))


def is_frame(path: Path) -> bool:
    """Whether a path names a frame of a BOP data set."""
    return path.parent.name == "mask_visib"


def read_frame(path: Path, name: str) -> Frame:
    """Read the frame that the mask `path` names, and call it `name`.

    Raises:
        InputError: a file is missing, broken or does not fit the others.
    """
    scene = path.parents[1]
    image_id, index = frame_ids(path)
    files = read_scene(scene)
    if index >= len(entry(files.truth, image_id, scene / TRUTH)):
        raise InputError(f"image {image_id} in {scene / TRUTH} has no object number {index}")
    camera = read_camera(files, image_id)
    instance = read_instance(files, image_id, index, camera)
    hand = read_hand(files, image_id)
    depth = read_depth(depth_path(scene, image_id), camera)
    segmentation = read_segmentation(scene, image_id, camera)
    return Frame(
        name=name,
        object_name=model_name(find_models(dataset_folder(scene)), instance.object_id),
        depth=depth,
        camera=camera,
        wrist=None if hand is None else hand.T_camera_hand_given,
        truth=Truth(
            wrist=None if hand is None else hand.T_camera_hand,
            T_camera_object=instance.T_camera_object,
            joint_positions={} if hand is None else hand.joint_positions,
            label=_label(instance, depth, segmentation, files.hand_info),
            visible_share=instance.visible_share,
        ),
        rgb=read_rgb(scene, image_id, camera),
        time=read_time(files, image_id),
    )


def frame_ids(path: Path) -> tuple[int, int]:
    """Numbers of the image and of the object in it that a frame's path names.

    Raises:
        InputError: the path is not such as `mask_visib/000003_000000.png`.
    """
    parts = path.stem.split("_")
    if len(parts) != 2 or not all(part.isdecimal() for part in parts):
        raise InputError(f"{path} does not name a frame: expected mask_visib/IMAGE_INSTANCE.png")
    return int(parts[0]), int(parts[1])


def frame_target(path: Path) -> Target:
    """Numbers of scene, image and object of the frame that a path names: BOP's test target.

    Raises:
        InputError: the scene does not have it.
    """
    scene = path.parents[1]
    image_id, index = frame_ids(path)
    instances = entry(read_scene(scene).truth, image_id, scene / TRUTH)
    return int(scene.name), image_id, int(instances[index]["obj_id"])


def read_object_name(path: Path) -> str:
    """Name of the object in the frame that a path names.

    Raises:
        InputError: the scene does not have the frame.
    """
    return model_name(find_models(dataset_folder(path.parents[1])), frame_target(path)[2])


def _frame_path(scene: Path, image_id: int, index: int) -> Path:
    return scene / "mask_visib" / f"{image_id:06d}_{index:06d}.png"


def _read_targets(path: Path) -> set[Target] | None:
    """Scene, image and object of every target; None without a file of targets."""
    if not path.is_file():
        return None
    try:
        targets = json.loads(path.read_text())
        return {(int(t["scene_id"]), int(t["im_id"]), int(t["obj_id"])) for t in targets}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} is no list of targets: {error!r}") from error


def _label(
    instance: Instance,
    depth: NDArray[np.float32],
    segmentation: NDArray[np.uint8] | None,
    hand: HandInfo | None,
) -> NDArray[np.uint8]:
    """What each pixel shows; without segmentation, all that is not the object is background."""
    if segmentation is None or hand is None:
        label = np.where(depth > 0, LABEL_BACKGROUND, LABEL_NOTHING).astype(np.uint8)
    else:
        meaning = np.full(256, LABEL_NOTHING, dtype=np.uint8)
        for value, name in hand.segmentation.items():
            others = name in ("background", "object")
            meaning[value] = LABEL_BACKGROUND if others else LABEL_HAND
        label = meaning[segmentation]
    label[instance.mask_visible] = LABEL_OBJECT
    return label
