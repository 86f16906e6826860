"""What a depth camera makes of a perfect depth image, and how wrongly the wrist is known."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter
from scipy.special import ndtri

from inhand.camera import Camera
from inhand.geometry import se3
from inhand.kernels.depth import pinhole
from inhand.kernels.launch import launch
from inhand.synth.kernels import incidence_angles

Image = NDArray[Any]
"""Floating-point numbers, shape (H, W)."""


@dataclass(frozen=True)
class SensorModel:
    """Errors of a depth camera; a field at 0 switches its error off.

    "Nguyen" is Nguyen, Izadi and Lovell, "Modeling Kinect Sensor Noise for Improved 3D
    Reconstruction and Tracking", 3DIMPVT 2012. "Intel" is Grunnet-Jepsen, Sweetser and Woodfill,
    "Tuning depth cameras for best performance", on the RealSense D400. Angles are between the line
    of sight and the surface normal. Fields without a source are choices of ours.
    """

    quantisation: float = 0.0001
    """Step of the readings [m]; 0.1 mm is the paper's simulation."""
    lateral: float = 0.0
    """Sd of the sideways displacement of a reading [pixel]; grows as
    lateral + 0.035 angle / (pi/2 - angle), where Nguyen measures lateral = 0.8."""
    axial: float = 0.0
    """Sd of the depth error at 0.4 m, seen head-on [m]; Nguyen: 0.0012. Where it is not 0 it grows
    as axial + axial_growth (z - 0.4)^2, and past 60 degrees by
    0.0001 / sqrt(z) * angle^2 / (pi/2 - angle)^2."""
    axial_growth: float = 0.0
    """Growth of the axial sd with distance [1/m]; Nguyen: 0.0019."""
    disparity: float = 0.0
    """Sd of the error of the disparity fx baseline / z [pixel], so that the depth error grows as
    disparity z^2 / (fx baseline). Intel: 0.08 for a well-textured surface, the projector's dots
    included."""
    disparity_step: float = 0.0
    """Step of the disparity [pixel]. Matchers that interpolate between pixels reach 1/32 (Intel's
    white paper "Subpixel linearity improvement for D400")."""
    fattening: int = 0
    """Pixels by which near surfaces grow over far ones: a matched block that straddles an edge
    takes the disparity of the side with more contrast, mostly the near one."""
    correlation: float = 0.0
    """Sd of the Gaussian over which neighbouring errors agree [pixel]: a pattern is matched over a
    window, so that neighbours share their error."""
    grazing: tuple[float, float] = (np.pi / 2, np.pi / 2)
    """Angle from which readings start to fail, and at which none is left [rad]. Nguyen gets no
    reliable readings beyond about 80 degrees."""
    flying_share: float = 0.0
    """Share of the pixels at depth edges that read something between front and back."""
    flying_step: float = 0.01
    """Depth step that counts as an edge for flying pixels [m]."""
    baseline: float = 0.0
    """Distance of the pattern projector, or of the second camera, from the camera along +x [m]:
    what it cannot see has no reading."""
    hole_share: float = 0.0
    """Share of the image that is lost in blobs (reflections, dark spots)."""
    hole_size: float = 3.0
    """Sd of the Gaussian that shapes the blobs [pixel]."""


PERFECT = SensorModel()
"""Only quantised, to 0.1 mm: the paper's simulated images."""

STRUCTURED_LIGHT = SensorModel(
    quantisation=0.001,
    lateral=0.8,
    axial=0.0012,
    axial_growth=0.0019,
    correlation=1.0,
    grazing=(np.radians(65), np.radians(82)),
    flying_share=0.3,
    baseline=0.05,
    hole_share=0.01,
)
"""A structured-light camera at close range: Nguyen's noise; reads whole millimetres, as the
cameras of this kind do; a 50 mm baseline (shorter than the Kinect's 75 mm) and the rest are choices
of ours."""

ACTIVE_STEREO = SensorModel(
    quantisation=0.001,
    lateral=0.5,
    disparity=0.08,
    disparity_step=1 / 32,
    fattening=1,
    correlation=2.0,
    grazing=(np.radians(72), np.radians(86)),
    flying_share=0.15,
    baseline=0.05,
    hole_share=0.005,
)
"""Two infrared cameras and a dot projector: disparity errors as Intel states them, the 50 mm
baseline and 1 mm steps of the RealSense D435. Matching over a block makes errors smoother and edges
fatter than structured light's, and needs less light back from a grazing surface; how much so are
choices of ours."""

