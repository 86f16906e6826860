"""Frames with ground truth, one `.npz` file a frame."""

import zipfile
import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.errors import InputError
from inhand.geometry.se3 import check_rigid

DEPTH_UNIT = 1e-4
"""Metres per count of a frame file's `depth`."""

LABEL_HAND = 1
LABEL_OBJECT = 2

_KEYS = (
    "obj",
    "depth",
    "K",
    "T_camera_hand_given",
    "T_camera_hand",
    "T_camera_object",
    "q",
    "joints",
    "label",
    "visib",
)
_MESH_SUFFIXES = (".ply", ".obj", ".stl", ".off", ".glb", ".dae")


@dataclass(frozen=True)
class Truth:
    """Ground truth of a frame, for scoring only."""

    T_camera_hand: NDArray[np.float64]
    """True wrist pose, shape (4, 4)."""
    T_camera_object: NDArray[np.float64]
    """True object pose, shape (4, 4)."""
    joint_positions: dict[str, float]
    """True joint angles [rad] by joint name."""
    label: NDArray[np.uint8]
    """What each pixel shows, shape (H, W): 0 nothing, 1 hand, 2 object, 3 background."""
    visible_share: float
    """Visible share of the object's silhouette, 0 to 1."""


@dataclass(frozen=True)
class Frame:
    """One depth image with what the estimator may know of it, and its ground truth."""

    name: str
    """Folder and file name without suffix, such as `clean/cuboid_003`."""
    object_name: str
    """Name of the object's mesh file, without suffix."""
    depth: NDArray[np.float32]
    """Depth z [m], shape (H, W), 0 where there is no reading."""
    camera: Camera
    """Intrinsics of the depth image."""
    T_camera_hand_given: NDArray[np.float64]
    """The wrist pose that the estimator is given (approximate), shape (4, 4)."""
    truth: Truth
    """What the estimator must find."""


def find_frames(folders: Sequence[str | Path]) -> list[Path]:
    """Frame files of folders of `.npz` files, or of folders that hold such folders, sorted.

    Raises:
        InputError: a folder is missing, no frame is found in it, or two frames have one name.
    """
    found: list[Path] = []
    for folder in map(Path, folders):
        if folder.is_file():
            files = [folder]
        elif folder.is_dir():
            files = sorted(folder.glob("*.npz")) or sorted(folder.glob("*/*.npz"))
        else:
            raise InputError(f"there is no folder of frames {folder}")
        if not files:
            raise InputError(
                f"{folder} holds no frames: expected .npz files in it, or folders of .npz files"
            )
        found += [file for file in files if file not in found]
    if not found:
        raise InputError("name at least one folder of frames")
    name, count = Counter(map(frame_name, found)).most_common(1)[0]
    if count > 1:
        raise InputError(f"{count} frames are called {name}: their folders need different names")
    return found


def frame_name(path: str | Path) -> str:
    """Name of the frame in the file `path`: folder and file name without suffix."""
    path = Path(path).resolve()
    return f"{path.parent.name}/{path.stem}"


def read_frame(path: str | Path) -> Frame:
    """Read one frame.

    The file holds `obj`, `depth` (uint16, 0.1 mm, 0 = no reading), `K` (3, 3),
    `T_camera_hand_given`, and the truth: `T_camera_hand`, `T_camera_object`, `q` [rad] and
    `joints` (their names), `label` and `visib`.

    Raises:
        InputError: the file is missing, cut short, or its fields are missing or do not fit each
            other.
    """
    fields = _read_arrays(Path(path))
    try:
        return _frame(frame_name(path), fields)
    except (InputError, ValueError, TypeError) as error:
        raise InputError(f"the frame {path} is not usable: {error}") from error


def _read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            missing = [key for key in _KEYS if key not in archive.files]
            if missing:
                raise InputError(
                    f"the frame {path} lacks {', '.join(missing)}; it holds "
                    f"{', '.join(archive.files) or 'nothing'}"
                )
            return {key: archive[key] for key in _KEYS}
    except FileNotFoundError as error:
        raise InputError(f"there is no frame file {path}") from error
    except InputError:
        raise
    except (OSError, EOFError, ValueError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(
            f"cannot read the frame {path} ({error}): is it a complete .npz file?"
        ) from error


def _frame(name: str, fields: dict[str, NDArray[Any]]) -> Frame:
    depth, label = fields["depth"], fields["label"]
    if depth.ndim != 2 or depth.dtype != np.uint16:
        raise InputError(
            f"depth must be uint16 of shape (H, W), got {depth.dtype} of shape {depth.shape}"
        )
    if label.shape != depth.shape:
        raise InputError(f"label has shape {label.shape}, depth has {depth.shape}")
    angles, joints = np.asarray(fields["q"], dtype=np.float64), fields["joints"]
    if angles.ndim != 1 or angles.shape != joints.shape or not np.isfinite(angles).all():
        raise InputError(
            f"q must hold one finite angle for each of joints, got q of shape {angles.shape} "
            f"and joints of shape {joints.shape}"
        )
    visible_share = float(fields["visib"])
    if not 0.0 <= visible_share <= 1.0:
        raise InputError(f"visib must be a share from 0 to 1, got {visible_share}")
    height, width = depth.shape
    return Frame(
        name=name,
        object_name=str(fields["obj"]),
        depth=depth.astype(np.float32) * np.float32(DEPTH_UNIT),
        camera=Camera.from_matrix(fields["K"], width=width, height=height, depth_unit=DEPTH_UNIT),
        T_camera_hand_given=check_rigid(fields["T_camera_hand_given"], "T_camera_hand_given"),
        truth=Truth(
            T_camera_hand=check_rigid(fields["T_camera_hand"], "T_camera_hand"),
            T_camera_object=check_rigid(fields["T_camera_object"], "T_camera_object"),
            joint_positions={str(j): float(a) for j, a in zip(joints, angles, strict=True)},
            label=label.astype(np.uint8),
            visible_share=visible_share,
        ),
    )


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
