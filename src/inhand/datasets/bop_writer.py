"""Writing data sets in BOP's scene-wise format; the layout is described in `datasets.bop`.

A scene is written image by image. An image's files come first, its share of the JSON files
(`unfinished/000003.json`) last: an image counts only when that is there. `finish_scene` puts the
shares together; a folder is a scene only when `scene_gt.json` is in it. Every file is there
completely or not at all, so a process that is killed leaves nothing broken behind.
"""

import io
import json
import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from inhand.camera import Camera
from inhand.datasets.bop import (
    CAMERA,
    DEPTH_UNIT,
    HAND,
    INFO,
    TARGETS,
    TRUTH,
    UNFINISHED,
    BopImage,
    HandInfo,
    HandTruth,
    Instance,
)
from inhand.datasets.bop_scene import is_scene, read_scene
from inhand.datasets.exact import millimetres, read_json
from inhand.errors import InputError
from inhand.whole_file import write_whole


def write_image(scene: Path, image_id: int, image: BopImage) -> None:
    """Write one image of a scene; it counts once all its files are there.

    Depth readings are rounded to steps of `DEPTH_UNIT`, whatever the camera's `depth_unit`.

    Raises:
        InputError: a file cannot be written, or a depth does not fit 16 bits.
    """
    files: dict[str, NDArray[Any]] = {f"depth/{image_id:06d}": _counts(image.depth)}
    if image.rgb is not None:
        files[f"rgb/{image_id:06d}"] = image.rgb
    if image.segmentation is not None:
        files[f"segmentation/{image_id:06d}"] = image.segmentation
    for i, instance in enumerate(image.instances):
        name = f"{image_id:06d}_{i:06d}"
        files[f"mask/{name}"] = instance.mask.astype(np.uint8) * 255
        files[f"mask_visib/{name}"] = instance.mask_visible.astype(np.uint8) * 255
        if instance.depth is not None:
            files[f"object_depth/{name}"] = _counts(instance.depth)
    for name, pixels in files.items():
        write_whole(scene / f"{name}.png", _png(pixels))
    share = {
        "files": sorted(files),
        CAMERA: _camera_text(image),
        TRUTH: f"[{', '.join(map(_truth_text, image.instances))}]",
        INFO: json.dumps([_pixel_counts(i, image.depth) for i in image.instances]),
    }
    if image.hand is not None:
        share[HAND] = _hand_text(image.hand)
    write_whole(_share(scene, image_id), json.dumps(share))


def is_written(scene: Path, image_id: int) -> bool:
    """Whether an image of an unfinished scene is there with all its files."""
    path = _share(scene, image_id)
    if not path.is_file():
        return False
    return all((scene / f"{name}.png").is_file() for name in read_json(path)["files"])


def finish_scene(scene: Path, hand: HandInfo | None = None) -> None:
    """Put the shares of a scene's images together to the scene's JSON files.

    Args:
        scene: the folder.
        hand: what `scene_hand.json` says about all images.

    Raises:
        InputError: there is no image, or an image lacks the hand, or a file cannot be written.
    """
    folder = scene / UNFINISHED
    if not is_scene(scene):
        shares = {int(path.stem): read_json(path) for path in sorted(folder.glob("[0-9]*.json"))}
        if not shares or (hand is not None and not all(HAND in s for s in shares.values())):
            what = "images without a hand" if shares else "no images"
            raise InputError(f"the scene {scene} has {what}")
        for name in (CAMERA, INFO, HAND, TRUTH):  # the truth last: it makes the folder a scene
            if name == HAND and hand is None:
                continue
            rows = [f'  "{i}": {share[name]}' for i, share in shares.items()]
            text = "{\n" + ",\n".join(rows) + "\n}"
            if name == HAND and hand is not None:
                text = f'{_hand_info_text(scene, hand)[:-1]}, "images": {text}}}'
            write_whole(scene / name, text + "\n")
    shutil.rmtree(folder, ignore_errors=True)