SENSORS = {"none": PERFECT, "structured_light": STRUCTURED_LIGHT, "active_stereo": ACTIVE_STEREO}
"""The sensor models by name."""


def observe(
    depth: NDArray[np.float32], camera: Camera, model: SensorModel, rng: np.random.Generator
) -> NDArray[np.float32]:
    """The depth image that a real sensor reads where `depth` is the truth.

    Args:
        depth: true depth z [m], shape (H, W), 0 where there is no surface.
        camera: the camera that sees it.
        model: the sensor's errors.
        rng: source of the errors.

    Returns:
        Depth z [m], shape (H, W), 0 where there is no reading.
    """
    reading = np.zeros(depth.shape)
    seen = _bounds(depth > 0)
    if seen is None:
        return reading.astype(np.float32)
    rows, columns = seen
    window = camera.crop(
        columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start
    )
    reading[seen] = _observed(np.ascontiguousarray(depth[seen], np.float32), window, model, rng)
    steps = np.rint(np.maximum(reading, 0.0) / model.quantisation)
    return np.asarray(steps * model.quantisation, dtype=np.float32)


def _observed(true: Image, camera: Camera, model: SensorModel, rng: np.random.Generator) -> Image:
    """The reading before quantisation [m], 0 where there is none."""
    if model == SensorModel(model.quantisation):
        return true
    surface = _fattened(true, model.fattening)
    angle = incidence_angle(surface, camera)
    reading = _displaced(surface, angle, model, rng)
    if model.axial > 0:
        noise = _noise(surface.shape, model, rng)
        reading += (reading > 0) * _axial_sd(reading, angle, model) * noise
    if model.disparity > 0:
        reading = _through_disparity(reading, camera, model, rng)
    reading = _with_flying_pixels(reading, model, rng)
    start, end = model.grazing
    lost = rng.random(surface.shape, np.float32) * (end - start) < angle - start
    lost |= _in_projector_shadow(surface, camera, model.baseline)
    lost |= _holes(surface.shape, model, rng)
    reading[lost | (surface == 0)] = 0.0
    return reading


def _bounds(shown: NDArray[np.bool_]) -> tuple[slice, slice] | None:
    """Rows and columns from the first to the last marked pixel; None when none is marked."""
    rows, columns = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))
    if not len(rows):
        return None
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


