"""The sensor model's errors have the sizes its fields state."""

from dataclasses import fields, replace

import numpy as np
import pytest

from inhand.camera import Camera
from inhand.geometry import se3
from inhand.synth.sensor import (
    ACTIVE_STEREO,
    PERFECT,
    STRUCTURED_LIGHT,
    SensorModel,
    incidence_angle,
    observe,
    perturb_wrist,
)

CAMERA = Camera(fx=600, fy=600, cx=159.5, cy=119.5, width=320, height=240)
FINE = SensorModel(quantisation=1e-7)


def wall(z: float, tilt: float = 0.0) -> np.ndarray:
    """Depth of a wall at depth `z` [m] on the optical axis, turned by `tilt` [rad] about y."""
    u = np.arange(CAMERA.width) - CAMERA.cx
    row = z / (1 - np.tan(tilt) * u / CAMERA.fx)
    return np.tile(row, (CAMERA.height, 1)).astype(np.float32)


def step(near: float, far: float) -> np.ndarray:
    """A near surface over the right half of the image before a far one."""
    depth = wall(far)
    depth[:, CAMERA.width // 2 :] = near
    return depth


def read(depth: np.ndarray, model: SensorModel, seed: int = 0) -> np.ndarray:
    return observe(depth, CAMERA, model, np.random.default_rng(seed))


def test_a_perfect_sensor_only_quantises() -> None:
    depth = wall(0.51234567, tilt=0.5)
    reading = read(depth, PERFECT)
    assert reading.dtype == np.float32
    assert np.abs(reading - depth).max() <= 0.00005 + 1e-7
    assert np.abs(reading / 0.0001 - np.rint(reading / 0.0001)).max() < 1e-3


def test_structured_light_reads_whole_millimetres() -> None:
    reading = read(wall(0.5, tilt=0.3), STRUCTURED_LIGHT)
    assert np.abs(reading * 1000 - np.rint(reading * 1000)).max() < 1e-3


def test_no_surface_gives_no_reading() -> None:
    depth = step(0.4, 0.6)
    depth[:60] = 0
    assert (read(depth, STRUCTURED_LIGHT)[:60] == 0).all()
    assert (read(np.zeros_like(depth), STRUCTURED_LIGHT) == 0).all()


@pytest.mark.parametrize("z", [0.3, 0.4, 0.9, 1.5])
def test_axial_noise_grows_as_nguyen_measured(z: float) -> None:
    model = replace(FINE, axial=0.0012, axial_growth=0.0019)
    errors = read(wall(z), model) - wall(z)
    assert errors.std() == pytest.approx(0.0012 + 0.0019 * (z - 0.4) ** 2, rel=0.02)
    assert abs(errors.mean()) < 3e-5


def test_axial_noise_grows_at_grazing_angles() -> None:
    model = replace(FINE, axial=0.0012)
    angle = np.radians(72)
    depth = wall(0.5, tilt=angle)
    column = np.array([CAMERA.width // 2])
    errors = np.concatenate([(read(depth, model, s) - depth)[:, column] for s in range(20)])
    expected = 0.0012 + 0.0001 / np.sqrt(0.5) * (angle / (np.pi / 2 - angle)) ** 2
    assert errors.std() == pytest.approx(expected, rel=0.05)


def test_correlated_noise_keeps_its_size_and_reaches_the_neighbours() -> None:
    model = replace(FINE, axial=0.0012, correlation=1.5)
    errors = np.stack([read(wall(0.4), model, s) - 0.4 for s in range(4)])
    assert errors.std() == pytest.approx(0.0012, rel=0.03)
    shared = np.mean(errors[..., 1:] * errors[..., :-1]) / errors.var()
    # Two Gaussians of sd s, d apart, overlap by exp(-d^2 / (4 s^2)).
    assert shared == pytest.approx(np.exp(-1 / (4 * 1.5**2)), abs=0.03)


def test_lateral_noise_moves_readings_sideways() -> None:
    depth = wall(0.5, tilt=0.6)
    slope = np.gradient(depth[0])
    moved = (read(depth, replace(FINE, lateral=0.8)) - depth) / slope
    inner = moved[:, 20:-20]
    angle = incidence_angle(depth, CAMERA)[:, 20:-20]
    sd = 0.8 + 0.035 * angle / (np.pi / 2 - angle)
    rounding = 1 / 12
    assert inner.std() == pytest.approx(np.sqrt(np.mean(sd**2) + rounding), rel=0.03)


@pytest.mark.parametrize("tilt", [0.0, 0.4, 1.0])
def test_incidence_angle_of_a_tilted_wall(tilt: float) -> None:
    angle = incidence_angle(wall(0.5, tilt).astype(np.float64), CAMERA)
    assert angle[CAMERA.height // 2, CAMERA.width // 2] == pytest.approx(tilt, abs=0.005)


def test_a_depth_edge_is_not_a_grazing_surface() -> None:
    assert incidence_angle(step(0.4, 0.6).astype(np.float64), CAMERA).max() < 0.4


def test_grazing_surfaces_drop_out_linearly() -> None:
    model = replace(FINE, grazing=(np.radians(60), np.radians(80)))
    for degrees, expected in ((50, 0.0), (70, 0.5), (85, 1.0)):
        depth = wall(0.5, np.radians(degrees))
        middle = slice(CAMERA.width // 2 - 4, CAMERA.width // 2 + 4)
        lost = [(read(depth, model, s)[:, middle] == 0).mean() for s in range(5)]
        assert np.mean(lost) == pytest.approx(expected, abs=0.04)


def test_flying_pixels_lie_between_the_surfaces_at_an_edge() -> None:
    reading = read(step(0.4, 0.6), replace(FINE, flying_share=0.3))
    half = CAMERA.width // 2
    at_edge, elsewhere = reading[:, half - 1 : half + 1], np.delete(reading, (half - 1, half), 1)
    assert np.isin(elsewhere, np.array([0.4, 0.6], dtype=np.float32)).all()
    flying = (at_edge > 0.4001) & (at_edge < 0.5999)
    assert flying.mean() == pytest.approx(0.3, abs=0.05)


def test_projector_shadow_has_the_width_of_triangulation() -> None:
    baseline, near, far = 0.05, 0.4, 0.6
    model = replace(FINE, baseline=baseline)
    dark = read(step(near, far), model) == 0
    width = CAMERA.fx * baseline * (1 / near - 1 / far)
    # The projector stands to the right: the shadow falls to the left of the near surface.
    assert dark.sum(axis=1) == pytest.approx(width, abs=1.01)
    columns = np.flatnonzero(dark[0])
    assert columns.max() == CAMERA.width // 2 - 1
    assert np.ptp(columns) + 1 == len(columns)
    assert not (read(wall(0.5, tilt=0.7), model) == 0).any()
    mirrored = read(step(near, far)[:, ::-1], model)
    assert (mirrored > 0).all()


def test_holes_cover_their_share_in_blobs() -> None:
    model = replace(FINE, hole_share=0.05, hole_size=3.0)
    lost = np.stack([read(wall(0.5), model, s) == 0 for s in range(8)])
    assert lost.mean() == pytest.approx(0.05, abs=0.01)
    neighbour_too = (lost[..., 1:] & lost[..., :-1]).sum() / lost.sum()
    assert neighbour_too > 0.7


def test_structured_light_keeps_most_of_a_plain_surface() -> None:
    reading = read(wall(0.5, tilt=0.3), STRUCTURED_LIGHT)
    assert (reading > 0).mean() > 0.98
    assert np.median(np.abs(reading - wall(0.5, tilt=0.3))[reading > 0]) < 0.002


def test_a_seed_makes_a_reading_repeatable() -> None:
    depth = step(0.4, 0.6)
    np.testing.assert_array_equal(read(depth, STRUCTURED_LIGHT), read(depth, STRUCTURED_LIGHT))
    assert (read(depth, STRUCTURED_LIGHT, 1) != read(depth, STRUCTURED_LIGHT, 2)).any()


def test_structured_light_has_every_error() -> None:
    changed = [
        f.name for f in fields(SensorModel) if f.default != getattr(STRUCTURED_LIGHT, f.name)
    ]
    stereo = {"disparity", "disparity_step", "fattening"}
    everything = {f.name for f in fields(SensorModel)}
    assert set(changed) == everything - {"flying_step", "hole_size"} - stereo


def test_active_stereo_has_its_errors() -> None:
    changed = {f.name for f in fields(SensorModel) if f.default != getattr(ACTIVE_STEREO, f.name)}
    assert changed == {f.name for f in fields(SensorModel)} - {
        *("axial", "axial_growth", "flying_step", "hole_size")
    }


@pytest.mark.parametrize("z", [0.3, 0.6, 1.2])
def test_disparity_errors_grow_with_the_square_of_depth(z: float) -> None:
    model = replace(FINE, baseline=0.05, disparity=0.08)
    errors = read(wall(z), model)[:, 40:] - np.float32(z)
    assert errors.std() == pytest.approx(0.08 * z**2 / (CAMERA.fx * 0.05), rel=0.03)
    assert abs(errors.mean()) < 0.1 * errors.std()


def test_disparity_comes_in_steps() -> None:
    model = replace(FINE, baseline=0.05, disparity=0.08, disparity_step=1 / 32)
    reading = read(wall(0.5, tilt=0.5), model)
    disparity = CAMERA.fx * 0.05 / reading[reading > 0]
    assert np.abs(32 * disparity - np.rint(32 * disparity)).max() < 2e-3
    assert len(np.unique(np.rint(32 * disparity))) > 100


def test_near_surfaces_grow_over_far_ones() -> None:
    depth = step(0.4, 0.6)
    depth[:100] = 0
    half = CAMERA.width // 2
    reading = read(depth, replace(FINE, fattening=2))
    assert (reading[110:, half - 2 :] == np.float32(0.4)).all()
    np.testing.assert_allclose(reading[110:, : half - 2], 0.6, atol=1e-6)


def test_active_stereo_keeps_most_of_a_plain_surface() -> None:
    errors = read(wall(0.5, tilt=0.3), ACTIVE_STEREO)[:, 60:] - wall(0.5, tilt=0.3)[:, 60:]
    seen = errors > -0.1
    assert seen.mean() > 0.97
    assert np.median(np.abs(errors[seen])) < 0.001


def test_wrist_errors_have_the_stated_deviations() -> None:
    rng = np.random.default_rng(0)
    T = se3.exp(np.array([0.3, -0.8, 1.1, 0.1, -0.05, 0.6]))
    given = np.stack([perturb_wrist(T, 0.004, np.radians(1.5), rng) for _ in range(4000)])
    shifts = given[:, :3, 3] - T[:3, 3]
    np.testing.assert_allclose(shifts.std(axis=0), 0.004, rtol=0.05)
    np.testing.assert_allclose(shifts.mean(axis=0), 0, atol=3e-4)
    turns = given[:, :3, :3] @ T[:3, :3].T
    vectors = np.stack([turns[:, 2, 1], turns[:, 0, 2], turns[:, 1, 0]], axis=1)
    np.testing.assert_allclose(vectors.std(axis=0), np.radians(1.5), rtol=0.05)
    for pose in given[:5]:
        se3.check_rigid(pose, "perturbed")
    np.testing.assert_allclose(perturb_wrist(T, 0, 0, rng), T, atol=1e-12)
