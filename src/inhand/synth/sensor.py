"""What a depth camera makes of a perfect depth image, and how wrongly the wrist is known."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter
from scipy.special import ndtri

from inhand.camera import Camera
from inhand.geometry import se3

Image = NDArray[np.float64]


@dataclass(frozen=True)
class SensorModel:
    """Errors of a depth camera; a field at 0 switches its error off.

    "Nguyen" is Nguyen, Izadi and Lovell, "Modeling Kinect Sensor Noise for Improved 3D
    Reconstruction and Tracking", 3DIMPVT 2012. Angles are between the line of sight and the
    surface normal. Fields without a source are choices of ours.
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
    """Distance of the pattern projector from the camera along +x [m]: what it cannot see has no
    reading."""
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
"""A structured-light camera at close range, with Nguyen's noise and a shorter, 50 mm baseline."""


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
    true = np.asarray(depth, dtype=np.float64)
    angle = incidence_angle(true, camera)
    reading = _displaced(true, angle, model, rng)
    reading += (
        (reading > 0)
        * _axial_sd(reading, angle, model)
        * _noise(true.shape, model.correlation, rng)
    )
    flying, between = _flying_pixels(true, model, rng)
    reading[flying] = between[flying]
    start, end = model.grazing
    lost = rng.random(true.shape) * (end - start) < angle - start
    lost |= _in_projector_shadow(true, camera, model.baseline)
    lost |= _holes(true.shape, model, rng)
    reading[lost | (true == 0)] = 0.0
    steps = np.rint(np.maximum(reading, 0.0) / model.quantisation)
    return np.asarray(steps * model.quantisation, dtype=np.float32)


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
    """Angle between line of sight and surface normal [rad], shape (H, W); pi/2 without surface.

    From differences to the neighbours that are nearer in depth, so that a depth edge is not taken
    for a grazing surface.
    """
    v, u = np.indices(depth.shape)
    rays = np.stack(
        [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(depth)], axis=-1
    )
    points = np.where(depth > 0, depth, np.nan)[..., None] * rays
    normals = np.cross(_smaller_step(points, axis=1), _smaller_step(points, axis=0))
    lengths = np.linalg.norm(normals, axis=-1) * np.linalg.norm(rays, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = np.abs(np.sum(normals * rays, axis=-1)) / lengths
    return np.asarray(np.arccos(np.clip(np.nan_to_num(cosine), 0.0, 1.0)))


def _smaller_step(points: Image, axis: int) -> Image:
    """Difference to the next or previous point, whichever changes depth less; NaN if none."""
    forward = np.full_like(points, np.nan)
    step = np.diff(points, axis=axis)
    ahead, behind = [slice(None)] * 2, [slice(None)] * 2
    ahead[axis], behind[axis] = slice(None, -1), slice(1, None)
    backward = forward.copy()
    forward[tuple(ahead)], backward[tuple(behind)] = step, step
    size = [np.nan_to_num(np.abs(d[..., 2]), nan=np.inf) for d in (forward, backward)]
    return np.where((size[0] <= size[1])[..., None], forward, backward)


def _noise(shape: tuple[int, ...], sd: float, rng: np.random.Generator) -> Image:
    """Gaussian noise of unit variance, smoothed with a Gaussian of `sd` [pixel]."""
    white = rng.normal(size=shape)
    if sd == 0:
        return white
    impulse = np.zeros((8 * int(np.ceil(sd)) + 1,) * 2)
    impulse[tuple(np.array(impulse.shape) // 2)] = 1.0
    gain = np.linalg.norm(gaussian_filter(impulse, sd))
    return np.asarray(gaussian_filter(white, sd, mode="wrap") / gain)


def _displaced(depth: Image, angle: Image, model: SensorModel, rng: np.random.Generator) -> Image:
    """Every pixel reads the depth of a pixel nearby."""
    if model.lateral == 0:
        return depth.copy()
    sd = model.lateral + 0.035 * angle / np.maximum(np.pi / 2 - angle, 0.05)
    v, u = np.indices(depth.shape)
    source_u = np.rint(u + sd * _noise(depth.shape, model.correlation, rng)).astype(int)
    source_v = np.rint(v + sd * _noise(depth.shape, model.correlation, rng)).astype(int)
    height, width = depth.shape
    return depth[np.clip(source_v, 0, height - 1), np.clip(source_u, 0, width - 1)]


def _axial_sd(depth: Image, angle: Image, model: SensorModel) -> Image:
    if model.axial == 0:
        return np.zeros_like(depth)
    slant = np.maximum(np.pi / 2 - angle, 0.05)
    steep = 0.0001 / np.sqrt(np.maximum(depth, 0.05)) * (angle / slant) ** 2
    sd = model.axial + model.axial_growth * (depth - 0.4) ** 2
    return np.asarray(sd + np.where(angle > np.pi / 3, steep, 0.0))


def _flying_pixels(
    depth: Image, model: SensorModel, rng: np.random.Generator
) -> tuple[NDArray[np.bool_], Image]:
    """Which pixels fly, and the depth [m] they read: between the surfaces at a depth edge."""
    near = minimum_filter(np.where(depth > 0, depth, np.inf), 3)
    far = maximum_filter(depth, 3)
    edge = (depth > 0) & (far - near > model.flying_step)
    flying = edge & (rng.random(depth.shape) < model.flying_share)
    with np.errstate(invalid="ignore"):
        between = near + rng.random(depth.shape) * (far - near)
    return flying, between


def _in_projector_shadow(depth: Image, camera: Camera, baseline: float) -> NDArray[np.bool_]:
    """Pixels whose surface a projector at +x of the camera cannot reach.

    Along an image row, a point at column u is lit by the projector's column u - fx baseline / z.
    What blocks the light lies to the right; so a point is dark when some point to its right is lit
    by the same or an earlier projector column. (Background that shows on the wrong side of a
    narrow object breaks the order and counts as dark, as it does for real matchers.)
    """
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
    return _noise(shape, model.hole_size, rng) > -float(ndtri(model.hole_share))
