"""Data sets in BOP's scene-wise format, with one more file for the hand.

```
DATASET/
  camera.json                  intrinsics of the sensor
  models/                      see `datasets.bop_models`
  test_targets_bop19.json      images and objects to be found
  test/000001/                 one scene
    depth/000003.png           16 bit, in steps of `depth_scale` [mm]
    rgb/000003.png
    mask/000003_000000.png           whole silhouette of the object within the image
    mask_visib/000003_000000.png     visible part of it
    scene_camera.json          intrinsics and depth_scale by image; in a sequence, `time` [s]
    scene_gt.json              object poses [mm] by image
    scene_gt_info.json         boxes, pixel counts and visible share by image
    scene_hand.json            the hand: the file that BOP does not have
    segmentation/000003.png          what every pixel shows, by body
    object_depth/000003_000000.png   depth of the object as if there were nothing else
```

`scene_hand.json` holds, in metres and radians:

- `urdf`: the hand's URDF, relative to the scene's folder; `package_paths`: folders of its packages;
- `segmentation`: what the values of `segmentation/` mean: names of links, "background", "object";
- `images`: by image, `T_camera_hand` (true wrist pose), `T_camera_hand_given` (what an estimator is
  told), `joint_positions` of all movable joints, `T_camera_link` of every link of the URDF.

It, `segmentation/` and `object_depth/` are optional: any BOP data set with depth and ground truth
can be read. Pixel (u, v) is centred at integer coordinates.

Reading returns what was written: numbers to the last bit of a float64 (poses too: millimetres are
metres with the decimal point moved), depth in the steps of `depth_scale` (we write 0.1 mm).
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from inhand.camera import Camera
from inhand.datasets.bop_models import find_models, model_alike, model_name
from inhand.datasets.exact import metres, read_json, rigid
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
from inhand.io import read_colour, read_depth

Array = NDArray[np.float64]

DEPTH_UNIT = 1e-4
"""Metres per count of the depth images that are written: BOP's `depth_scale` of 0.1 mm."""
TARGETS = "test_targets_bop19.json"
SPLIT = "test"
"""Folder of the scenes that are written, and that the targets speak of."""

CAMERA = "scene_camera.json"
TRUTH = "scene_gt.json"
INFO = "scene_gt_info.json"
HAND = "scene_hand.json"
UNFINISHED = "unfinished"
"""Folder in a scene's that is still being written: the images' shares of the JSON files."""

Target = tuple[int, int, int]
"""Numbers of scene, image and object."""

_DEPTH_SUFFIXES = (".png", ".tif", ".tiff")
_COLOUR_FOLDERS = (("rgb", (".png", ".jpg", ".jpeg")), ("gray", (".png", ".jpg", ".tif")))


@dataclass(frozen=True, eq=False)
class Instance:
    """One object in an image."""

    object_id: int
    """Number of its model."""
    T_camera_object: Array
    """Its pose, shape (4, 4)."""
    mask: NDArray[np.bool_] = field(repr=False)
    """Its silhouette in the image as if there were nothing else, shape (H, W)."""
    mask_visible: NDArray[np.bool_] = field(repr=False)
    """Where it is visible, shape (H, W)."""
    silhouette_pixels: int
    """Pixels of its silhouette, those outside the image included."""
    depth: NDArray[np.float32] | None = field(default=None, repr=False)
    """Its depth as if there were nothing else [m], shape (H, W); None if unknown."""

    @property
    def visible_share(self) -> float:
        """Visible share of the silhouette."""
        return float(np.count_nonzero(self.mask_visible) / max(self.silhouette_pixels, 1))


@dataclass(frozen=True, eq=False)
class HandTruth:
    """The hand in an image."""

    T_camera_hand: Array
    """True wrist pose, shape (4, 4)."""
    T_camera_hand_given: Array
    """The wrist pose that an estimator is given, shape (4, 4)."""
    joint_positions: dict[str, float]
    """True positions [rad, m] of all movable joints by name."""
    T_camera_link: dict[str, Array]
    """True poses, (4, 4), of all links by name."""


@dataclass(frozen=True, eq=False)
class BopImage:
    """One image of a scene and everything known about it."""

    camera: Camera
    """Intrinsics of the depth image; `depth_unit` is the step of its readings."""
    depth: NDArray[np.float32] = field(repr=False)
    """Depth z [m], shape (H, W), 0 where there is no reading."""
    instances: tuple[Instance, ...]
    """The annotated objects."""
    rgb: NDArray[np.uint8] | None = field(default=None, repr=False)
    """Colour image, shape (H, W, 3), if there is one."""
    hand: HandTruth | None = field(default=None, repr=False)
    """The hand, if there is one."""
    segmentation: NDArray[np.uint8] | None = field(default=None, repr=False)
    """What every pixel shows, shape (H, W): values as in `scene_hand.json`."""
    time: float | None = None
    """When it was taken [s], in a sequence."""


