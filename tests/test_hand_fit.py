from typing import Any

import numpy as np
import pytest
import warp as wp
from hand_made import HIDDEN, MISSING, TOLERANCE, VIOLATION, view, visibility
from held_object import HeldObject, Q, distance_to_hand, held_object
from hypothesis import given, settings
from hypothesis import strategies as st

from inhand.camera import Camera
from inhand.config import HandStateConfig
from inhand.geometry.se3 import exp, transform
from inhand.kernels.hand_fit import Visibility, score_configurations
from inhand.kernels.launch import computed, on_host
from inhand.packed import device_poses

SMALL = Camera(fx=100, fy=100, cx=20, cy=15, width=41, height=31)
WALL = 0.5
TOWARDS = (0.0, 0.0, -1.0)


def scores(
    seen_by: Any,
    rule: Any,
    poses: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    fixed: np.ndarray | float = 0.0,
    early: tuple[int, float] = (0, 0.0),
    nearest: np.ndarray | float = 0.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Score, open share and lenient score, (c,) each, of one rigid set of surface samples at poses
    (c, 4, 4).

    A pose that scores below `early[1]` after `early[0]` samples is given up.
    """
    n, width, height = len(points), seen_by.camera.width, seen_by.camera.height
    other, around = (
        wp.array(np.broadcast_to(image, (height, width)).reshape(-1), dtype=float)
        for image in (fixed, nearest)
    )
    scores = computed(
        score_configurations,
        (len(poses),),
        wp.vec3,
        [seen_by, rule, device_poses(poses, "cpu"), 1]
        + [wp.array(points, dtype=wp.vec3), wp.array(normals, dtype=wp.vec3)]
        + [wp.zeros(n, dtype=int), n, *early]
        + [other, 1, around],
        "cpu",
        work_per_item=n,
        shared=True,
    )
    return scores[:, 0], scores[:, 1], scores[:, 2]


def judge(
    z: float, image: Any, normal: tuple[float, ...] = TOWARDS, fixed: float = 0.0, x: float = 0.0
) -> tuple[float, float]:
    """Score and open share of one surface point on the optical axis, or beside it."""
    pose = np.eye(4)[None]
    pose[0, :3, 3] = [x, 0, z]
    score, seen, _ = scores(image, visibility(), pose, np.zeros((1, 3)), np.array([normal]), fixed)
    return float(score[0]), float(seen[0])


def test_a_point_on_its_reading_counts_fully() -> None:
    assert judge(WALL, view(SMALL, WALL)) == pytest.approx((1, 1), abs=1e-4)


@given(st.floats(0, 0.99), st.floats(0, 0.99), st.sampled_from([-1, 1]))
@settings(deadline=None)
def test_agreement_falls_with_the_depth_difference(a: float, b: float, side: int) -> None:
    near, far = sorted((a, b))
    image = view(SMALL, WALL)
    one, other = (judge(WALL + side * share * TOLERANCE, image)[0] for share in (near, far))
    assert 1.001 > one >= other - 1e-5
    assert other > 0


def test_looked_through_and_hidden_points_are_penalised() -> None:
    image = view(SMALL, WALL)
    for beyond in (1.01, 2, 20):
        assert judge(WALL - beyond * TOLERANCE, image) == pytest.approx((-VIOLATION, 1), abs=1e-4)
        assert judge(WALL + beyond * TOLERANCE, image) == pytest.approx((-HIDDEN, 0), abs=1e-4)


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_without_a_reading_the_missing_share_decides(share: float) -> None:
    found = judge(WALL, view(SMALL, 0.0, missing=share))
    assert found == pytest.approx((-MISSING * share, 1), abs=1e-4)


@pytest.mark.parametrize("angle", [0.0, 0.5, 1.0, 1.5, 2.5])
def test_agreement_falls_with_the_angle_of_the_normals(angle: float) -> None:
    seen_normal = (np.sin(angle), 0.0, -np.cos(angle))
    score, _ = judge(WALL, view(SMALL, WALL, normal=seen_normal))
    assert score == pytest.approx(max(0, np.cos(angle)), abs=1e-3)


def test_points_that_face_away_or_lie_outside_the_image_say_nothing() -> None:
    image = view(SMALL, WALL)
    assert judge(WALL, image, normal=(0, 0, 1)) == (0, 0)
    assert judge(WALL, image, normal=(1, 0, 0)) == (0, 0)
    assert judge(WALL, image, x=0.2) == (0, 0)
    assert judge(-WALL, image, normal=(0, 0, 1)) == (0, 0)


def test_what_another_part_hides_or_explains_is_left_out() -> None:
    image = view(SMALL, WALL)
    assert judge(WALL, image, fixed=WALL - 5 * TOLERANCE) == (0, 0)
    assert judge(WALL, image, fixed=WALL) == (0, 0)
    assert judge(WALL, image, fixed=WALL + 2 * TOLERANCE)[0] == pytest.approx(1, abs=1e-4)


def test_the_score_is_a_mean_over_the_projected_area() -> None:
    """Of three points of the same area one is hidden and one is looked through."""
    depth = np.full((31, 41), WALL)
    depth[:, 30:], depth[:, :10] = 0.4, 0.7
    points = np.array([[-0.075, 0, 0], [0, 0, 0], [0.075, 0, 0]])
    normals = -(points + [0, 0, WALL]) / np.linalg.norm(points + [0, 0, WALL], axis=1)[:, None]
    pose = np.eye(4)[None]
    pose[0, :3, 3] = [0, 0, WALL]
    score, seen, _ = scores(view(SMALL, depth), visibility(), pose, points, normals)
    assert score[0] == pytest.approx((1 - VIOLATION - HIDDEN) / 3, abs=1e-3)
    assert seen[0] == pytest.approx(2 / 3, abs=1e-3)


@pytest.mark.parametrize(
    ("beside", "excused"), [(0.0, False), (np.inf, False), (0.7, False), (WALL, True), (0.4, True)]
)
def test_what_is_looked_through_is_excused_beside_what_is_as_near(
    beside: float, excused: bool
) -> None:
    depth = np.full((31, 41), 0.7)
    pose = np.eye(4)[None]
    pose[0, 2, 3] = WALL
    point, normal = np.zeros((1, 3)), np.array([TOWARDS])
    strict, _, lenient = scores(
        view(SMALL, depth), visibility(), pose, point, normal, nearest=beside
    )
    assert strict[0] == pytest.approx(-VIOLATION, abs=1e-3)
    assert lenient[0] == pytest.approx(0 if excused else -VIOLATION, abs=1e-3)


@pytest.mark.parametrize("hopeless", [-0.5, 0.5])
def test_hopeless_poses_are_given_up(hopeless: float) -> None:
    """Two of four points are looked through and two agree, in this order."""
    points = np.array([[-0.05, 0, 0], [-0.02, 0, 0], [0.02, 0, 0], [0.05, 0, 0]])
    depth = np.full((31, 41), WALL)
    depth[:, :20] = 0.7
    poses = np.eye(4)[None].repeat(2, axis=0)
    poses[:, 2, 3] = WALL
    poses[1, 0, 3] = 0.06  # two that agree, and two outside the image
    image, normals = view(SMALL, depth), np.tile(TOWARDS, (4, 1))
    whole, *_ = scores(image, visibility(), poses, points, normals)
    found, *_ = scores(image, visibility(), poses, points, normals, early=(2, hopeless))
    assert whole[0] == pytest.approx((1 - VIOLATION) / 2, abs=0.02)
    assert found[0] == pytest.approx(-VIOLATION, abs=0.02)
    assert found[1] == whole[1]


# A whole finger


def brute_force(
    scene: HeldObject, finger: int, T_camera_link: np.ndarray, fixed: np.ndarray
) -> tuple[float, float]:
    """Score and open share of a finger in the scene's image, point by point, by another route."""
    config, camera = HandStateConfig(), scene.observation.camera
    missing = scene.observation.view.missing.numpy()
    seen_normals = scene.observation.view.normals.numpy()
    depth = scene.observation.depth.reshape(-1)
    total = area = open_area = 0.0
    for i in scene.hand.hand.fingers[finger].links:
        surface, T = scene.hand.hand.links[i].surface, T_camera_link[i]
        p = surface.points @ T[:3, :3].T + T[:3, 3]
        n = surface.normals @ T[:3, :3].T
        facing = -(n * p).sum(axis=1) / np.linalg.norm(p, axis=1)
        p, n, facing = p[facing > 0.1], n[facing > 0.1], facing[facing > 0.1]
        area += facing.sum()
        u, v = np.rint(camera.project(p)).astype(int).T
        inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        pixel = (v * camera.width + u)[inside]
        p, n, facing = p[inside], n[inside], facing[inside]
        other = fixed.reshape(-1)[pixel]
        free = (other == 0) | (other >= p[:, 2] + config.fine_tolerance)
        d, z = depth[pixel], p[:, 2]
        off = np.abs(d - z) / config.fine_tolerance
        agreement = (n * seen_normals[pixel]).sum(axis=1).clip(0)
        judged = np.select(
            [d == 0, d > z + config.fine_tolerance, d < z - config.fine_tolerance],
            [-config.missing * missing[pixel], -config.violation, -config.hidden],
            (1 - 0.6 * off) * agreement,
        )
        total += (facing * judged)[free].sum()
        open_area += facing[free & ((d == 0) | (d > z - config.fine_tolerance))].sum()
    return total / area, open_area / area


def test_scores_of_fingers_are_those_of_brute_force() -> None:
    scene = held_object("cuboid")
    hand, config = scene.hand, HandStateConfig()
    rng = np.random.default_rng(0)
    q = np.clip(Q + rng.normal(0, 0.3, (12, 4)), hand.hand.lower, hand.hand.upper)
    q[0] = Q
    errors = rng.normal(0, 0.003, (12, 6))
    errors[0] = 0
    wrists = scene.hand_state.T_camera_hand @ exp(errors)
    poses = hand.link_poses(q, wrists)
    rule = Visibility()
    rule.tolerance, rule.violation = config.fine_tolerance, config.violation
    rule.missing, rule.hidden = config.missing, config.hidden
    camera = scene.observation.camera
    palm_only = np.isin(np.arange(len(hand.hand.links)), hand.hand.palm_links)
    fixed = hand.render(camera, poses[0], palm_only)
    for k, finger in enumerate(hand.hand.fingers):
        part = hand.fingers[k]
        samples = sum(len(hand.hand.links[i].surface.points) for i in finger.links)
        scores = computed(
            score_configurations,
            (len(q),),
            wp.vec3,
            [scene.observation.view, rule, part.pose(q[:, part.joints], wrists)]
            + [len(part.links), part.points, part.normals, part.link, samples, 0, 0.0]
            + [fixed, 1, wp.zeros(camera.width * camera.height, dtype=float)],
            "cpu",
            work_per_item=samples,
            shared=True,
        )
        image = on_host(fixed).reshape(camera.height, camera.width)
        expected = np.array([brute_force(scene, k, T, image) for T in poses])
        # A point may lie on a threshold.
        np.testing.assert_allclose(scores[:, 0], expected[:, 0], atol=0.02)
        np.testing.assert_allclose(scores[:, 1], expected[:, 1], atol=0.01)
        assert scores[:, 0].argmax() == 0, scores


# Distances


@given(st.integers(0, 1000), st.sampled_from([0.01, 0.05, 1.0]))
@settings(max_examples=15, deadline=None)
def test_distances_to_the_posed_hand(seed: int, farthest: float) -> None:
    scene = held_object("cuboid")
    rng = np.random.default_rng(seed)
    points = scene.hand_state.T_camera_hand[:3, 3] + rng.uniform(-0.2, 0.2, (300, 3))
    links = np.ones(len(scene.hand.hand.links), dtype=bool)
    poses = device_poses(scene.hand_state.T_camera_link, "cpu")
    found = scene.hand.distances(points.astype(np.float32), poses, links, farthest)[0]
    expected = np.minimum(distance_to_hand(points, scene.hand, scene.hand_state), farthest)
    # Fields are kept in half precision. At the border between two voxels rounding decides.
    assert np.mean(np.abs(found - expected) < 2e-6 + 2**-11 * np.abs(expected)) > 0.98
    np.testing.assert_allclose(found, expected, atol=0.001)


def test_distances_to_a_posed_object_are_those_of_a_cylinder() -> None:
    scene, farthest, rng = held_object("cylinder"), 0.01, np.random.default_rng(0)
    mesh, T = scene.obj.model.mesh, scene.T_camera_object
    radius, half = (0.5 * np.ptp(mesh.vertices[:, axis]) for axis in (0, 2))
    local = rng.uniform(-1, 1, (500, 3)) * [1.5 * radius, 1.5 * radius, 1.3 * half]
    beside, above = np.hypot(local[:, 0], local[:, 1]) - radius, np.abs(local[:, 2]) - half
    outside = np.hypot(np.maximum(beside, 0), np.maximum(above, 0))
    expected = np.minimum(outside + np.minimum(np.maximum(beside, above), 0), farthest)
    found = scene.obj.distances(transform(T, local).astype(np.float32), T, farthest)
    # The mesh is a prism of many sides, and its field a grid.
    np.testing.assert_allclose(found, expected, atol=0.0006)


def test_distances_to_several_posed_hands() -> None:
    scene = held_object("cuboid")
    T = np.stack([scene.hand_state.T_camera_link, scene.hand_state.T_camera_link])
    T[1, :, :3, 3] += 0.01
    links = np.ones(T.shape[1], dtype=bool)
    both = scene.hand.distances(scene.observation.points, device_poses(T, "cpu"), links, 0.5)
    for poses, found in zip(T, both, strict=True):
        alone = scene.hand.distances(
            scene.observation.points, device_poses(poses, "cpu"), links, 0.5
        )
        np.testing.assert_array_equal(found, alone[0])
    assert (both[0] != both[1]).any()


def test_distances_to_a_finger_by_its_own_links_alone() -> None:
    scene = held_object("cuboid")
    hand, state, points = scene.hand, scene.hand_state, scene.observation.points
    poses = device_poses(state.T_camera_link, "cpu")
    for i, finger in enumerate(hand.fingers):
        of_finger = np.isin(np.arange(len(hand.hand.links)), finger.links)
        expected = hand.distances(points, poses, of_finger, 0.05)
        own = device_poses(state.T_camera_link[finger.links], "cpu")
        found = hand.distances(points, own, np.ones(len(own), bool), 0.05, finger=i)
        np.testing.assert_array_equal(found, expected)
        assert (expected < 0.05).any()


def test_links_that_are_left_out_are_not_there() -> None:
    scene = held_object("cuboid")
    points = scene.observation.points
    count, poses = len(scene.hand.hand.links), device_poses(scene.hand_state.T_camera_link, "cpu")
    each = [scene.hand.distances(points, poses, np.arange(count) == i, 0.5) for i in range(count)]
    some = np.isin(np.arange(count), [0, 3])
    found = scene.hand.distances(points, poses, some, 0.5)
    np.testing.assert_array_equal(found, np.minimum(each[0], each[3]))
    nothing = scene.hand.distances(points, poses, np.zeros(count, bool), 0.5)
    np.testing.assert_array_equal(nothing, 0.5)