def perturb_wrist(
    T: NDArray[np.float64],
    sd_translation: float,
    sd_rotation: float,
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """The wrist pose as imprecise forward kinematics would tell it.

    Args:
        T: true pose `T_camera_hand`, shape (4, 4).
        sd_translation: standard deviation of the shift along each camera axis [m].
        sd_rotation: standard deviation of the rotation about each camera axis through the wrist's
            own origin [rad].
        rng: source of the errors.
    """
    error = rng.normal(size=6) * ([sd_rotation] * 3 + [sd_translation] * 3)
    perturbed = T.copy()
    perturbed[:3, :3] = se3.exp_so3(error[:3]) @ T[:3, :3]
    perturbed[:3, 3] += error[3:]
    return perturbed


def incidence_angle(depth: Image, camera: Camera) -> Image:
    """Angle between line of sight and surface normal [rad], shape (H, W); pi/2 without surface."""
    angle = wp.empty(depth.size, dtype=float, device="cpu")
    image = wp.array(depth, dtype=float, device="cpu")
    inputs = [pinhole(camera), image, angle]
    launch(incidence_angles, depth.size, inputs, "cpu", work_per_item=10)
    return np.asarray(angle.numpy().reshape(depth.shape))


def smooth_noise(shape: tuple[int, ...], sd: float, rng: np.random.Generator) -> Image:
    """Gaussian noise of unit variance, smoothed with a Gaussian of `sd` [pixel], of this shape."""
    white = rng.standard_normal(shape, np.float32)
    if sd == 0:
        return white
    impulse = np.zeros(8 * int(np.ceil(sd)) + 1)
    impulse[len(impulse) // 2] = 1.0
    gain = np.sum(gaussian_filter(impulse, sd) ** 2)  # along each of the two axes
    return np.asarray(gaussian_filter(white, sd, mode="wrap") / np.float32(gain))


def _noise(shape: tuple[int, ...], model: SensorModel, rng: np.random.Generator) -> Image:
    """Gaussian noise of unit variance, over which neighbours agree as the model says."""
    return smooth_noise(shape, model.correlation, rng)


def _fattened(depth: Image, pixels: int) -> Image:
    """Near surfaces grown over what is behind them."""
    if pixels == 0:
        return depth
    near = minimum_filter(np.where(depth > 0, depth, np.inf), 2 * pixels + 1)
    return np.where(np.isfinite(near), near, 0).astype(np.float32)


def _displaced(depth: Image, angle: Image, model: SensorModel, rng: np.random.Generator) -> Image:
    """Every pixel reads the depth of a pixel nearby."""
    if model.lateral == 0:
        return depth.copy()
    sd = model.lateral + np.float32(0.035) * angle / np.maximum(np.pi / 2 - angle, 0.05)
    height, width = depth.shape
    v, u = np.ogrid[:height, :width]
    source_u = np.rint(u + sd * _noise(depth.shape, model, rng)).astype(np.int32)
    source_v = np.rint(v + sd * _noise(depth.shape, model, rng)).astype(np.int32)
    return depth[np.clip(source_v, 0, height - 1), np.clip(source_u, 0, width - 1)]


def _axial_sd(depth: Image, angle: Image, model: SensorModel) -> Image:
    slant = np.maximum(np.pi / 2 - angle, 0.05)
    steep = 0.0001 / np.sqrt(np.maximum(depth, 0.05)) * (angle / slant) ** 2
    sd = model.axial + model.axial_growth * (depth - 0.4) ** 2
    return np.asarray(sd + np.where(angle > np.pi / 3, steep, 0.0))


def _through_disparity(
    depth: Image, camera: Camera, model: SensorModel, rng: np.random.Generator
) -> Image:
    """Depth from a disparity with errors, in steps."""
    unit = camera.fx * model.baseline
    with np.errstate(divide="ignore"):
        disparity = unit / depth + np.float32(model.disparity) * _noise(depth.shape, model, rng)
        if model.disparity_step > 0:
            disparity = np.rint(disparity / model.disparity_step) * model.disparity_step
        return np.asarray(np.where(disparity > 0, unit / disparity, 0), dtype=np.float32)


def _with_flying_pixels(reading: Image, model: SensorModel, rng: np.random.Generator) -> Image:
    """The reading, where some pixels at depth edges read something in between."""
    if model.flying_share == 0:
        return reading
    near = minimum_filter(np.where(reading > 0, reading, np.inf), 3)
    far = maximum_filter(reading, 3)
    flying = (reading > 0) & (far - near > model.flying_step)
    flying &= rng.random(reading.shape, np.float32) < model.flying_share
    reading[flying] = near[flying] + rng.random(flying.sum()) * (far - near)[flying]
    return reading


def _in_projector_shadow(depth: Image, camera: Camera, baseline: float) -> NDArray[np.bool_]:
    """Pixels whose surface a projector at +x of the camera cannot reach.

    Along an image row, a point at column u is lit by the projector's column u - fx baseline / z.
    What blocks the light lies to the right; so a point is dark when some point to its right is lit
    by the same or an earlier projector column. (Background that shows on the wrong side of a
    narrow object breaks the order and counts as dark, as it does for real matchers.)
    """
    if baseline == 0:
        return np.zeros(depth.shape, dtype=bool)
    u = np.arange(depth.shape[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        column = np.where(depth > 0, u - camera.fx * baseline / depth, np.inf)
    earliest_from_right = np.minimum.accumulate(column[:, ::-1], axis=1)[:, ::-1]
    return np.asarray((depth > 0) & (column > earliest_from_right))


def _holes(
    shape: tuple[int, ...], model: SensorModel, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Blobs that cover the given share of the image."""
    if model.hole_share == 0:
        return np.zeros(shape, dtype=bool)
    return smooth_noise(shape, model.hole_size, rng) > -float(ndtri(model.hole_share))
