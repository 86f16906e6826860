"""Frames with ground truth in folders: found, named and read, whatever their layout.

Two layouts are known by their files: `.npz`, one file a frame (`datasets.npz`), and BOP's, with
`scene_gt.json` in every scene's folder (`datasets.bop`). A frame is named by a path: its `.npz`
file, or the mask of the visible part of its object, `SCENE/mask_visib/IMAGE_INSTANCE.png`. A layout
that comes later needs a reader of its own here, and an answer in each of these functions.
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from inhand.datasets import bop_frames, bop_models, bop_scene
from inhand.datasets.frame import (
    LABEL_BACKGROUND,
    LABEL_HAND,
    LABEL_NOTHING,
    LABEL_OBJECT,
    Frame,
    Truth,
)
from inhand.datasets.npz import read_npz, read_object_name
from inhand.errors import InputError
from inhand.object_model import ObjectModel

__all__ = [
    "LABEL_BACKGROUND",
    "LABEL_HAND",
    "LABEL_NOTHING",
    "LABEL_OBJECT",
    "Frame",
    "Truth",
    "find_frames",
    "find_hand",
    "find_object_mesh",
    "find_objects",
    "find_upwards",
    "frame_name",
    "load_object",
    "need_hand",
    "need_objects",
    "object_name",
    "read_frame",
]

DEFAULT_HAND = "hands/t42/hand_T42b.urdf"
"""Looked for beside the frames and above where a data set does not name its hand."""
_MESH_SUFFIXES = (".ply", ".obj", ".stl", ".off", ".glb", ".dae")


def find_frames(folders: Sequence[str | Path]) -> list[Path]:
    """Frames of data sets, sorted, each data set in any layout.

    Args:
        folders: folders of `.npz` files, folders of such folders, or BOP data sets, their splits
            or scenes; single frames too.

    Raises:
        InputError: a folder is missing, no frame is found in it, or two frames have one name.
    """
    found: list[Path] = []
    for folder in map(Path, folders):
        if folder.is_file():
            files = [folder]
        elif folder.is_dir():
            files = sorted(folder.glob("*.npz")) or sorted(folder.glob("*/*.npz"))
            files = files or bop_frames.find_frames(folder)
        else:
            raise InputError(f"there is no folder of frames {folder}")
        if not files:
            raise InputError(
                f"{folder} holds no frames: expected .npz files in it, or folders of .npz files, "
                "or a BOP data set with ground truth (scene_gt.json in the scenes' folders)"
            )
        found += [file for file in files if file not in found]
    if not found:
        raise InputError("name at least one folder of frames")
    name, count = Counter(map(frame_name, found)).most_common(1)[0]
    if count > 1:
        raise InputError(f"{count} frames are called {name}: their folders need different names")
    return found


def frame_name(path: str | Path) -> str:
    """Name of the frame at `path`: folder and file name without suffix, or BOP's identifiers.

    BOP's are `DATASET/SCENE/IMAGE_INSTANCE`.
    """
    path = Path(path).resolve()
    if bop_frames.is_frame(path):
        return (
            f"{bop_scene.dataset_folder(path.parents[1]).name}/{path.parents[1].name}/{path.stem}"
        )
    return f"{path.parent.name}/{path.stem}"


def read_frame(path: str | Path) -> Frame:
    """Read one frame.

    Raises:
        InputError: a file is missing, cut short, or does not fit the others.
    """
    path = Path(path)
    if bop_frames.is_frame(path):
        return bop_frames.read_frame(path, frame_name(path))
    return read_npz(path, frame_name(path))


def object_name(path: str | Path) -> str:
    """Name of the object in the frame at `path`, without reading its images.

    Raises:
        InputError: a file is missing, cut short, or lacks the name.
    """
    path = Path(path)
    if bop_frames.is_frame(path):
        return bop_frames.read_object_name(path)
    return read_object_name(path)


def find_hand(folder: str | Path, relative: str) -> Path | None:
    """URDF of the hand in a data set: the one a BOP data set names, or as by `find_upwards`."""
    return bop_scene.find_hand(Path(folder)) or find_upwards(folder, relative)


def find_objects(folder: str | Path, relative: str) -> Path | None:
    """Folder of a data set's object models: a BOP data set's, or as by `find_upwards`."""
    scenes = bop_scene.find_scenes(Path(folder))
    if scenes and (models := bop_models.find_models(bop_scene.dataset_folder(scenes[0]))):
        return models
    return find_upwards(folder, relative)


def need_hand(frames: str | Path) -> Path:
    """URDF of the hand that belongs to frames: see `find_hand`, with `DEFAULT_HAND`.

    Raises:
        InputError: there is none.
    """
    hand = find_hand(frames, DEFAULT_HAND)
    if hand is None:
        raise InputError(f"there is no {DEFAULT_HAND} beside {frames} or above: give --hand")
    return hand


def need_objects(frames: str | Path) -> Path:
    """Folder of the object models that belong to frames: see `find_objects`, with `objects`.

    Raises:
        InputError: there is none.
    """
    objects = find_objects(frames, "objects")
    if objects is None:
        raise InputError(f"there is no objects beside {frames} or above: give --objects")
    return objects


def load_object(folder: str | Path, name: str) -> ObjectModel:
    """The model of the object called `name` in a folder of meshes [m] or of BOP models.

    Raises:
        InputError: `folder` is missing or holds no such mesh, or the mesh is broken.
    """
    if bop_models.is_models_folder(Path(folder)):
        return bop_models.load_model(Path(folder), name)
    return ObjectModel.from_mesh(find_object_mesh(folder, name))


def find_upwards(start: str | Path, relative: str) -> Path | None:
    """The nearest `relative` beside `start` or beside one of its parent folders, or None."""
    start = Path(start).resolve()
    return next((f / relative for f in (start, *start.parents) if (f / relative).exists()), None)


def find_object_mesh(folder: str | Path, name: str) -> Path:
    """The mesh file of the object called `name`.

    Raises:
        InputError: `folder` is missing or holds no such mesh.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"there is no folder of object meshes {folder}")
    for suffix in _MESH_SUFFIXES:
        if (folder / (name + suffix)).is_file():
            return folder / (name + suffix)
    known = sorted(f.stem for f in folder.iterdir() if f.suffix.lower() in _MESH_SUFFIXES)
    raise InputError(
        f'there is no mesh of the object "{name}" in {folder}; it holds: '
        f"{', '.join(known) or 'no meshes'}"
    )
