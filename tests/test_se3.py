import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import kstest

from inhand.errors import InputError
from inhand.geometry import se3

numbers = st.floats(-10, 10)
triples = st.tuples(numbers, numbers, numbers).map(np.array)
twists = st.tuples(triples, triples).map(np.concatenate)
angles = st.floats(0, 1) | st.floats(0, 1e-6)
directions = triples.filter(lambda v: np.linalg.norm(v) > 0.1).map(lambda v: v / np.linalg.norm(v))


@given(directions, angles)
def test_rotation_vectors_as_scipy(axis: np.ndarray, share_of_turn: float) -> None:
    w = 2 * np.pi * share_of_turn * axis
    np.testing.assert_allclose(se3.exp_so3(w), Rotation.from_rotvec(w).as_matrix(), atol=1e-14)


def test_no_rotation_is_exactly_the_identity() -> None:
    np.testing.assert_array_equal(se3.exp(np.zeros(6)), np.eye(4))


@given(twists)
def test_exp_rotates_and_shifts_separately(xi: np.ndarray) -> None:
    T = se3.exp(xi)
    np.testing.assert_allclose(T[:3, :3], Rotation.from_rotvec(xi[:3]).as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(T[:3, 3], xi[3:])
    np.testing.assert_array_equal(T[3], [0, 0, 0, 1])


@given(twists, st.lists(twists, min_size=1, max_size=3), triples)
def test_moved_turns_about_the_pivot_and_then_shifts(
    at: np.ndarray, xi: list[np.ndarray], pivot: np.ndarray
) -> None:
    T = se3.exp(at)
    found = se3.moved(T, np.array(xi), pivot)
    there = se3.transform(T, pivot[None])[0]
    to_pivot = se3.exp(np.concatenate([np.zeros(3), there]))
    for pose, one in zip(found, xi, strict=True):
        expected = to_pivot @ se3.exp(one) @ se3.inverse(to_pivot) @ T
        np.testing.assert_allclose(pose, expected, atol=1e-11)
        np.testing.assert_array_equal(se3.moved(T, one, pivot), pose)


def test_batches_are_rows() -> None:
    xi = np.random.default_rng(0).normal(size=(2, 3, 6))
    T = se3.exp(xi)
    assert T.shape == (2, 3, 4, 4)
    np.testing.assert_array_equal(T[1, 2], se3.exp(xi[1, 2]))
    np.testing.assert_array_equal(se3.inverse(T)[1, 2], se3.inverse(T[1, 2]))
    angle = se3.rotation_angle(T[..., :3, :3], np.eye(3))
    assert angle.shape == (2, 3)
    np.testing.assert_allclose(angle, Rotation.from_rotvec(xi[..., :3]).magnitude())


@given(triples, triples)
def test_skew_is_the_cross_product(a: np.ndarray, b: np.ndarray) -> None:
    np.testing.assert_allclose(se3.skew(a) @ b, np.cross(a, b), atol=1e-12)


@given(twists)
def test_inverse_undoes(xi: np.ndarray) -> None:
    T = se3.exp(xi)
    np.testing.assert_allclose(se3.inverse(T), np.linalg.inv(T), atol=1e-12)


@given(twists, st.lists(triples, min_size=1, max_size=5).map(np.array))
def test_transform_is_the_homogeneous_product(xi: np.ndarray, points: np.ndarray) -> None:
    T = se3.exp(xi)
    homogeneous = np.column_stack([points, np.ones(len(points))])
    np.testing.assert_allclose(
        se3.transform(T, points), (homogeneous @ T.T)[:, :3], rtol=1e-12, atol=1e-12
    )


@given(triples, triples)
def test_rotation_angle_as_scipy(a: np.ndarray, b: np.ndarray) -> None:
    one, other = Rotation.from_rotvec(a), Rotation.from_rotvec(b)
    # The arc cosine is good to the root of the machine's precision at 0 and pi.
    found = se3.rotation_angle(one.as_matrix(), other.as_matrix())
    assert found == pytest.approx((one.inv() * other).magnitude(), abs=1e-7)


def test_random_rotations_are_uniform() -> None:
    """Under the uniform distribution the angle has the CDF (angle - sin(angle)) / pi."""
    rng = np.random.default_rng(0)
    R = np.stack([se3.random_rotation(rng) for _ in range(4000)])
    np.testing.assert_allclose(
        R @ R.transpose(0, 2, 1), np.broadcast_to(np.eye(3), R.shape), atol=1e-14
    )
    np.testing.assert_allclose(np.linalg.det(R), 1)
    fixed = Rotation.from_rotvec([0.3, -1.0, 2.0]).as_matrix()
    for other in (np.eye(3), fixed):
        angle = se3.rotation_angle(R, other)
        assert kstest(angle, lambda x: (x - np.sin(x)) / np.pi).pvalue > 0.01
    np.testing.assert_array_equal(se3.random_rotation(np.random.default_rng(0)), R[0])


@given(directions, directions)
def test_rotation_between_is_the_smallest_one(a: np.ndarray, b: np.ndarray) -> None:
    R = se3.rotation_between(a, b)
    np.testing.assert_allclose(R @ a, b, atol=1e-7)
    angle = np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)
    assert Rotation.from_matrix(R).magnitude() == pytest.approx(angle, abs=1e-7)


