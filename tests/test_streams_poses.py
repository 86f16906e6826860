"""Poses over time and tf, against matrix logarithms and SciPy's rotations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation, Slerp

from inhand.geometry.se3 import exp, inverse
from inhand.streams.pose_track import PoseTrack
from inhand.streams.source import NoPose
from inhand.streams.transform_tree import TransformTree
from inhand.streams.wrist import TopicWrist, TreeWrist

MS = 1_000_000
START = 1_700_000_000 * 1000 * MS
"""Nanoseconds since 1970 do not fit a float64: differences have to be taken first."""
twists = st.lists(st.floats(-3, 3), min_size=6, max_size=6).map(np.array)
Array = NDArray[np.float64]


def quaternion(T: Array) -> list[float]:
    return Rotation.from_matrix(T[:3, :3]).as_quat().tolist()


def random_poses(count: int, seed: int = 0) -> Array:
    return exp(np.random.default_rng(seed).uniform(-1, 1, (count, 6)))


def track_of(times: list[int], poses: Array, longest_gap: float = 0.5) -> PoseTrack:
    track = PoseTrack("the pose", longest_gap)
    for time_ns, T in zip(times, poses, strict=True):
        track.add(time_ns, T[:3, 3].tolist(), quaternion(T))
    return track


@given(twists, twists, st.integers(0, 100), st.booleans())
def test_interpolation_turns_evenly_the_shorter_way(
    a: Array, b: Array, percent: int, flipped: bool
) -> None:
    poses = exp(np.stack([a, b]))
    track = PoseTrack("the pose", 0.5)
    for k, T in enumerate(poses):
        sign = -1 if flipped and k else 1
        track.add(START + 100 * MS * k, T[:3, 3].tolist(), [sign * x for x in quaternion(T)])
    T = track.at(START + percent * MS)
    share = percent / 100
    start, end = poses[:, :3, :3]
    turn = start.T @ end
    if np.trace(turn) > -1 + 1e-6:  # at 180 degrees both ways are as short
        expected = start @ expm(share * np.real(logm(turn)))
        np.testing.assert_allclose(T[:3, :3], expected, atol=1e-6)
    translation = (1 - share) * poses[0, :3, 3] + share * poses[1, :3, 3]
    np.testing.assert_allclose(T[:3, 3], translation, atol=1e-9)


def test_order_does_not_matter_and_the_last_of_a_time_counts() -> None:
    poses = random_poses(4)
    times = [START + 20 * MS, START, START + 10 * MS, START + 10 * MS]
    track = track_of(times, poses)
    np.testing.assert_allclose(track.at(START), poses[1], atol=1e-12)
    np.testing.assert_allclose(track.at(START + 10 * MS), poses[3], atol=1e-12)
    np.testing.assert_allclose(track.at(START + 20 * MS), poses[0], atol=1e-12)


@pytest.mark.parametrize(
    ("after_ms", "reason"),
    [
        (-1, "told from 0.001 s after"),
        (1250, "last told 0.050 s before"),
        (600, "missing for 1.10 s"),
    ],
)
def test_no_pose_is_made_up(after_ms: int, reason: str) -> None:
    track = track_of([START, START + 100 * MS, START + 1200 * MS], random_poses(3))
    with pytest.raises(NoPose, match=reason):
        track.at(START + after_ms * MS)
    track.at(START + 1200 * MS)  # a pose at the very time needs no neighbour
    track.at(START + 50 * MS)


@pytest.mark.parametrize("numbers", [(0, 0, 0, 0), (np.nan, 0, 0, 1), (np.inf, 0, 0, 1)])
def test_what_is_no_pose_is_refused(numbers: tuple[float, ...]) -> None:
    track = track_of([0], random_poses(1))
    with pytest.raises(ValueError, match="no rotation"):
        track.add(1, (0, 0, 0), numbers)
    with pytest.raises(ValueError, match="not finite"):
        track.add(1, (0, np.nan, 0), (0, 0, 0, 1))
    with pytest.raises(NoPose):
        track.at(1)


def test_quaternions_of_any_length_are_rotations() -> None:
    track = PoseTrack("the pose", 0.5)
    track.add(0, (0, 0, 0), (0, 0, 2, 2))
    np.testing.assert_allclose(track.at(0)[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)


def test_tree_composes_along_the_way() -> None:
    """world -> arm -> hand and world -> mast -> camera, arm and mast moving."""
    T_world_arm, T_world_mast = random_poses(2, 1), random_poses(2, 2)
    T_arm_hand, T_mast_camera = random_poses(2, 3)
    tree = TransformTree(0.5)
    for k in range(2):
        for child, T in (("arm", T_world_arm[k]), ("/mast", T_world_mast[k])):
            tree.add("/world", child, START + 100 * MS * k, T[:3, 3].tolist(), quaternion(T))
    for parent, child, T in (("arm", "hand", T_arm_hand), ("mast", "camera", T_mast_camera)):
        tree.add(parent, child, 0, T[:3, 3].tolist(), quaternion(T), static=True)

    def between(poses: Array) -> Array:
        T = np.eye(4)
        T[:3, :3] = Slerp([0, 1], Rotation.from_matrix(poses[:, :3, :3]))(0.3).as_matrix()
        T[:3, 3] = 0.7 * poses[0, :3, 3] + 0.3 * poses[1, :3, 3]
        return T

    expected = (
        np.linalg.inv(between(T_world_mast) @ T_mast_camera) @ between(T_world_arm) @ T_arm_hand
    )
    time_ns = START + 30 * MS
    np.testing.assert_allclose(tree.T("camera", "hand", time_ns), expected, atol=1e-9)
    np.testing.assert_allclose(tree.T("hand", "camera", time_ns), inverse(expected), atol=1e-9)
    np.testing.assert_allclose(tree.T("hand", "hand", 0), np.eye(4))
    assert tree.frames == ["arm", "camera", "hand", "mast", "world"]
    wrist = TreeWrist(tree, "arm", T_arm_hand)
    np.testing.assert_allclose(wrist.T_camera_hand(time_ns, "camera"), expected, atol=1e-9)
    of_topic = TopicWrist(track_of([time_ns], T_arm_hand[None]), "arm", tree, np.eye(4))
    np.testing.assert_allclose(of_topic.T_camera_hand(time_ns, "camera"), expected, atol=1e-9)


def test_tree_needs_only_the_frames_on_the_way() -> None:
    tree = TransformTree(0.5)
    unit = (0, 0, 0, 1)
    tree.add("world", "base", 0, (0, 0, 0), unit)  # told once, long ago
    tree.add("base", "camera", 0, (0, 0, 0), unit, static=True)
    tree.add("base", "hand", 0, (0, 0, 1), unit, static=True)
    np.testing.assert_allclose(tree.T("camera", "hand", START)[:3, 3], (0, 0, 1))
    with pytest.raises(NoPose, match="the pose of base in world is last told"):
        tree.T("world", "hand", START)


def test_frames_that_do_not_hang_together() -> None:
    tree = TransformTree(0.5)
    tree.add("a", "b", 0, (0, 0, 0), (0, 0, 0, 1))
    assert tree.connected("a", "b")
    assert not tree.connected("b", "c")
    with pytest.raises(NoPose, match="does not connect b with c"):
        tree.T("b", "c", 0)


def test_a_circle_is_no_tree() -> None:
    tree = TransformTree(0.5)
    tree.add("a", "b", 0, (0, 0, 0), (0, 0, 0, 1), static=True)
    tree.add("b", "a", 0, (0, 0, 0), (0, 0, 0, 1), static=True)
    with pytest.raises(NoPose, match="circle"):
        tree.T("a", "b", 0)
