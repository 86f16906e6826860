from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
import warp as wp
from hand_view import CAMERA, off_by, seen, wrist
from held_object import HeldObject, Q, held_object
from hypothesis import given, settings
from hypothesis import strategies as st
from tiny_urdf import joint, link, mimic, write

from inhand.camera import Camera
from inhand.geometry.se3 import exp, inverse, skew, transform
from inhand.hand import Hand
from inhand.kernels.hand_fit import DepthView
from inhand.kernels.launch import on_host
from inhand.packed import PackedHand
from inhand.stages.articulated_fit import ArticulatedFit, WristPrior
from inhand.stages.observation import Observation

WIDTHS = np.geomspace(0.012, 0.003, 12)
LIMIT = '<limit lower="{}" upper="{}" effort="1" velocity="1"/>'
GRIPPER_Q = np.array([0.012, 0.25])


@cache
def gripper() -> PackedHand:
    """Two jaws that slide apart, one a mimic, with tips that turn, one a mimic; not symmetric."""
    slide = LIMIT.format(0, 0.03)
    turn = LIMIT.format(-1, 1)
    jaw, tip = '<box size="0.012 0.03 0.05"/>', '<box size="0.010 0.025 0.04"/>'
    above, end = '<origin xyz="0 0 0.025"/>', '<origin xyz="0 0 0.02"/>'
    elements = [
        link("palm", '<box size="0.11 0.05 0.03"/>', '<origin xyz="0 0 -0.015"/>'),
        link("jaw_a", jaw, above),
        link("jaw_b", jaw, above),
        link("tip_a", tip, end),
        link("tip_b", tip, end),
        joint("slide", "palm", "jaw_a", "prismatic", slide, xyz="0.01 0 0"),
        joint(
            "slide_b",
            "palm",
            "jaw_b",
            "prismatic",
            slide + '<mimic joint="slide" multiplier="-1.5" offset="0.002"/>',
            xyz="-0.02 0 0",
            rpy="0 0 0.2",
        ),
        joint("turn", "jaw_a", "tip_a", inside=turn, axis="0 1 0"),
        joint(
            "turn_b",
            "jaw_b",
            "tip_b",
            inside=mimic("turn", "multiplier='-0.7' offset='0.1'"),
            axis="0 1 0.2",
        ),
    ]
    with TemporaryDirectory() as folder:
        return PackedHand(Hand.from_urdf(write(Path(folder), *elements)), "cpu")


def fit_of(
    observation: Observation,
    hand: PackedHand,
    prior: np.ndarray | None = None,
    used: np.ndarray | None = None,
    free: np.ndarray | None = None,
    sd: tuple[float, float] = (0.03, 0.005),
) -> ArticulatedFit:
    links, joints = len(hand.hand.links), len(hand.hand.joint_names)
    return ArticulatedFit(
        observation,
        hand,
        np.ones(links, dtype=bool) if used is None else used,
        np.ones(joints, dtype=bool) if free is None else free,
        WristPrior(observation.T_camera_hand if prior is None else prior, *sd),
        point_information=2e4,
        joint_damping=4.0,
    )


# Derivatives


