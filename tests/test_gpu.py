"""Estimates and tracks on a GPU, where there is one, are those of the CPU."""

from collections.abc import Iterable

import numpy as np
import pytest
import warp as wp
from test_tracker import MOVING, Film

from inhand import EstimatorConfig, Hand, PoseEstimate, PoseEstimator, PoseTracker
from inhand.geometry.se3 import transform
from inhand.object_model import ObjectModel
from inhand.packed import PackedHand, PackedObject
from inhand.stages.clustering import surface_distances_to
from inhand.synth.scene import Scene

pytestmark = pytest.mark.skipif(not wp.is_cuda_available(), reason="there is no GPU here")

SAME = 1e-4
"""Surfaces this near to each other are at the same place [m]."""


def check_same(
    here: PoseEstimate, there: PoseEstimate, hand: Hand, obj: ObjectModel, seen: Iterable[bool]
) -> None:
    """The object, but for its symmetries, and the links that are `seen` are at the same place.

    A hidden finger is a guess, and rounding decides between guesses that are as good.
    """
    assert here.found
    assert there.found
    poses = (np.asarray(e.T_camera_object, dtype=np.float32) for e in (here, there))
    packed = PackedObject(obj, "cpu")
    assert surface_distances_to(next(poses)[None], next(poses), packed, 0.1)[0] < SAME
    links = zip(surface_of(hand, here), surface_of(hand, there), seen, strict=True)
    assert max(np.linalg.norm(a - b, axis=1).max() for a, b, shows in links if shows) < SAME
    assert there.confidence == pytest.approx(here.confidence, abs=0.01)


def surface_of(hand: Hand, e: PoseEstimate) -> list[np.ndarray]:
    """Surface samples [m] of every link, (n, 3), camera frame."""
    q = np.array([[e.joint_positions[name] for name in hand.joint_names]])
    poses = PackedHand(hand, "cpu").link_poses(q, np.asarray(e.T_camera_hand)[None])[0]
    return [transform(T, link.surface.points) for T, link in zip(poses, hand.links, strict=True)]


@pytest.mark.parametrize("number", range(8))
def test_estimates_are_those_of_the_cpu(scenes: list[Scene], number: int) -> None:
    scene = scenes[number]
    (here, stages), (there, _) = (
        PoseEstimator(scene.hand, scene.obj, EstimatorConfig(), device).run(
            scene.depth, scene.camera, scene.T_camera_hand_given
        )
        for device in ("cpu", "cuda:0")
    )
    assert stages.hand_state is not None
    check_same(here, there, scene.hand, scene.obj, stages.hand_state.certain)


def test_tracks_are_those_of_the_cpu() -> None:
    film = Film("can", MOVING, 8, seed=1)
    here, there = (PoseTracker(film.hand, film.obj, device=d) for d in ("cpu", "cuda:0"))
    for i in range(8):
        every_link = [True] * len(film.hand.links)
        check_same(film.show(here, i), film.show(there, i), film.hand, film.obj, every_link)
