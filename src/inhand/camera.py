"""Pinhole camera."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.checks import file_path, finite_number, number_array, whole_number
from inhand.errors import InputError


@dataclass(frozen=True)
class Camera:
    """Intrinsics of a pinhole camera without distortion (OpenCV frame: x right, y down, z forward).

    Pixel (u, v) is centred at integer coordinates: u = fx x / z + cx.

    Raises:
        InputError: a field is no finite number, or one that must be positive is not.
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
        for name in ("fx", "fy", "cx", "cy", "depth_unit"):
            value = finite_number(getattr(self, name), f"the camera's {name}")
            object.__setattr__(self, name, value)
        for name in ("width", "height"):
            size = whole_number(getattr(self, name), f"the image's {name} [pixel]", least=1)
            object.__setattr__(self, name, size)
        if self.fx <= 0 or self.fy <= 0:
            raise InputError(f"focal lengths must be positive, got fx={self.fx}, fy={self.fy}")
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
        for name, f, size, across in (
            ("fx", self.fx, self.width, "wide"),
            ("fy", self.fy, self.height, "high"),
        ):
            if not 0.15 * size < f < 20 * size:
                raise InputError(
                    f"{name} = {f:.4g} pixel does not fit an image {size} pixel {across}: "
                    "are the intrinsics in pixels and of this image size?"
                )

    @classmethod
    def from_matrix(cls, K: Any, *, width: int, height: int, depth_unit: float = 0.001) -> "Camera":
        """Camera from a 3x3 intrinsic matrix `K` [pixel].

        Raises:
            InputError: `K` is not a plausible intrinsic matrix of an image of this size.
        """
        matrix = number_array(K, "K", "a 3x3 matrix of numbers").astype(np.float64)
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
        fx, fy, cx, cy = matrix[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
        camera = cls(fx, fy, cx, cy, width, height, depth_unit)
        camera.check_plausible()
        return camera

    @classmethod
    def from_json(cls, path: str | Path) -> "Camera":
        """Camera from a JSON file with fx, fy, cx, cy, width, height and optional depth_unit_m.

        Raises:
            InputError: the file is missing, is not JSON, or lacks a number.
        """
        path = file_path(path, "camera file")
        try:
            fields = json.loads(path.read_text())
        except OSError as error:
            raise InputError(f"cannot read the camera file {path}: {error.strerror}") from error
        except (ValueError, RecursionError) as error:
            raise InputError(f"the camera file {path} is not JSON: {error}") from error
        names = ("fx", "fy", "cx", "cy", "width", "height")
        missing = [n for n in names if not isinstance(fields, dict) or n not in fields]
        if missing:
            raise InputError(
                f"the camera file {path} lacks {', '.join(missing)}; expected the keys "
                f"{', '.join(names)} and optionally depth_unit_m"
            )
        try:
            fx, fy, cx, cy, width, height = (fields[n] for n in names)
            camera = cls(fx, fy, cx, cy, width, height, fields.get("depth_unit_m", 0.001))
            camera.check_plausible()
        except InputError as error:
            raise InputError(f"the camera file {path}: {error}") from error
        return camera

    @property
    def matrix(self) -> NDArray[np.float64]:
        """The intrinsic matrix K [pixel], shape (3, 3)."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    def crop(self, u0: int, v0: int, width: int, height: int) -> "Camera":
        """The camera of the image window that starts at pixel (u0, v0)."""
        return replace(self, cx=self.cx - u0, cy=self.cy - v0, width=width, height=height)

    def subsampled(self, step: int) -> "Camera":
        """The camera of the image made of every `step`-th pixel, `depth[::step, ::step]`."""
        scaled = {name: getattr(self, name) / step for name in ("fx", "fy", "cx", "cy")}
        size = {name: -(-getattr(self, name) // step) for name in ("width", "height")}
        return replace(self, **scaled, **size)

    def project(self, points: NDArray[Any]) -> NDArray[np.float64]:
        """Pixel coordinates, shape (n, 2), of points [m] in the camera frame, shape (n, 3)."""
        z = points[:, 2]
        x, y = self.fx * points[:, 0] / z, self.fy * points[:, 1] / z
        return np.stack([x + self.cx, y + self.cy], axis=1)