def write_dataset_files(dataset: Path, camera: Camera, scenes: Sequence[Path]) -> None:
    """Write `camera.json` and the targets: every object of every image of the scenes.

    Raises:
        InputError: a scene is not finished, or a file cannot be written.
    """
    fields = {"cx": camera.cx, "cy": camera.cy, "depth_scale": 1000 * DEPTH_UNIT}
    fields |= {"fx": camera.fx, "fy": camera.fy, "height": camera.height, "width": camera.width}
    write_whole(dataset / "camera.json", json.dumps(fields, indent=2) + "\n")
    targets = []
    for scene in scenes:
        for image_id, instances in read_scene(scene).truth.items():
            numbers = [int(instance["obj_id"]) for instance in instances]
            targets += [
                {
                    "im_id": image_id,
                    "inst_count": numbers.count(number),
                    "obj_id": number,
                    "scene_id": int(scene.name),
                }
                for number in sorted(set(numbers))
            ]
    rows = ",\n".join("  " + json.dumps(target) for target in targets)
    write_whole(dataset / TARGETS, f"[\n{rows}\n]\n")


def _share(scene: Path, image_id: int) -> Path:
    return scene / UNFINISHED / f"{image_id:06d}.json"


def _counts(depth: NDArray[np.float32]) -> NDArray[np.uint16]:
    counts = np.rint(depth.astype(np.float64) / DEPTH_UNIT)
    if counts.min() < 0 or counts.max() > np.iinfo(np.uint16).max:
        raise InputError(
            f"depth from {depth.min():g} to {depth.max():g} m does not fit 16 bits in steps of "
            f"{DEPTH_UNIT} m"
        )
    return counts.astype(np.uint16)


def _png(pixels: NDArray[Any]) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "png", compress_level=1)
    return buffer.getvalue()


def _camera_text(image: BopImage) -> str:
    fields = {"cam_K": image.camera.matrix.ravel().tolist(), "depth_scale": 1000 * DEPTH_UNIT}
    if image.time is not None:
        fields["time"] = image.time
    return json.dumps(fields)


def _truth_text(instance: Instance) -> str:
    R = json.dumps(instance.T_camera_object[:3, :3].ravel().tolist())
    t = ", ".join(millimetres(instance.T_camera_object[:3, 3]))
    return f'{{"cam_R_m2c": {R}, "cam_t_m2c": [{t}], "obj_id": {instance.object_id}}}'


def _pixel_counts(instance: Instance, depth: NDArray[np.float32]) -> dict[str, Any]:
    """An entry of `scene_gt_info.json`; boxes are those within the image."""
    return {
        "bbox_obj": _box(instance.mask),
        "bbox_visib": _box(instance.mask_visible),
        "px_count_all": instance.silhouette_pixels,
        "px_count_valid": int(np.count_nonzero(instance.mask & (depth > 0))),
        "px_count_visib": int(np.count_nonzero(instance.mask_visible)),
        "visib_fract": instance.visible_share,
    }


def _box(mask: NDArray[np.bool_]) -> list[int]:
    """First column, first row, width and height of the marked pixels; -1 where there are none."""
    v, u = np.nonzero(mask)
    if len(u) == 0:
        return [-1, -1, -1, -1]
    return [int(u.min()), int(v.min()), int(np.ptp(u)) + 1, int(np.ptp(v)) + 1]


def _hand_text(hand: HandTruth) -> str:
    links = {name: T.tolist() for name, T in hand.T_camera_link.items()}
    fields = {
        "T_camera_hand": hand.T_camera_hand.tolist(),
        "T_camera_hand_given": hand.T_camera_hand_given.tolist(),
        "joint_positions": hand.joint_positions,
        "T_camera_link": links,
    }
    return json.dumps(fields)


def _hand_info_text(scene: Path, hand: HandInfo) -> str:
    """What `scene_hand.json` says about all images; paths relative to the scene's folder."""

    def relative(path: Path) -> str:
        return Path(os.path.relpath(path.resolve(), scene.resolve())).as_posix()

    fields = {
        "urdf": relative(hand.urdf),
        "package_paths": {name: relative(path) for name, path in hand.package_paths.items()},
        "segmentation": {str(value): name for value, name in hand.segmentation.items()},
    }
    return json.dumps(fields)
