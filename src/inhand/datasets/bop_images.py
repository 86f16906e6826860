"""Reading the images of a scene in BOP's format, with everything that is known about them.

The layout is described in `datasets.bop`.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from inhand.camera import Camera
from inhand.datasets.bop import CAMERA, HAND, TRUTH, Array, BopImage, HandTruth, Instance
from inhand.datasets.bop_scene import SceneFiles, entry, read_scene
from inhand.datasets.exact import metres, rigid
from inhand.errors import InputError
from inhand.io import read_colour, read_depth

_DEPTH_SUFFIXES = (".png", ".tif", ".tiff")
_COLOUR_FOLDERS = (("rgb", (".png", ".jpg", ".jpeg")), ("gray", (".png", ".jpg", ".tif")))


class Sensed(NamedTuple):
    """What an estimator is given of an image."""

    camera: Camera
    """Intrinsics of the depth image."""
    depth: NDArray[np.float32]
    """Depth z [m], shape (H, W), 0 where there is no reading."""
    T_camera_hand: Array | None
    """Approximate wrist pose, shape (4, 4); None if the data set has no hand."""


def read_sensed(files: SceneFiles, image_id: int) -> Sensed:
    """Read what an estimator is given of an image, and none of its ground truth.

    Raises:
        InputError: the scene does not have it, or a file is missing, broken or does not fit.
    """
    camera, hand = read_camera(files, image_id), read_hand(files, image_id)
    return Sensed(
        camera=camera,
        depth=read_depth(depth_path(files.folder, image_id), camera),
        T_camera_hand=None if hand is None else hand.T_camera_hand_given,
    )


def read_image(scene: Path, image_id: int) -> BopImage:
    """Read one image of a scene.

    Raises:
        InputError: the scene does not have it, or a file is missing, broken or does not fit.
    """
    files = read_scene(scene)
    entry(files.truth, image_id, scene / TRUTH)
    camera = read_camera(files, image_id)
    count = len(files.truth[image_id])
    return BopImage(
        camera=camera,
        depth=read_depth(depth_path(scene, image_id), camera),
        instances=tuple(read_instance(files, image_id, i, camera) for i in range(count)),
        rgb=read_rgb(scene, image_id, camera),
        hand=read_hand(files, image_id),
        segmentation=read_segmentation(scene, image_id, camera),
        time=read_time(files, image_id),
    )


def read_camera(files: SceneFiles, image_id: int) -> Camera:
    """The camera of an image; `depth_unit` is the step of its readings.

    Raises:
        InputError: the scene does not have the image, or says nothing sensible about it.
    """
    path = files.folder / CAMERA
    fields = entry(files.camera, image_id, path)
    width, height = _image_size(depth_path(files.folder, image_id))
    try:
        K = np.array(fields["cam_K"], dtype=np.float64).reshape(3, 3)
        unit = float(fields["depth_scale"]) / 1000
        return Camera.from_matrix(K, width=width, height=height, depth_unit=unit)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"image {image_id} in {path}: {error!s}") from error


def read_time(files: SceneFiles, image_id: int) -> float | None:
    """When an image was taken [s], in a sequence; None if that is not told.

    Raises:
        InputError: it is no number.
    """
    path = files.folder / CAMERA
    time = entry(files.camera, image_id, path).get("time")
    try:
        return None if time is None else float(time)
    except (TypeError, ValueError) as error:
        raise InputError(f"image {image_id} in {path}: time must be in seconds: {error}") from error


def depth_path(scene: Path, image_id: int) -> Path:
    """The file of a depth image, whether it is there or not."""
    paths = [scene / "depth" / f"{image_id:06d}{suffix}" for suffix in _DEPTH_SUFFIXES]
    return next((path for path in paths if path.is_file()), paths[0])


def read_rgb(scene: Path, image_id: int, camera: Camera) -> NDArray[np.uint8] | None:
    """The colour image of an image, shape (H, W, 3), or None.

    Raises:
        InputError: it is broken, or of another size than the depth image.
    """
    for folder, suffixes in _COLOUR_FOLDERS:
        for suffix in suffixes:
            path = scene / folder / f"{image_id:06d}{suffix}"
            if path.is_file():
                return read_colour(path, camera)
    return None


def read_instance(files: SceneFiles, image_id: int, index: int, camera: Camera) -> Instance:
    """One of the objects in an image, by its place in `scene_gt.json`.

    Raises:
        InputError: a file is missing, broken or does not fit the depth image.
    """
    path = files.folder / TRUTH
    try:
        fields = files.truth[image_id][index]
        T = rigid(fields["cam_R_m2c"], metres(fields["cam_t_m2c"]), "the pose")
        object_id = int(fields["obj_id"])
        info = files.info[image_id][index] if files.info else {}
        silhouette = int(info["px_count_all"]) if "px_count_all" in info else None
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"object {index} of image {image_id} in {path}: {error!s}") from error
    name = f"{image_id:06d}_{index:06d}.png"
    mask = _read_pixels(files.folder / "mask" / name, camera) > 0
    depth_path = files.folder / "object_depth" / name
    return Instance(
        object_id=object_id,
        T_camera_object=T,
        mask=mask,
        mask_visible=_read_pixels(files.folder / "mask_visib" / name, camera) > 0,
        silhouette_pixels=int(np.count_nonzero(mask)) if silhouette is None else silhouette,
        depth=read_depth(depth_path, camera) if depth_path.is_file() else None,
    )


def read_hand(files: SceneFiles, image_id: int) -> HandTruth | None:
    """The hand in an image; None where the data set has no hand.

    Raises:
        InputError: the scene says nothing sensible about it.
    """
    if files.hand_info is None:
        return None
    path = files.folder / HAND
    fields = entry(files.hand, image_id, path)

    def pose(T: Any, name: str) -> Array:
        matrix = np.array(T, dtype=np.float64)
        if matrix.shape != (4, 4):
            raise InputError(f"{name} must be a 4x4 matrix")
        return rigid(matrix[:3, :3], matrix[:3, 3], name)

    try:
        return HandTruth(
            T_camera_hand=pose(fields["T_camera_hand"], "T_camera_hand"),
            T_camera_hand_given=pose(fields["T_camera_hand_given"], "T_camera_hand_given"),
            joint_positions={n: float(q) for n, q in fields["joint_positions"].items()},
            T_camera_link={n: pose(T, n) for n, T in fields.get("T_camera_link", {}).items()},
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"image {image_id} in {path}: {error!s}") from error


def read_segmentation(scene: Path, image_id: int, camera: Camera) -> NDArray[np.uint8] | None:
    """What every pixel shows, shape (H, W), values as in `scene_hand.json`; None if unknown.

    Raises:
        InputError: it is broken, or of another size than the depth image.
    """
    path = scene / "segmentation" / f"{image_id:06d}.png"
    return _read_pixels(path, camera) if path.is_file() else None


def _image_size(path: Path) -> tuple[int, int]:
    """Width and height of an image."""
    if not path.is_file():
        raise InputError(f"there is no depth image {path}")
    try:
        with Image.open(path) as image:
            return image.size
    except Exception as error:  # a damaged image makes Pillow raise nearly anything
        raise InputError(f"cannot read the image {path}: {error}") from error


def _read_pixels(path: Path, camera: Camera) -> NDArray[np.uint8]:
    """An image with one channel of 8 bits, shape (H, W), of the camera's size."""
    if not path.is_file():
        raise InputError(f"there is no image {path}")
    try:
        with Image.open(path) as image:
            pixels = np.asarray(image.convert("L"))
    except Exception as error:  # a damaged image makes Pillow raise nearly anything
        raise InputError(f"cannot read the image {path}: {error}") from error
    if pixels.shape != (camera.height, camera.width):
        raise InputError(
            f"{path} is {pixels.shape[1]} x {pixels.shape[0]} pixels but the depth image "
            f"{camera.width} x {camera.height}"
        )
    return pixels
