"""What the camera saw around the hand: region of interest, normals, scene cloud P_S."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.config import ObservationConfig
from inhand.errors import NoAnswer
from inhand.geometry.se3 import transform
from inhand.kernels.depth import pinhole
from inhand.kernels.depth_image import RowSums, fit_planes, missing_in_rows, missing_share, sum_rows
from inhand.kernels.hand_fit import DepthView
from inhand.kernels.launch import computed, empty, in_struct, launch, on_host

NEAREST = 1e-3
"""Smaller depths are no readings [m]; their inverses would overflow."""
STEEPEST = 1.5
"""Rays are no steeper than this against the optical axis [rad]."""
DIRECTION = "T_camera_hand maps points of the hand to the camera, not the other way"
EVERY = 5
"""Every so-many-th reading is looked at for what holds all over the image."""


@dataclass(frozen=True)
class Cloud:
    """Oriented points."""

    points: NDArray[np.float32]
    """Points [m], camera frame, shape (n, 3)."""
    normals: NDArray[np.float32]
    """Unit normals towards the camera, shape (n, 3)."""


@dataclass(frozen=True)
class Observation:
    """The region of interest of the depth image and the scene cloud made from it."""

    camera: Camera
    """Camera of the region of interest."""
    offset: tuple[int, int]
    """Pixel (u, v) of the whole image where the region of interest starts."""
    depth: NDArray[np.float32]
    """Depth of the region of interest [m], shape (h, w), 0 where there is no reading."""
    view: Any = field(repr=False)
    """The same on the device with what kernels ask of every pixel, `kernels.hand_fit.DepthView`."""
    smooth: NDArray[np.float32] = field(repr=False)
    """Depth of the surface estimated at every pixel [m], shape (h, w), 0 without a reading."""
    sphere: tuple[NDArray[np.float64], float]
    """Centre [m] in the camera frame and radius [m] of the region of interest."""
    points: NDArray[np.float32]
    """Scene cloud P_S [m], camera frame, shape (n, 3)."""
    normals: NDArray[np.float32]
    """Unit normals of the scene cloud towards the camera, shape (n, 3)."""
    T_camera_hand: NDArray[np.float64]
    """The wrist pose as given, shape (4, 4)."""
    step: int
    """The scene cloud is made of every so-many-th pixel, along either side."""
    noise: float
    """Standard deviation of the depth readings [m], estimated from the image."""

    @cached_property
    def cloud_on_device(self) -> list[Any]:
        """Points and normals of the scene cloud, `wp.array` of vec3."""
        device = self.view.depth.device
        return [in_struct(vectors, wp.vec3, device) for vectors in (self.points, self.normals)]

    def cloud(self, step: int, around: NDArray[np.float32] | None = None) -> Cloud:
        """The scene cloud made of every `step`-th pixel, along either side.

        Args:
            step: 1 for every pixel.
            around: points [m], shape (n, 3); the rectangle of the image that shows them is enough.
        """
        every = (slice(step // 2, None, step),) * 2
        if around is not None:
            pixels = self.camera.project(around).astype(int)
            low = np.maximum(pixels.min(axis=0) - self.step, 0)
            high = pixels.max(axis=0) + self.step + 1
            every = slice(low[1], high[1], step), slice(low[0], high[0], step)
        return _cloud(self.smooth, self.view, self.camera, self.sphere, every)


def observe(
    depth: NDArray[np.float32],
    camera: Camera,
    T_camera_hand: NDArray[np.float64],
    reach: tuple[NDArray[np.float64], float],
    object_diameter: float,
    config: ObservationConfig,
    device: str,
) -> Observation:
    """Cut the region of interest out of the image and estimate its surfaces.

    The region is the sphere around the hand's reach, grown by what an object in the fingers adds.

    Args:
        depth: depth image [m], shape (H, W), 0, NaN or inf where there is no reading.
        camera: its camera.
        T_camera_hand: approximate wrist pose, shape (4, 4).
        reach: sphere (centre [m] in the hand frame, radius [m]) that holds the hand.
        object_diameter: [m].
        config: parameters.
        device: Warp device name.

    Raises:
        NoAnswer: the hand lies outside the image or the region holds too few readings.
    """
    centre = transform(T_camera_hand, reach[0][None])[0]
    radius = reach[1] + config.margin + 0.5 * object_diameter
    u0, v0, u1, v1 = _window(camera, centre, radius)
    roi = camera.crop(u0, v0, u1 - u0, v1 - v0)
    near, far = max(centre[2] - radius, NEAREST), centre[2] + radius
    window = depth[v0:v1, u0:u1].copy()
    window[~((window >= NEAREST) & (window < np.inf))] = 0
    # A reading behind the region of interest still proves free space: it is kept as an image.
    inside = (window > near) & (window < far)
    if (count := np.count_nonzero(inside)) < config.min_points:
        raise NoAnswer(
            f"only {count} depth readings lie in the region of the hand "
            f"(around {centre[2]:.2f} m); check the wrist pose, the depth unit and the sensor range"
        )
    view = DepthView()
    view.camera = pinhole(roi)
    view.depth = in_struct(window.reshape(-1), float, device)
    view.normals = wp.empty(window.size, dtype=wp.vec3, device=device)
    view.missing = wp.empty(window.size, dtype=float, device=device)
    smooth = _find_surfaces(view, far, config)
    _find_missing(view, config.missing_window)
    distance = float((window * inside).sum()) / count
    step = max(1, round(config.point_spacing * roi.fx / distance))
    cloud = _cloud(smooth, view, roi, (centre, radius), (slice(step // 2, None, step),) * 2)
    if len(cloud.points) < config.min_points:
        raise NoAnswer("almost no depth readings lie in the region of the hand")
    return Observation(
        camera=roi,
        offset=(u0, v0),
        depth=window,
        view=view,
        smooth=smooth,
        sphere=(centre, radius),
        points=cloud.points,
        normals=cloud.normals,
        T_camera_hand=T_camera_hand,
        step=step,
        noise=_noise(window, inside, config.noise_spacing),
    )


def _noise(depth: NDArray[np.float32], inside: NDArray[np.bool_], apart: int) -> float:
    """Standard deviation of readings [m]: how far the middle of three is off the outer two's line.

    Neighbouring pixels share much of their error, so the three are `apart` pixels from each other.
    """
    left, middle, right = (slice(None, -2 * apart), slice(apart, -apart), slice(2 * apart, None))
    rows = slice(None, None, 2)
    every = inside[rows, left] & inside[rows, middle] & inside[rows, right]
    bend = (depth[rows, left] - 2 * depth[rows, middle] + depth[rows, right])[every]
    return float(1.4826 / np.sqrt(6) * np.median(np.abs(bend))) if len(bend) else 0.0


def _find_surfaces(view: Any, far: float, config: ObservationConfig) -> NDArray[np.float32]:
    """Fill in the normals of the view; smoothed depth [m], shape (h, w)."""
    device, shape = str(view.depth.device), (view.camera.height, view.camera.width)
    sums = empty(view.depth.shape, RowSums, device)
    inputs = [view, config.normal_window, config.normal_gate, far, sums]
    launch(sum_rows, len(sums), inputs, device, work_per_item=10)
    return computed(fit_planes, shape, float, inputs, device, work_per_item=25)


def _find_missing(view: Any, radius: int) -> None:
    """Fill in the share of missing readings around every pixel of the view without one.

    It counts from what is usual around pixels with a reading.
    """
    device, width, height = str(view.depth.device), view.camera.width, view.camera.height
    in_rows = empty(view.depth.shape, int, device)
    inputs = [view, radius, in_rows]
    launch(missing_in_rows, height, inputs, device, work_per_item=2 * width)
    around, reading = on_host(in_rows)[::EVERY], view.depth.numpy()[::EVERY] > 0
    usual = float(np.median(around[reading])) / (2 * radius + 1)
    launch(missing_share, width, [*inputs, usual], device, work_per_item=2 * height)


def _window(
    camera: Camera, centre: NDArray[np.float64], radius: float
) -> tuple[int, int, int, int]:
    """Image rectangle (u0, v0, u1, v1) of the sphere."""
    if centre[2] <= 0.01:
        raise NoAnswer(f"the wrist pose puts the hand behind the camera; {DIRECTION}")
    spans = []
    for x, f, c, size in (
        (centre[0], camera.fx, camera.cx, camera.width),
        (centre[1], camera.fy, camera.cy, camera.height),
    ):
        # The rays that touch the sphere, seen along the image's other axis.
        middle = np.arctan2(x, centre[2])
        half = np.arcsin(min(1.0, radius / np.hypot(x, centre[2])))
        edges = f * np.tan(np.clip([middle - half, middle + half], -STEEPEST, STEEPEST)) + c
        low, high = int(np.floor(edges[0])), int(np.ceil(edges[1])) + 1
        spans.append((max(low, 0), min(high, size)))
    (u0, u1), (v0, v1) = spans
    if u1 - u0 < 8 or v1 - v0 < 8:
        raise NoAnswer(
            f"the wrist pose puts the hand outside the image, or too far away ({centre[2]:.2f} m) "
            f"to be seen in it; {DIRECTION}"
        )
    return u0, v0, u1, v1


def _cloud(
    smooth: NDArray[np.float32],
    view: Any,
    roi: Camera,
    sphere: tuple[NDArray[np.float64], float],
    every: tuple[slice, slice],
) -> Cloud:
    """The points in the sphere of those pixels in the rows and columns that have a normal."""
    z, normals = smooth[every], view.normals.numpy().reshape(*smooth.shape, 3)[every]
    v, u = np.arange(roi.height)[every[0]], np.arange(roi.width)[every[1]]
    x = ((u - roi.cx) / roi.fx).astype(np.float32) * z
    y = ((v - roi.cy) / roi.fy).astype(np.float32)[:, None] * z
    centre, radius = sphere[0].astype(np.float32), np.float32(sphere[1])
    with np.errstate(over="ignore"):  # is far away
        squares = (x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2
    near = np.flatnonzero((squares < radius * radius) & (normals[..., 2] != 0))
    points = np.stack([axis.ravel()[near] for axis in (x, y, z)], axis=1)
    return Cloud(points, normals.reshape(-1, 3)[near])
