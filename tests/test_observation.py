from dataclasses import replace

import numpy as np
import pytest
from held_object import CAMERA, HeldObject, built_in_hand, held_object
from reference_depth import plane_depth, rays
from scipy.ndimage import binary_dilation, binary_erosion, gaussian_filter

from inhand.camera import Camera
from inhand.config import ObservationConfig
from inhand.errors import NoAnswer
from inhand.geometry.se3 import exp, transform
from inhand.stages.observation import Observation, observe

CONFIG = ObservationConfig()
SIZE = 0.06
"""Diameter of the object [m]."""


def seen(
    depth: np.ndarray,
    T_camera_hand: np.ndarray,
    camera: Camera = CAMERA,
    config: ObservationConfig = CONFIG,
) -> Observation:
    image = depth.astype(np.float32)
    reach = built_in_hand().hand.reach
    return observe(image, camera, T_camera_hand, reach, SIZE, config, "cpu")


def scene_of(name: str = "cuboid") -> tuple[HeldObject, np.ndarray]:
    scene = held_object(name)
    return scene, scene.hand_state.T_camera_hand


def test_the_region_is_a_window_of_the_image() -> None:
    scene, T = scene_of()
    found = seen(scene.depth, T)
    u0, v0 = found.offset
    height, width = found.depth.shape
    assert (found.camera.width, found.camera.height) == (width, height)
    np.testing.assert_array_equal(found.depth, scene.depth[v0 : v0 + height, u0 : u0 + width])
    np.testing.assert_array_equal(found.view.depth.numpy(), found.depth.reshape(-1))
    np.testing.assert_allclose(
        rays(found.camera), rays(CAMERA)[v0 : v0 + height, u0 : u0 + width], atol=1e-12
    )
    np.testing.assert_array_equal(found.T_camera_hand, T)


@pytest.mark.parametrize("turn", [(0, 0, 0), (1, 2, 0), (0.5, -1, 2)])
@pytest.mark.parametrize("place", [(0, 0, 0.6), (0.3, -0.2, 0.8), (-0.1, 0.05, 0.35)])
def test_the_region_holds_the_hand_in_every_configuration(
    turn: tuple[float, ...], place: tuple[float, ...]
) -> None:
    hand, camera = built_in_hand(), Camera(400, 400, 319.5, 239.5, 640, 480)
    T = exp(np.array([*turn, *place]))
    found = seen(plane_depth(camera, np.array([0, 0, 1.0]), place[2]), T, camera)
    q = np.random.default_rng(0).uniform(hand.hand.lower, hand.hand.upper, (20, 4))
    poses = hand.link_poses(q, np.repeat(T[None], 20, axis=0))
    points = np.concatenate(
        [
            transform(p, x.surface.points)
            for row in poses
            for p, x in zip(row, hand.hand.links, strict=True)
        ]
    )
    u, v = camera.project(points[points[:, 2] > 0.05]).T
    inside = (u > 0) & (u < camera.width - 1) & (v > 0) & (v < camera.height - 1)
    u0, v0 = found.offset
    in_region = (u > u0 - 1) & (u < u0 + found.camera.width)
    in_region &= (v > v0 - 1) & (v < v0 + found.camera.height)
    assert inside.any()
    assert in_region[inside].all()


def test_points_lie_on_the_surfaces_with_their_normals() -> None:
    scene, T = scene_of("industrial_part")
    found = seen(scene.depth, T, config=replace(CONFIG, normal_window=0.002))
    meshes = [*(x.distance_field for x in scene.hand.hand.links), scene.obj.model.distance_field]
    poses = [*scene.hand_state.T_camera_link, scene.T_camera_object]
    distance = np.min(
        [
            np.abs(f.distance((found.points - p[:3, 3]) @ p[:3, :3]))
            for f, p in zip(meshes, poses, strict=True)
        ],
        axis=0,
    )
    assert np.median(distance) < 1e-4
    assert np.percentile(distance, 95) < 1e-3
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1, atol=1e-5)
    view = found.points / np.linalg.norm(found.points, axis=1, keepdims=True)
    assert ((found.normals * view).sum(axis=1) < 0).mean() > 0.99


def test_the_cloud_is_an_even_subset_of_all_pixels() -> None:
    scene, T = scene_of()
    found = seen(scene.depth, T)
    everything = {p.tobytes() for p in found.cloud(step=1).points}
    assert len(everything) == len(found.cloud(step=1).points)
    assert all(p.tobytes() in everything for p in found.points)
    coarse = seen(scene.depth, T, config=replace(CONFIG, point_spacing=2 * CONFIG.point_spacing))
    assert 3 < len(found.points) / len(coarse.points) < 5
    # A grid of pixels at about the wanted distance.
    pixel = float(np.median(found.points[:, 2])) / CAMERA.fx
    for coordinate in np.rint(found.camera.project(found.points)).T:
        step = int(np.diff(np.unique(coordinate)).min())
        assert step * pixel == pytest.approx(CONFIG.point_spacing, abs=0.6 * pixel)


def test_a_part_of_the_cloud_is_the_whole_one_in_the_rectangle_of_the_image() -> None:
    scene, T = scene_of()
    found = seen(scene.depth, T)
    whole = found.cloud(step=1)
    pixels = found.camera.project(whole.points)
    u, v = np.median(pixels, axis=0)
    around = whole.points[(np.abs(pixels - (u, v)) < 12).all(axis=1)]
    reached = found.camera.project(around)
    wide = (pixels >= reached.min(axis=0) - found.step - 0.5) & (
        pixels <= reached.max(axis=0) + found.step + 0.5
    )
    part = found.cloud(1, around)
    assert len(around) < len(part.points) < len(whole.points) / 4
    np.testing.assert_array_equal(part.points, whole.points[wide.all(axis=1)])
    np.testing.assert_array_equal(part.normals, whole.normals[wide.all(axis=1)])