def system(
    fit: ArticulatedFit,
    q: np.ndarray,
    T_camera_hand: np.ndarray,
    width: float = 0.01,
    stride: int = 1,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normal equations (s, 6 + n, 6 + n) and (s, 6 + n), and the twists of the joints (s, j, 6)."""
    run = fit.begin(q, T_camera_hand, width, stride)
    run.run()
    return on_host(run.H), on_host(run.g), on_host(run.twists)


def link_jacobians(hand: PackedHand, twists: np.ndarray) -> np.ndarray:
    """Twist of every link per parameter, (s, L, 6, 6 + n), from those of the joints (s, j, 6)."""
    chain = hand.hand.chain
    J = np.zeros((len(twists), len(chain.link_joint), 6, 6 + len(hand.hand.joint_names)))
    J[..., :6] = np.eye(6)
    for i, j in enumerate(chain.link_joint):
        while j >= 0:
            J[:, i, :, 6 + chain.source[j]] += twists[:, j]
            j = chain.parent[j]
    return J


def stepped(
    q: np.ndarray, T_camera_hand: np.ndarray, parameter: int, step: float
) -> tuple[np.ndarray, np.ndarray]:
    """Joints and wrist after a step of one of the 6 + n parameters."""
    xi = np.zeros(6 + len(q))
    xi[parameter] = step
    moved = T_camera_hand.copy()
    moved[:3, :3] = exp(xi[:6])[:3, :3] @ moved[:3, :3]
    moved[:3, 3] += xi[3:6]
    return q + xi[6:], moved


@given(st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_jacobians_are_the_derivatives_of_the_link_poses(seed: int) -> None:
    hand = gripper()
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1, 1, (3, 2))
    T = exp(rng.normal(size=(3, 6)))
    fit = fit_of(seen(hand, GRIPPER_Q, wrist()), hand)
    J = link_jacobians(hand, system(fit, q, T)[2])
    h = 1e-6
    for parameter in range(8):
        ends = [[stepped(q[s], T[s], parameter, sign * h) for s in range(3)] for sign in (1, -1)]
        plus, minus = (
            hand.link_poses(np.stack([e[0] for e in end]), np.stack([e[1] for e in end]))
            for end in ends
        )
        here = hand.link_poses(q, T)
        rate = (plus - minus) / (2 * h)
        turning = rate[..., :3, :3] @ np.swapaxes(here[..., :3, :3], -1, -2)
        rotation = np.stack([turning[..., 2, 1], turning[..., 0, 2], turning[..., 1, 0]], -1)
        np.testing.assert_allclose(skew(rotation), turning, atol=1e-7)
        # The motion of the link's point that is at the wrist right now.
        arm = T[:, None, :3, 3] - here[..., :3, 3]
        motion = rate[..., :3, 3] + np.cross(rotation, arm)
        expected = np.concatenate([rotation, motion], axis=-1)
        np.testing.assert_allclose(J[..., parameter], expected, atol=1e-7)


def test_joints_that_are_not_free_do_not_move_anything() -> None:
    hand = gripper()
    observation = seen(hand, GRIPPER_Q, wrist())
    fit = fit_of(observation, hand, free=np.array([False, True]))
    H, g, twists = system(fit, GRIPPER_Q[None] + 0.002, wrist()[None])
    J = link_jacobians(hand, twists)
    assert (J[..., 6] == 0).all()
    assert (J[..., 7] != 0).any()
    assert (H[:, 6] == 0).all()
    assert (H[:, :, 6] == 0).all()
    assert (g[:, 6] == 0).all()
    assert (g[:, 7] != 0).all()


def tukey(r: np.ndarray, width: float) -> np.ndarray:
    return np.where(np.abs(r) < width, (1 - (r / width) ** 2) ** 2, 0)


def check_system(
    fit: ArticulatedFit,
    residuals: Any,
    weights: np.ndarray,
    q: np.ndarray,
    T: np.ndarray,
    width: float,
) -> None:
    """Compare the normal equations with those of numeric derivatives of the residuals (k,)."""
    (H,), (g,), _ = system(fit, q[None], T[None], width)
    h = 1e-7
    D = np.stack(
        [
            (residuals(*stepped(q, T, k, h)) - residuals(*stepped(q, T, k, -h))) / (2 * h)
            for k in range(6 + len(q))
        ],
        axis=1,
    )
    expected_H = D.T @ (weights[:, None] * D)
    expected_g = -D.T @ (weights * residuals(q, T))
    scale = np.sqrt(np.diag(expected_H))
    assert (scale > 0).all()
    np.testing.assert_allclose(
        H / np.outer(scale, scale), expected_H / np.outer(scale, scale), atol=0.02
    )
    rms = np.sqrt(weights @ residuals(q, T) ** 2)
    np.testing.assert_allclose(g / scale / rms, expected_g / scale / rms, atol=0.02)


def without_depth(observation: Observation) -> Observation:
    """The same scene cloud with an empty image."""
    view = DepthView()
    view.camera, view.normals = observation.view.camera, observation.view.normals
    view.missing = observation.view.missing
    view.depth = wp.zeros(observation.depth.size, dtype=float, device="cpu")
    return replace(observation, view=view)


@pytest.mark.parametrize("seed", range(3))
def test_scene_points_are_pulled_along_the_derivative_of_their_distance(seed: int) -> None:
    hand, T_true, width = gripper(), wrist(), 0.008
    blind = without_depth(seen(hand, GRIPPER_Q, T_true))
    fit = fit_of(blind, hand)
    rng = np.random.default_rng(seed)
    T = T_true @ exp(rng.normal(0, 1, 6) * ([0.01] * 3 + [0.001] * 3))
    q = GRIPPER_Q + rng.normal(0, [0.001, 0.03])
    points, normals = blind.points.astype(float), blind.normals.astype(float)

    def local(k: int, poses: np.ndarray) -> np.ndarray:
        return transform(inverse(poses[k]), points)

    here = hand.link_poses(q[None], T[None])[0]
    fields = [x.distance_field for x in hand.hand.links]
    distance = np.stack([f.distance(local(k, here)) for k, f in enumerate(fields)])
    nearest = distance.argmin(axis=0)

    def residuals(q: np.ndarray, T: np.ndarray) -> np.ndarray:
        poses = hand.link_poses(q[None], T[None])[0]
        values = np.stack([f.distance(local(k, poses)) for k, f in enumerate(fields)])
        return np.asarray(values[nearest, np.arange(len(points))])

    gradient = np.zeros_like(points)
    for k, f in enumerate(fields):
        cell = np.rint((local(k, here) - f.origin) / f.voxel).astype(int)
        cell = np.clip(cell, 0, np.array(f.values.shape[:3]) - 1)
        gradient[nearest == k] = (f.values[tuple(cell.T)][:, 1:] @ here[k, :3, :3].T)[nearest == k]
    weights = tukey(distance.min(axis=0), width) * (gradient * normals).sum(axis=1).clip(0)
    # The numeric derivative is that of the field as long as no voxel border is crossed.
    check_system(fit, residuals, weights, q, T, width)


@pytest.mark.parametrize("seed", range(3))
def test_surface_samples_are_pulled_along_the_derivative_of_their_plane(seed: int) -> None:
    hand, T_true, width = gripper(), wrist(), 0.008
    full = seen(hand, GRIPPER_Q, T_true)
    nothing = np.zeros((0, 3), dtype=np.float32)
    fit = fit_of(replace(full, points=nothing, normals=nothing), hand)
    rng = np.random.default_rng(seed)
    T = T_true @ exp(rng.normal(0, 1, 6) * ([0.01] * 3 + [0.001] * 3))
    q = GRIPPER_Q + rng.normal(0, [0.001, 0.03])

    def surface(q: np.ndarray, T: np.ndarray, vectors: str) -> np.ndarray:
        poses = hand.link_poses(q[None], T[None])[0]
        return np.concatenate(
            [
                getattr(x.surface, vectors) @ pose[:3, :3].T
                + (pose[:3, 3] if vectors == "points" else 0)
                for x, pose in zip(hand.hand.links, poses, strict=True)
            ]
        )

    p, n = surface(q, T, "points"), surface(q, T, "normals")
    camera = full.camera
    u, v = np.rint(camera.project(p)).astype(int).T
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    pixel = np.where(inside, v * camera.width + u, 0)
    d = np.where(inside, full.depth.reshape(-1)[pixel], 0)
    reading = p * (d / p[:, 2])[:, None]
    facing = -(n * p).sum(axis=1) / np.linalg.norm(p, axis=1)
    agreement = (n * full.view.normals.numpy()[pixel]).sum(axis=1).clip(0)
    weights = facing * tukey((n * (reading - p)).sum(axis=1), width) * agreement
    weights[(facing < 0.15) | (d == 0) | (np.abs(d - p[:, 2]) > width)] = 0

    def residuals(q: np.ndarray, T: np.ndarray) -> np.ndarray:
        return np.asarray((n * (reading - surface(q, T, "points"))).sum(axis=1))

    check_system(fit, residuals, weights, q, T, width)


@pytest.mark.parametrize("stride", [2, 3])
def test_every_so_many_th_point_can_take_part(stride: int) -> None:
    hand = gripper()
    blind = without_depth(seen(hand, GRIPPER_Q, wrist()))
    fewer = replace(blind, points=blind.points[::stride], normals=blind.normals[::stride])
    q, T = GRIPPER_Q[None] + 0.002, wrist()[None]
    H, g, _ = system(fit_of(blind, hand), q, T, stride=stride)
    H_fewer, g_fewer, _ = system(fit_of(fewer, hand), q, T)
    np.testing.assert_allclose(H, H_fewer, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(g, g_fewer, rtol=1e-4, atol=1e-4)


# Refinement


@given(st.integers(0, 1000))
@settings(max_examples=5, deadline=None)
def test_wrist_and_slides_and_mimics_are_recovered(seed: int) -> None:
    hand, T_true = gripper(), wrist()
    rng = np.random.default_rng(seed)
    start = T_true @ exp(rng.normal(0, 1, 6) * ([0.015] * 3 + [0.003] * 3))
    q_start = GRIPPER_Q + rng.uniform(-1, 1, 2) * [0.004, 0.12]
    fit = fit_of(seen(hand, GRIPPER_Q, T_true), hand, prior=start)
    q, T = fit.refine(q_start[None], start[None], WIDTHS)
    assert abs(q[0, 0] - GRIPPER_Q[0]) < 0.001
    assert abs(q[0, 1] - GRIPPER_Q[1]) < 0.03
    distance, angle = off_by(T[0], T_true)
    assert distance < 0.001
    assert angle < 0.5


def perturbed(scene: HeldObject, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Joints and wrists around the true ones."""
    rng = np.random.default_rng(0)
    errors = rng.normal(0, 1, (count, 6)) * ([0.012] * 3 + [0.002] * 3)
    q = Q + rng.uniform(-0.12, 0.12, (count, 4))
    return q, scene.hand_state.T_camera_hand @ exp(errors)


def test_wrist_and_fingers_around_an_object_are_recovered() -> None:
    scene = held_object("cuboid")
    q, T = perturbed(scene, 6)
    for k in range(len(q)):
        fit = fit_of(scene.observation, scene.hand, prior=T[k])
        q_found, T_found = fit.refine(q[[k]], T[[k]], WIDTHS)
        distance, angle = off_by(T_found[0], scene.hand_state.T_camera_hand)
        assert distance < 0.002
        assert angle < 0.5
        np.testing.assert_allclose(q_found[0], Q, atol=0.05)


def test_starts_do_not_influence_each_other() -> None:
    scene = held_object("cuboid")
    fit = fit_of(scene.observation, scene.hand)
    q, T = perturbed(scene, 3)
    together = fit.refine(q, T, WIDTHS[:4])
    alone = [fit.refine(q[[k]], T[[k]], WIDTHS[:4]) for k in range(3)]
    np.testing.assert_allclose(together[0], np.concatenate([x[0] for x in alone]), atol=1e-9)
    np.testing.assert_allclose(together[1], np.concatenate([x[1] for x in alone]), atol=1e-9)


def test_joints_stay_within_their_limits() -> None:
    hand = gripper()
    at_limit = np.array([hand.hand.lower[0], 0.25])
    observation = seen(hand, at_limit, wrist())
    fit = fit_of(observation, hand)
    rng = np.random.default_rng(0)
    starts = rng.uniform(hand.hand.lower, hand.hand.upper, (20, 2))
    q, _ = fit.refine(starts, np.repeat(wrist()[None], 20, axis=0), WIDTHS)
    assert (q >= hand.hand.lower).all()
    assert (q <= hand.hand.upper).all()
    assert np.abs(q[:, 0] - at_limit[0]).min() < 0.001


def test_the_input_is_left_as_it_was() -> None:
    scene = held_object("cuboid")
    q, T = perturbed(scene, 2)
    q_before, T_before = q.copy(), T.copy()
    fit_of(scene.observation, scene.hand).refine(q, T, WIDTHS[:2])
    np.testing.assert_array_equal(q, q_before)
    np.testing.assert_array_equal(T, T_before)


# What the image does not say


@cache
def plate() -> PackedHand:
    """A flat palm with a finger behind it."""
    elements = [
        link("palm", '<box size="0.12 0.09 0.004"/>'),
        link("finger", '<box size="0.01 0.01 0.04"/>', '<origin xyz="0 0 0.02"/>'),
        joint("bend", "palm", "finger", xyz="0 0 0.01"),
    ]
    with TemporaryDirectory() as folder:
        return PackedHand(Hand.from_urdf(write(Path(folder), *elements)), "cpu")


def fitted_plate(camera: Camera, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Finger joint and wrist found from a wrong prior, when the plate is at `PLATE`."""
    observation = seen(plate(), np.zeros(1), PLATE, camera)
    fit = fit_of(observation, plate(), prior=start, sd=(0.3, 0.05))
    q, T = fit.refine(np.array([[0.3]]), start[None], WIDTHS)
    return q[0], T[0]


PLATE = exp(np.array([0, 0, 0, 0.01, -0.005, 0.4]))
# Off along the plate, away from it, about its normal and out of its plane.
WRONG = exp(np.array([0.01, -0.015, 0.02, 0.013, -0.007, 0.403]))


def test_directions_along_a_plane_stay_at_the_prior() -> None:
    """The image shows only the middle of the palm, frontally."""
    q, T = fitted_plate(CAMERA.crop(140, 100, 60, 40), WRONG)
    np.testing.assert_allclose(T[:2, 3], WRONG[:2, 3], atol=2e-4)
    assert np.arctan2(T[1, 0], T[0, 0]) == pytest.approx(0.02, abs=1e-3)
    # The others follow the image.
    assert T[2, 3] == pytest.approx(PLATE[2, 3], abs=3e-4)
    np.testing.assert_allclose(T[:3, 2], PLATE[:3, 2], atol=0.002)
    # The finger is hidden.
    assert q[0] == pytest.approx(0.3, abs=0.01)


def test_the_outline_of_a_plane_says_where_it_is() -> None:
    _, T = fitted_plate(CAMERA, WRONG)
    before, after = (np.linalg.norm((x - PLATE)[:2, 3]) for x in (WRONG, T))
    assert after < 0.5 * before


def test_far_from_any_reading_nothing_moves() -> None:
    hand = plate()
    away = exp(np.array([0.1, 0.2, 0.3, 0.0, 0.0, 1.4]))
    fit = fit_of(seen(hand, np.zeros(1), exp(np.array([0, 0, 0, 0, 0, 0.4]))), hand, prior=away)
    q, T = fit.refine(np.array([[0.3]]), away[None], WIDTHS)
    np.testing.assert_allclose(T[0], away, atol=1e-9)
    assert q[0, 0] == 0.3


@pytest.mark.parametrize("tight", [True, False])
def test_the_prior_is_as_strong_as_its_deviation_says(tight: bool) -> None:
    hand = plate()
    T_true = exp(np.array([0, 0, 0, 0, 0, 0.4]))
    prior = exp(np.array([0, 0, 0, 0, 0, 0.404]))
    sd = (1e-6, 1e-6) if tight else (0.03, 0.005)
    fit = fit_of(seen(hand, np.zeros(1), T_true), hand, prior=prior, sd=sd)
    _, T = fit.refine(np.zeros((1, 1)), prior[None], WIDTHS)
    assert T[0, 2, 3] == pytest.approx(0.404 if tight else 0.4, abs=2e-4)


def test_links_that_are_not_used_pull_nothing() -> None:
    """Only the palm takes part; clutter stands where a wrong finger would be."""
    scene = held_object("cuboid")
    palm = np.isin(np.arange(len(scene.hand.hand.links)), scene.hand.hand.palm_links)
    still = np.zeros(4, dtype=bool)
    fit = fit_of(scene.observation, scene.hand, used=palm, free=still)
    T = scene.hand_state.T_camera_hand[None]
    one = fit.refine(Q[None], T, WIDTHS[:3])
    other = fit.refine(np.zeros((1, 4)), T, WIDTHS[:3])
    np.testing.assert_array_equal(one[0], Q[None])
    np.testing.assert_array_equal(other[0], np.zeros((1, 4)))
    np.testing.assert_array_equal(one[1], other[1])