@given(directions, directions, st.sampled_from([0.0, 1e-12, 1e-8, 1e-4]))
def test_rotation_between_opposite_vectors(a: np.ndarray, away: np.ndarray, by: float) -> None:
    b = -a + by * away
    b /= np.linalg.norm(b)
    R = se3.rotation_between(a, b)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(R @ a, b, atol=1e-7)
    assert np.linalg.det(R) == pytest.approx(1)


@given(twists, st.integers(0, 1000))
def test_nearly_rigid_input_becomes_the_nearest_rigid_transform(xi: np.ndarray, seed: int) -> None:
    T = se3.exp(xi)
    rough = T.copy()
    rough[:3, :3] += np.random.default_rng(seed).uniform(-1e-4, 1e-4, (3, 3))
    given_matrix = rough.copy()
    found = se3.check_rigid(rough, "T")
    np.testing.assert_array_equal(rough, given_matrix)
    assert found.dtype == np.float64
    np.testing.assert_allclose(found[:3, :3] @ found[:3, :3].T, np.eye(3), atol=1e-12)
    # No rotation is nearer than the orthogonal polar factor: scipy projects in the same way.
    nearest = Rotation.from_matrix(rough[:3, :3]).as_matrix()
    np.testing.assert_allclose(found[:3, :3], nearest, atol=1e-7)
    np.testing.assert_array_equal(found[:3, 3], T[:3, 3])


def test_lists_and_other_number_types_are_taken() -> None:
    T = se3.exp(np.array([0.1, 0.2, 0.3, 1.0, 2.0, 3.0]))
    np.testing.assert_allclose(se3.check_rigid(T.tolist(), "T"), T, atol=1e-15)
    np.testing.assert_allclose(se3.check_rigid(T.astype(np.float32), "T"), T, atol=1e-6)
    np.testing.assert_array_equal(se3.check_rigid(np.eye(4, dtype=int), "T"), np.eye(4))


SCALED, MIRRORED, SHEARED = (np.diag([2.0, 2, 2, 1]), np.diag([1.0, -1, 1, 1]), np.eye(4))
SHEARED[0, 1] = 0.3
HUGE = np.eye(4)
HUGE[:2, :2] = [[1e200, 1e200], [1e200, -1e200]]
WITH_NAN = np.eye(4)
WITH_NAN[0, 3] = np.nan


@pytest.mark.parametrize(
    ("T", "message"),
    [
        (np.eye(3), r"must be a 4x4.*got shape \(3, 3\)"),
        (np.eye(4)[None], r"got shape \(1, 4, 4\)"),
        (WITH_NAN, "NaN"),
        (se3.exp(np.array([0, 0, 0, 1.0, 2, 3])).T, "transposed"),
        (SCALED, "remove scale"),
        (SHEARED, "remove scale and shear"),
        (HUGE, "remove scale"),
        (MIRRORED, "mirror"),
        ("identity", "4x4 matrix of numbers"),
    ],
)
def test_other_matrices_are_refused(T: object, message: str) -> None:
    with pytest.raises(InputError, match=rf"T_a_b.*{message}"):
        se3.check_rigid(T, "T_a_b")
