"""The paper's correction of the wrist pose: ICP of the wrist's model against the scene cloud
(section IV-A)."""

import numpy as np
import warp as wp

from inhand.config import WristConfig
from inhand.kernels.launch import launch
from inhand.kernels.point_to_plane import RigidModel, align_to_points
from inhand.packed import PackedHand
from inhand.stages.observation import Observation
from inhand.stages.results import Wrist


def fit_wrist_icp(observation: Observation, hand: PackedHand, config: WristConfig) -> Wrist:
    """Point-to-plane ICP of the links that are rigid with the hand's root.

    Nothing holds the directions that the visible part of the wrist leaves open.
    """
    links, palm = hand.hand.links, list(hand.hand.palm_links)
    if not palm:
        return Wrist(observation.T_camera_hand)
    device = hand.device
    T_hand_link = hand.hand.forward_kinematics((hand.hand.lower + hand.hand.upper) / 2)
    vertices = np.concatenate(
        [links[i].mesh.vertices @ T_hand_link[i, :3, :3].T + T_hand_link[i, :3, 3] for i in palm]
    )
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    model = RigidModel()
    model.fields = hand.fields
    model.T_model_part = wp.array(T_hand_link, dtype=wp.mat44, device=device)
    used = np.isin(np.arange(len(links)), palm).astype(np.int32)
    model.used = wp.array(used, dtype=int, device=device)
    model.centre = wp.vec3(*centre)
    model.radius = float(np.linalg.norm(vertices - centre, axis=1).max())
    # A copy: the kernel moves it.
    pose = wp.array([observation.T_camera_hand], dtype=wp.mat44, device=device)
    inputs = [
        model,
        *observation.cloud_on_device,
        config.max_distance,
        float(np.cos(config.max_normal_angle)),
        config.iterations,
        pose,
    ]
    launch(align_to_points, 1, inputs, device)
    return Wrist(pose.numpy()[0].astype(np.float64))
