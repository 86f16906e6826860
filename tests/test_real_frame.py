"""The one frame of a real sensor in the development data, against an independent offline fit."""

import json
from pathlib import Path

import numpy as np
import pytest

from inhand.camera import Camera
from inhand.estimate import PoseEstimate
from inhand.estimator import PoseEstimator, StageResults
from inhand.geometry.se3 import rotation_angle
from inhand.hand import Hand
from inhand.io import read_depth, read_transform
from inhand.kernels.depth import DepthRenderer
from inhand.object_model import ObjectModel

NEAR_FINGER = ("base_to_finger_1_1", "finger_1_1_to_finger_1_2")
# Where the object shows between the fingertips, read off the colour image (u, v) [pixel].
OBJECT_SEEN_AT = (367, 270)


class RealFrame:
    """The frame, its estimate and the reference."""

    def __init__(self, data: Path) -> None:
        folder = data / "real_frame"
        self.camera = Camera.from_json(folder / "camera.json")
        self.depth = read_depth(folder / "depth.png", self.camera)
        self.hand = Hand.from_urdf(data / "hands/t42/hand_T42b.urdf")
        self.object = ObjectModel.from_mesh(data / "objects/elliptic_cylinder.ply")
        self.reference = json.loads((folder / "reference_fit.json").read_text())
        estimator = PoseEstimator(self.hand, self.object, device="cpu")
        self.estimate: PoseEstimate
        self.stages: StageResults
        self.estimate, self.stages = estimator.run(
            self.depth, self.camera, read_transform(folder / "hand_pose.json")
        )


@pytest.fixture(scope="module")
def frame(shared_data: Path) -> RealFrame:
    return RealFrame(shared_data)


def test_wrist_is_near_the_reference(frame: RealFrame) -> None:
    T, reference = frame.estimate.T_camera_hand, np.array(frame.reference["T_camera_hand"])
    assert T is not None
    assert np.linalg.norm(T[:3, 3] - reference[:3, 3]) < 0.003
    assert rotation_angle(T[:3, :3], reference[:3, :3]) < np.radians(1)


def test_near_finger_is_near_the_reference(frame: RealFrame) -> None:
    for joint in NEAR_FINGER:
        reference = np.radians(frame.reference["joint_positions_deg"][joint])
        assert abs(frame.estimate.joint_positions[joint] - reference) < np.radians(4)


def test_rendered_hand_agrees_with_the_readings(frame: RealFrame) -> None:
    state, pose = frame.stages.hand_state, frame.estimate.T_camera_object
    assert state is not None
    assert pose is not None
    meshes = [*(link.mesh for link in frame.hand.links), frame.object.mesh]
    poses = np.concatenate([state.T_camera_link, pose[None]])
    depth, index = DepthRenderer(meshes).render(frame.camera, poses)
    on_hand = (index >= 0) & (index < len(meshes) - 1) & (frame.depth > 0)
    assert on_hand.sum() > 30_000
    assert np.median(np.abs(frame.depth - depth)[on_hand]) < 0.0016


def test_object_lies_where_the_picture_shows_it(frame: RealFrame) -> None:
    assert frame.estimate.found
    assert frame.estimate.T_camera_object is not None
    renderer = DepthRenderer([frame.object.mesh])
    silhouette, _ = renderer.render(frame.camera, frame.estimate.T_camera_object[None])
    u, v = OBJECT_SEEN_AT
    assert silhouette[v, u] > 0
    assert abs(silhouette[v, u] - frame.depth[v, u]) < 0.005