class Sensed(NamedTuple):
    """What an estimator is given of an image."""

    camera: Camera
    """Intrinsics of the depth image."""
    depth: NDArray[np.float32]
    """Depth z [m], shape (H, W), 0 where there is no reading."""
    T_camera_hand: Array | None
    """Approximate wrist pose, shape (4, 4); None if the data set has no hand."""


@dataclass(frozen=True)
class HandInfo:
    """What `scene_hand.json` says about all images of a scene."""

    urdf: Path
    """The hand's URDF."""
    segmentation: Mapping[int, str]
    """Names of links, "background" and "object" by the value of a segmentation image."""
    package_paths: Mapping[str, Path] = field(default_factory=dict)
    """Folders of the packages that the URDF names."""


@dataclass(frozen=True, eq=False)
class SceneFiles:
    """The JSON files of a scene, entries by image."""

    folder: Path
    camera: Mapping[int, Any]
    truth: Mapping[int, Any]
    info: Mapping[int, Any]
    hand: Mapping[int, Any]
    hand_info: HandInfo | None
    """None where the data set has no hand."""


def is_scene(folder: Path) -> bool:
    """Whether a folder is a scene with ground truth, and finished."""
    return (folder / TRUTH).is_file()


def read_scene(scene: Path) -> SceneFiles:
    """The JSON files of a scene.

    Raises:
        InputError: one is missing or broken, or they do not speak of the same images.
    """
    if not is_scene(scene):
        unfinished = (scene / UNFINISHED).is_dir()
        why = (
            "is unfinished: the command that makes it goes on where it stopped"
            if unfinished
            else ""
        )
        raise InputError(f"the scene {scene} {why or f'has no ground truth: there is no {TRUTH}'}")
    files = [scene / name for name in (CAMERA, TRUTH, INFO, HAND)]
    return _read_scene(scene, tuple(f.stat().st_mtime_ns for f in files if f.is_file()))


def read_sensed(files: SceneFiles, image_id: int) -> Sensed:
    """Read what an estimator is given of an image, and none of its ground truth.

    Raises:
        InputError: the scene does not have it, or a file is missing, broken or does not fit.
    """
    camera, hand = read_camera(files, image_id), _read_hand(files, image_id)
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
    _entry(files.truth, image_id, scene / TRUTH)
    camera = read_camera(files, image_id)
    count = len(files.truth[image_id])
    return BopImage(
        camera=camera,
        depth=read_depth(depth_path(scene, image_id), camera),
        instances=tuple(_read_instance(files, image_id, i, camera) for i in range(count)),
        rgb=read_rgb(scene, image_id, camera),
        hand=_read_hand(files, image_id),
        segmentation=_read_segmentation(scene, image_id, camera),
        time=read_time(files, image_id),
    )


def find_scenes(folder: Path) -> list[Path]:
    """The scenes in a data set's folder, in one of its splits', or the scene itself; sorted."""
    found: list[Path] = []
    for pattern in ("", "*/", "*/*/"):
        found = found or sorted(path.parent for path in folder.glob(pattern + TRUTH))
    return found


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
    numbers = [int(i["obj_id"]) for i in _entry(files.truth, image_id, files.folder / TRUTH)]
    if numbers.count(object_id) != 1:
        raise InputError(
            f"{files.folder / TRUTH} has {numbers.count(object_id)} objects number {object_id} in "
            f"image {image_id}"
        )
    return _frame_path(files.folder, image_id, numbers.index(object_id))


def _frame_path(scene: Path, image_id: int, index: int) -> Path:
    return scene / "mask_visib" / f"{image_id:06d}_{index:06d}.png"


def is_frame(path: Path) -> bool:
    """Whether a path names a frame of a BOP data set."""
    return path.parent.name == "mask_visib"


def dataset_folder(scene: Path) -> Path:
    """The folder of a scene's data set."""
    return scene.resolve().parents[1]


def find_hand(folder: Path) -> Path | None:
    """URDF of the hand in a BOP data set, of a split or of a scene; None if there is none."""
    for scene in find_scenes(folder):
        if hand := read_scene(scene).hand_info:
            return hand.urdf
    return None


