import numpy as np
import pytest
from held_object import built_in_hand
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation, binary_erosion

from inhand.camera import Camera
from inhand.geometry.se3 import exp, random_rotation
from inhand.kernels.depth import DepthRenderer
from inhand.kernels.launch import on_host

CAMERA = Camera(fx=260, fy=240, cx=80.3, cy=57.8, width=161, height=117)


def posed(seed: int, distance: float) -> np.ndarray:
    """Link poses of the built-in hand, turned any way, around a point of the optical axis."""
    rng, hand = np.random.default_rng(seed), built_in_hand().hand
    T = np.eye(4)
    T[:3, :3] = random_rotation(rng)
    T[:3, 3] = [0, 0, distance] - T[:3, :3] @ [0, 0, 0.06] + rng.normal(0, 0.05, 3)
    q = rng.uniform(hand.lower, hand.upper)
    return built_in_hand().link_poses(q[None], T[None])[0]


def ray_cast(T_camera_link: np.ndarray, shown: np.ndarray) -> np.ndarray:
    meshes = [x.mesh for x, yes in zip(built_in_hand().hand.links, shown, strict=True) if yes]
    return DepthRenderer(meshes).render(CAMERA, T_camera_link[shown])[0]


def traced(T_camera_link: np.ndarray, shown: np.ndarray) -> np.ndarray:
    depth = built_in_hand().render(CAMERA, T_camera_link, shown)
    return on_host(depth).reshape(CAMERA.height, CAMERA.width)


@given(st.integers(0, 10_000), st.sampled_from([0.3, 0.6, 1.2]))
@settings(max_examples=40, deadline=None)
def test_the_hand_looks_as_its_meshes_do(seed: int, distance: float) -> None:
    T = posed(seed, distance)
    shown = np.random.default_rng(seed).random(len(T)) < 0.7
    shown[seed % len(T)] = True
    found, expected = traced(T, shown), ray_cast(T, shown)
    hit = expected > 0
    # Outlines may differ by a pixel, and a ray along an edge may pass it by.
    extra = (found > 0) & ~binary_dilation(hit, np.ones((3, 3)))
    holes = (found == 0) & binary_erosion(hit, np.ones((3, 3)))
    assert (extra | holes).sum() <= 2 + 0.002 * hit.sum()
    off = np.abs(found - expected)[hit & (found > 0)]
    assert len(off) == 0 or np.median(off) < 1e-4
    assert (off < 0.002).sum() >= 0.9 * len(off) - 2


def test_nothing_is_shown_of_no_link() -> None:
    assert (traced(posed(0, 0.5), np.zeros(5, dtype=bool)) == 0).all()


@pytest.mark.parametrize("place", [[0.0, 0.0, -0.5], [2.0, 0.0, 0.5]])
def test_a_hand_outside_the_view_is_not_seen(place: list[float]) -> None:
    T = exp(np.array([0, 0, 0, *place])) @ built_in_hand().hand.forward_kinematics(np.zeros(4))
    assert (traced(T, np.ones(5, dtype=bool)) == 0).all()


def test_a_hand_that_reaches_behind_the_camera_is_seen_in_front_of_it() -> None:
    """The palm is beside the camera, and its fingers stretch ahead."""
    T = exp(np.array([0, 0, 0, 0.06, 0.02, -0.05]))
    poses = T @ built_in_hand().hand.forward_kinematics(np.zeros(4))
    shown = np.ones(5, dtype=bool)
    found, expected = traced(poses, shown), ray_cast(poses, shown)
    assert (expected > 0).any()
    assert ((found > 0) != (expected > 0)).mean() < 0.03