def test_what_is_behind_the_hand_stays_in_the_image_but_not_in_the_cloud() -> None:
    scene, T = scene_of()
    wall = np.where(scene.depth > 0, scene.depth, 3.0)
    found, without = seen(wall, T), seen(scene.depth, T)
    assert (found.depth > 2).sum() == (without.depth == 0).sum()
    assert found.points[:, 2].max() < 1
    assert len(found.points) <= len(without.points)
    assert (found.view.missing.numpy() == 0).all()
    assert (without.view.missing.numpy() > 0).any()


def test_nan_infinity_and_zero_are_no_reading() -> None:
    scene, T = scene_of()
    kinds = np.random.default_rng(0).integers(0, 4, scene.depth.shape)
    nothing = scene.depth == 0
    spoilt = scene.depth.copy()
    for kind, value in enumerate((np.nan, np.inf, -np.inf, 0.0)):
        spoilt[nothing & (kinds == kind)] = value
    found, expected = seen(spoilt, T), seen(scene.depth, T)
    np.testing.assert_array_equal(found.depth, expected.depth)
    np.testing.assert_array_equal(found.points, expected.points)
    np.testing.assert_array_equal(found.normals, expected.normals)


def test_the_image_is_left_as_it_was() -> None:
    scene, T = scene_of()
    spoilt = np.where(scene.depth == 0, np.nan, scene.depth).astype(np.float32)
    before = spoilt.copy()
    seen(spoilt, T)
    np.testing.assert_array_equal(spoilt, before)


@pytest.mark.parametrize(
    ("T_camera_hand", "message"),
    [
        (exp(np.array([0, 0, 0, 0, 0, -0.5])), "behind the camera"),
        (exp(np.array([0, 0, 0, 3.0, 0, 0.5])), "outside the image"),
        (exp(np.array([0, 0, 0, 0, 0, 100.0])), "too far away"),
        (exp(np.array([0, 0, 0, 0, 0, 1.5])), "depth readings lie in the region"),
    ],
)
def test_a_hand_that_cannot_be_seen_is_no_answer(T_camera_hand: np.ndarray, message: str) -> None:
    scene, _ = scene_of()
    with pytest.raises(NoAnswer, match=message):
        seen(scene.depth, T_camera_hand)


def test_an_empty_image_is_no_answer() -> None:
    scene, T = scene_of()
    with pytest.raises(NoAnswer, match="only 0 depth readings"):
        seen(np.zeros_like(scene.depth), T)


def test_readings_without_neighbours_are_no_answer() -> None:
    scene, T = scene_of()
    speckles = np.zeros_like(scene.depth)
    speckles[::8, ::8] = 0.5
    with pytest.raises(NoAnswer, match="readings"):
        seen(speckles, T)


@pytest.mark.parametrize("lost", [0.3, 0.7])
def test_readings_that_are_missing_everywhere_are_no_sign_of_empty_space(lost: float) -> None:
    """A wall with a hole in it, of which readings are missing all over."""
    _, T = scene_of()
    wall = plane_depth(CAMERA, np.array([0, 0, 1.0]), T[2, 3])
    hole = np.zeros(wall.shape, dtype=bool)
    v0, u0 = (size // 2 - 30 for size in wall.shape)
    hole[v0 : v0 + 60, u0 : u0 + 60] = True
    missing = hole | (np.random.default_rng(0).random(wall.shape) < lost)
    found = seen(np.where(missing, 0, wall), T)
    share = found.view.missing.numpy().reshape(found.depth.shape)
    (u, v), (height, width) = found.offset, found.depth.shape
    hole = hole[v : v + height, u : u + width]
    inside, around = binary_erosion(hole, iterations=10), ~binary_dilation(hole, iterations=10)
    assert inside.any()
    assert (share[inside] == 1).all()
    assert share[around & (found.depth == 0)].mean() < 0.15


@pytest.mark.parametrize("sd", [0.0, 0.001, 0.005])
@pytest.mark.parametrize("pixels", [0.0, 1.0], ids=["white", "smooth"])
def test_the_noise_is_estimated_from_the_image(sd: float, pixels: float) -> None:
    """On a tilted plane, with noise that neighbouring pixels share or do not, and on a hand.

    How a surface bends within a few pixels cannot be told from noise.
    """
    scene, T = scene_of("ellipsoid")
    tilted = plane_depth(CAMERA, np.array([0.4, 0.3, np.sqrt(0.75)]), T[2, 3])
    white = np.random.default_rng(0).normal(size=tilted.shape)
    noise = gaussian_filter(white, pixels) if pixels else white
    noise *= sd / noise.std()
    # Noise smoothed by one pixel still agrees by exp(-9 / 4) over three.
    expected = sd * np.sqrt(1 - 4 / 3 * np.exp(-9 / 4)) if pixels else sd
    assert seen(tilted + noise, T).noise == pytest.approx(expected, rel=0.05, abs=1e-5)
    on_hand = seen(np.where(scene.depth > 0, scene.depth + noise, 0), T).noise
    assert 0.85 * sd < on_hand < 1.15 * sd + 0.0005