def read_frame(path: Path, name: str) -> Frame:
    """Read the frame that the mask `path` names, and call it `name`.

    Raises:
        InputError: a file is missing, broken or does not fit the others.
    """
    scene = path.parents[1]
    image_id, index = frame_ids(path)
    files = read_scene(scene)
    if index >= len(_entry(files.truth, image_id, scene / TRUTH)):
        raise InputError(f"image {image_id} in {scene / TRUTH} has no object number {index}")
    camera = read_camera(files, image_id)
    instance = _read_instance(files, image_id, index, camera)
    hand = _read_hand(files, image_id)
    depth = read_depth(depth_path(scene, image_id), camera)
    segmentation = _read_segmentation(scene, image_id, camera)
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
    instances = _entry(read_scene(scene).truth, image_id, scene / TRUTH)
    return int(scene.name), image_id, int(instances[index]["obj_id"])


def read_object_name(path: Path) -> str:
    """Name of the object in the frame that a path names.

    Raises:
        InputError: the scene does not have the frame.
    """
    return model_name(find_models(dataset_folder(path.parents[1])), frame_target(path)[2])


@lru_cache(maxsize=4)
def _read_scene(scene: Path, _changed: tuple[int, ...]) -> SceneFiles:
    truth = by_image(read_json(scene / TRUTH), scene / TRUTH)
    camera = by_image(read_json(scene / CAMERA), scene / CAMERA)
    info, hand, hand_info = {}, {}, None
    if (scene / INFO).is_file():
        info = by_image(read_json(scene / INFO), scene / INFO)
    if (scene / HAND).is_file():
        fields = read_json(scene / HAND)
        hand_info = _read_hand_info(fields, scene)
        hand = by_image(fields.get("images"), scene / HAND)
    for name, entries in ((CAMERA, camera), (INFO, info), (HAND, hand)):
        missing = sorted(set(truth) - set(entries)) if entries else []
        if missing:
            raise InputError(f"{scene / name} lacks image {missing[0]}, which {TRUTH} has")
    for instances in truth.values():
        if not isinstance(instances, list) or not all("obj_id" in i for i in instances):
            raise InputError(f"{scene / TRUTH} must hold a list of objects by image, with obj_id")
    if info and any(len(info[i]) != len(objects) for i, objects in truth.items()):
        raise InputError(f"{scene / INFO} speaks of other objects than {TRUTH}")
    return SceneFiles(scene, camera, truth, info, hand, hand_info)


def by_image(fields: Any, path: Path) -> dict[int, Any]:
    """The entries of one of a scene's JSON files by the image's number.

    Raises:
        InputError: they have other keys.
    """
    try:
        return {int(key): entry for key, entry in fields.items()}
    except (ValueError, AttributeError) as error:
        raise InputError(f"{path} must hold entries by image number: {error}") from error


def _entry(entries: Mapping[int, Any], image_id: int, path: Path) -> Any:
    if image_id not in entries:
        raise InputError(f"{path} has no image {image_id}")
    return entries[image_id]


def _read_hand_info(fields: Mapping[str, Any], scene: Path) -> HandInfo:
    try:
        return HandInfo(
            urdf=(scene / fields["urdf"]).resolve(),
            segmentation={int(k): str(name) for k, name in fields["segmentation"].items()},
            package_paths={
                name: (scene / folder).resolve()
                for name, folder in fields.get("package_paths", {}).items()
            },
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"{scene / HAND} must hold urdf, segmentation and images: {error!r}"
        ) from error


def read_camera(files: SceneFiles, image_id: int) -> Camera:
    """The camera of an image; `depth_unit` is the step of its readings.

    Raises:
        InputError: the scene does not have the image, or says nothing sensible about it.
    """
    path = files.folder / CAMERA
    fields = _entry(files.camera, image_id, path)
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
    time = _entry(files.camera, image_id, path).get("time")
    try:
        return None if time is None else float(time)
    except (TypeError, ValueError) as error:
        raise InputError(f"image {image_id} in {path}: time must be in seconds: {error}") from error


def _read_instance(files: SceneFiles, image_id: int, index: int, camera: Camera) -> Instance:
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


def _read_hand(files: SceneFiles, image_id: int) -> HandTruth | None:
    if files.hand_info is None:
        return None
    path = files.folder / HAND
    fields = _entry(files.hand, image_id, path)

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


def _read_segmentation(scene: Path, image_id: int, camera: Camera) -> NDArray[np.uint8] | None:
    path = scene / "segmentation" / f"{image_id:06d}.png"
    return _read_pixels(path, camera) if path.is_file() else None


def depth_path(scene: Path, image_id: int) -> Path:
    """The file of a depth image, whether it is there or not."""
    paths = [scene / "depth" / f"{image_id:06d}{suffix}" for suffix in _DEPTH_SUFFIXES]
    return next((path for path in paths if path.is_file()), paths[0])


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
