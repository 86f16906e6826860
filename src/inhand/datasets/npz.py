"""Frames with ground truth, one `.npz` file a frame."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.datasets.frame import Frame, Truth
from inhand.errors import InputError
from inhand.geometry.se3 import check_rigid

DEPTH_UNIT = 1e-4
"""Metres per count of a frame file's `depth`."""
PIXEL_CENTRE = 0.5
"""Where the file's `K` puts the centre of the first pixel, which lies at 0 everywhere else."""

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


def read_npz(path: Path, name: str) -> Frame:
    """Read one frame, which is to be called `name`.

    The file holds `obj`, `depth` (uint16, 0.1 mm, 0 = no reading), `K` (3, 3) of pixels centred at
    half-integer coordinates, `T_camera_hand_given`, and the truth: `T_camera_hand`,
    `T_camera_object`, `q` [rad] and `joints` (their names), `label` and `visib`.

    Raises:
        InputError: the file is missing, cut short, or its fields are missing or do not fit each
            other.
    """
    fields = _read_arrays(path)
    try:
        return _frame(name, fields)
    except (InputError, ValueError, TypeError) as error:
        raise InputError(f"the frame {path} is not usable: {error}") from error


def read_object_name(path: Path) -> str:
    """Name of the object in a frame, without reading the rest.

    Raises:
        InputError: the file is missing, cut short, or lacks the name.
    """
    return str(_read_arrays(path, ("obj",))["obj"])


def _read_arrays(path: Path, keys: tuple[str, ...] = _KEYS) -> dict[str, NDArray[Any]]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            missing = [key for key in keys if key not in archive.files]
            if missing:
                raise InputError(
                    f"the frame {path} lacks {', '.join(missing)}; it holds "
                    f"{', '.join(archive.files) or 'nothing'}"
                )
            return {key: archive[key] for key in keys}
    except FileNotFoundError as error:
        raise InputError(f"there is no frame file {path}") from error
    except InputError:
        raise
    except Exception as error:  # a damaged archive makes zipfile and numpy raise nearly anything
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
    K = np.array(fields["K"], dtype=np.float64)
    if K.shape == (3, 3):
        K[:2, 2] -= PIXEL_CENTRE
    return Frame(
        name=name,
        object_name=str(fields["obj"]),
        depth=depth.astype(np.float32) * np.float32(DEPTH_UNIT),
        camera=Camera.from_matrix(K, width=width, height=height, depth_unit=DEPTH_UNIT),
        wrist=check_rigid(fields["T_camera_hand_given"], "T_camera_hand_given"),
        truth=Truth(
            wrist=check_rigid(fields["T_camera_hand"], "T_camera_hand"),
            T_camera_object=check_rigid(fields["T_camera_object"], "T_camera_object"),
            joint_positions={str(j): float(a) for j, a in zip(joints, angles, strict=True)},
            label=label.astype(np.uint8),
            visible_share=visible_share,
        ),
    )
