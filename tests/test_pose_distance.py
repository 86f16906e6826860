from typing import Any

import numpy as np
import pytest
import warp as wp
from held_object import built_in_object
from hypothesis import given, settings
from hypothesis import strategies as st

from inhand.geometry.distance_field import build_distance_field
from inhand.geometry.mesh import sphere
from inhand.geometry.se3 import exp, inverse, transform
from inhand.kernels.fields import pack_fields
from inhand.kernels.launch import computed, pack
from inhand.kernels.pose_distance import Surface, surface_distances
from inhand.packed import PackedObject, device_poses

POSE = exp(np.array([0.4, -1.0, 2.0, 0.05, -0.02, 0.5]))
FAR = 1.0


def distances(
    obj: PackedObject, T_a: np.ndarray, T_b: np.ndarray, points: int = 200, farthest: float = FAR
) -> np.ndarray:
    """Mean distances [m] of surfaces at poses T_a, (m, 4, 4), to the one at T_b."""
    surface = surface_of(obj.model.surface.points[:points], obj.fields, obj.model.centre)
    return launched(surface, T_a, T_b, farthest)


def surface_of(points: np.ndarray, fields: Any, centre: np.ndarray) -> Any:
    middle: Any = wp.vec3(*centre.tolist())
    return pack(Surface, "cpu", points=points, fields=fields, centre=middle)


def launched(surface: Any, T_a: np.ndarray, T_b: np.ndarray, farthest: float) -> np.ndarray:
    other: Any = wp.mat44(*T_b.reshape(-1).tolist())
    inputs = [surface, device_poses(T_a, "cpu"), other, farthest]
    work = len(surface.points)
    return computed(surface_distances, (len(T_a),), float, inputs, "cpu", work_per_item=work)


@given(st.integers(0, 10_000), st.sampled_from(["industrial_part", "bottle"]))
@settings(max_examples=10, deadline=None)
def test_distances_are_those_of_the_samples_to_the_surface(seed: int, name: str) -> None:
    obj = built_in_object(name)
    T = POSE @ exp(np.random.default_rng(seed).normal(0, 0.02, (10, 6)))
    points = obj.model.surface.points[:200]
    local = inverse(POSE) @ T
    field = obj.model.distance_field
    expected = [np.abs(field.distance(transform(x, points))).mean() for x in local]
    np.testing.assert_allclose(distances(obj, T, POSE), expected, rtol=0.02, atol=2e-5)


def test_a_pose_is_at_no_distance_from_itself() -> None:
    for name in ("industrial_part", "cuboid", "bottle"):
        assert distances(built_in_object(name), POSE[None], POSE)[0] < 1e-4


def test_a_shifted_sphere_in_closed_form() -> None:
    """A point at angle t from the shift d is d cos(t) away to first order."""
    mesh = sphere(0.03)
    fields = pack_fields([build_distance_field(mesh, 0.002, 0.01)], [mesh], "cpu")
    shifts = np.array([0.001, 0.002, 0.004])
    T = POSE @ exp(np.pad(shifts[:, None], ((0, 0), (3, 2))))
    surface = surface_of(mesh.vertices, fields, np.zeros(3))
    # The mean of |cos| over a sphere is one half.
    np.testing.assert_allclose(launched(surface, T, POSE, FAR), shifts / 2, rtol=0.05)
    turned = POSE @ exp(np.array([[1.0, 2.0, 3.0, 0, 0, 0]]))
    assert launched(surface, turned, POSE, FAR)[0] < 1e-4


def test_a_shifted_box_in_closed_form() -> None:
    """Two faces of a box move off by the shift; the others slide in their planes."""
    T = POSE @ exp(np.array([[0, 0, 0, 0, 0.003, 0]]))
    found = distances(built_in_object("cuboid"), T, POSE, points=2000)[0]
    side, end = 0.03 * 0.064, 0.03 * 0.03
    assert found == pytest.approx(0.003 * side / (2 * side + end), rel=0.1)


@pytest.mark.parametrize(
    ("name", "turn", "same"),
    [
        ("cylinder", (0, 0, 40), True),
        ("cylinder", (180, 0, 0), True),
        ("cylinder", (30, 0, 0), False),
        ("cuboid", (0, 0, 90), True),
        ("cuboid", (0, 0, 45), False),
        ("industrial_part", (0, 0, 90), False),
    ],
)
def test_symmetric_poses_are_at_no_distance(
    name: str, turn: tuple[float, float, float], same: bool
) -> None:
    obj = built_in_object(name)
    turned = POSE @ exp(np.array([[*np.radians(turn), 0, 0, 0]]))
    found = distances(obj, turned, POSE)[0]
    assert found < 0.0003 if same else found > 0.001


def test_poses_too_far_apart_are_cut_off() -> None:
    obj = built_in_object("cuboid")
    T = POSE @ exp(np.array([[0, 0, 0, x, 0, 0] for x in (0.0, 0.005, 0.02, 0.5)]))
    found = distances(obj, T, POSE, farthest=0.012)
    assert found[1] == pytest.approx(distances(obj, T, POSE)[1])
    assert found[2] == found[3] == pytest.approx(0.012)
    # Rotations alone are never too far.
    flipped = POSE @ exp(np.array([[np.pi / 2, 0, 0, 0, 0, 0]]))
    assert distances(obj, flipped, POSE, farthest=0.004)[0] > 0.004
