"""Pinhole camera."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.errors import InputError


@dataclass(frozen=True)
class Camera:
    """Intrinsics of a pinhole camera without distortion (OpenCV frame: x right, y down, z forward).

    Pixel (u, v) is centred at integer coordinates: u = fx x / z + cx.

    Raises:
        InputError: a number is not finite or not positive, or the intrinsics cannot belong to an
            image of this size.
    """

    fx: float
    """Focal length [pixel]."""
    fy: float
    """Focal length [pixel]."""
    cx: float
    """Principal point [pixel]."""
    cy: float
    """Principal point [pixel]."""
    width: int
    """Image width [pixel]."""
    height: int
    """Image height [pixel]."""
    depth_unit: float = 0.001
    """Metres per count of integer depth images."""

    def __post_init__(self) -> None:
        numbers = [self.fx, self.fy, self.cx, self.cy, self.width, self.height, self.depth_unit]
        try:
            finite = bool(np.isfinite(np.array(numbers, dtype=np.float64)).all())
        except (TypeError, ValueError) as error:
            raise InputError(f"camera intrinsics must be numbers, got {numbers}") from error
        if not finite:
            raise InputError(f"camera intrinsics hold NaN or infinite numbers: {numbers}")
        if self.fx <= 0 or self.fy <= 0:
            raise InputError(f"focal lengths must be positive, got fx={self.fx}, fy={self.fy}")
        if self.width <= 0 or self.height <= 0 or self.width % 1 or self.height % 1:
            raise InputError(
                f"image size must be whole positive numbers, got {self.width} x {self.height}"
            )
        if not 0 < self.depth_unit <= 1:
            raise InputError(
                f"depth_unit is metres per count (0.001 for mm), got {self.depth_unit}"
            )

    def check_plausible(self) -> None:
        """Raise InputError when the intrinsics cannot belong to a whole image of this size."""
        if not (-0.5 * self.width < self.cx < 1.5 * self.width) or not (
            -0.5 * self.height < self.cy < 1.5 * self.height
        ):
            raise InputError(
                f"principal point ({self.cx:.1f}, {self.cy:.1f}) lies far outside the "
                f"{self.width} x {self.height} image: do the intrinsics belong to this image size?"
            )
        if not (0.15 * self.width < self.fx < 20 * self.width):
            raise InputError(
                f"fx = {self.fx:.1f} pixel does not fit an image {self.width} pixel wide: "
                "are the intrinsics in pixels and of this image size?"
            )

    @classmethod
    def from_matrix(cls, K: Any, *, width: int, height: int, depth_unit: float = 0.001) -> "Camera":
        """Camera from a 3x3 intrinsic matrix `K` [pixel].

        Raises:
            InputError: `K` is not a plausible intrinsic matrix of an image of this size.
        """
        try:
            matrix = np.array(K, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"K must be a 3x3 matrix of numbers, got {type(K).__name__}"
            ) from error
        if matrix.shape != (3, 3):
            raise InputError(f"K must be a 3x3 intrinsic matrix, got shape {matrix.shape}")
        if not np.isfinite(matrix).all():
            raise InputError("K holds NaN or infinite numbers")
        if not np.allclose(matrix[[1, 2, 2, 2], [0, 0, 1, 2]], [0, 0, 0, 1]):
            raise InputError(
                "K must have zeros below its diagonal and K[2, 2] = 1, got "
                f"{matrix.tolist()}; a transposed K has its principal point in the last row"
            )
        if abs(matrix[0, 1]) > 1e-6 * abs(matrix[0, 0]):
            raise InputError(f"skew is not supported, K[0, 1] = {matrix[0, 1]}; rectify the image")
        camera = cls(
            *(float(x) for x in matrix[[0, 1, 0, 1], [0, 1, 2, 2]]), width, height, depth_unit
        )
        camera.check_plausible()
        return camera

    @classmethod
    def from_json(cls, path: str | Path) -> "Camera":
        """Camera from a JSON file with fx, fy, cx, cy, width, height and optional depth_unit_m.

        Raises:
            InputError: the file is missing, is not JSON, or lacks a number.
        """
        try:
            fields = json.loads(Path(path).read_text())
        except OSError as error:
            raise InputError(f"cannot read the camera file {path}: {error.strerror}") from error
        except ValueError as error:
            raise InputError(f"the camera file {path} is not JSON: {error}") from error
        names = ("fx", "fy", "cx", "cy", "width", "height")
        missing = [n for n in names if not isinstance(fields, dict) or n not in fields]
        if missing:
            raise InputError(
                f"the camera file {path} lacks {', '.join(missing)}; expected the keys "
                f"{', '.join(names)} and optionally depth_unit_m"
            )
        numbers = [fields[n] for n in names] + [fields.get("depth_unit_m", 0.001)]
        if any(isinstance(x, bool) or not isinstance(x, int | float) for x in numbers):
            raise InputError(f"the camera file {path} must hold numbers, got {numbers}")
        fx, fy, cx, cy, width, height, unit = numbers
        camera = cls(fx, fy, cx, cy, width, height, unit)
        camera.check_plausible()
        return camera

    @property
    def matrix(self) -> NDArray[np.float64]:
        """The intrinsic matrix K [pixel], shape (3, 3)."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    def crop(self, u0: int, v0: int, width: int, height: int) -> "Camera":
        """The camera of the image window that starts at pixel (u0, v0)."""
        return Camera(self.fx, self.fy, self.cx - u0, self.cy - v0, width, height, self.depth_unit)

    def subsampled(self, step: int) -> "Camera":
        """The camera of the image made of every `step`-th pixel, `depth[::step, ::step]`."""
        return Camera(
            self.fx / step,
            self.fy / step,
            self.cx / step,
            self.cy / step,
            -(-self.width // step),
            -(-self.height // step),
            self.depth_unit,
        )

    def project(self, points: NDArray[Any]) -> NDArray[np.float64]:
        """Pixel coordinates, shape (n, 2), of points [m] in the camera frame, shape (n, 3)."""
        z = points[:, 2]
        return np.stack(
            [self.fx * points[:, 0] / z + self.cx, self.fy * points[:, 1] / z + self.cy], 1
        )
