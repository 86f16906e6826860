"""Estimates and tracks on a GPU, where there is one, are those of the CPU."""

import pytest
import warp as wp
from scipy.spatial import KDTree
from test_tracker import MOVING, Film

from inhand import EstimatorConfig, PoseEstimate, PoseEstimator, PoseTracker
from inhand.evaluation.metrics import adi, sample_model
from inhand.object_model import ObjectModel
from inhand.synth.scene import Scene

pytestmark = pytest.mark.skipif(not wp.is_cuda_available(), reason="there is no GPU here")


def check_same(here: PoseEstimate, there: PoseEstimate, obj: ObjectModel) -> None:
    """The same answer, but for rounding and symmetries of the object."""
    assert here.found == there.found
    assert here.T_camera_object is not None
    assert there.T_camera_object is not None
    tree = KDTree(sample_model(obj.mesh))
    assert adi(tree, there.T_camera_object, here.T_camera_object) < 1e-4
    assert there.T_camera_hand == pytest.approx(here.T_camera_hand, abs=1e-4)
    assert there.joint_positions == pytest.approx(here.joint_positions, abs=1e-3)
    assert there.confidence == pytest.approx(here.confidence, abs=0.01)


@pytest.mark.parametrize("number", range(8))
def test_estimates_are_those_of_the_cpu(scenes: list[Scene], number: int) -> None:
    scene = scenes[number]
    here, there = (
        PoseEstimator(scene.hand, scene.obj, EstimatorConfig(), device).estimate(
            scene.depth, scene.camera, scene.T_camera_hand_given
        )
        for device in ("cpu", "cuda:0")
    )
    check_same(here, there, scene.obj)


def test_tracks_are_those_of_the_cpu() -> None:
    film = Film("can", MOVING, 8, seed=1)
    here, there = (PoseTracker(film.hand, film.obj, device=d) for d in ("cpu", "cuda:0"))
    for i in range(8):
        check_same(film.show(here, i), film.show(there, i), film.obj)
