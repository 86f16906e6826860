"""The paper's choice among object poses: agreement of the rendered depth, then LCP
(section IV-C)."""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from inhand.config import SelectionConfig
from inhand.geometry.se3 import transform
from inhand.kernels.depth import pinhole
from inhand.kernels.discrepancy import EMPTY, depth_discrepancy
from inhand.kernels.launch import computed
from inhand.packed import PackedHand, PackedObject, device_poses
from inhand.stages.lcp import segment_lcp
from inhand.stages.observation import Observation
from inhand.stages.results import HandState, PoseSet, Segment


def select_by_rendering(
    poses: PoseSet,
    observation: Observation,
    hand_state: HandState,
    hand: PackedHand,
    obj: PackedObject,
    segment: Segment,
    config: SelectionConfig,
) -> PoseSet:
    """The share of the poses with the smallest depth discrepancy, by falling LCP."""
    discrepancy = depth_discrepancies(poses, observation, hand_state, hand, obj, config)
    count = int(np.ceil(config.keep_share * len(poses)))
    kept = poses.take(np.argsort(discrepancy, kind="stable")[:count])
    lcp = segment_lcp(kept.T_camera_object, segment, obj, config)
    order = np.argsort(-lcp, kind="stable")
    return PoseSet(kept.T_camera_object[order], lcp[order])


def depth_discrepancies(
    poses: PoseSet,
    observation: Observation,
    hand_state: HandState,
    hand: PackedHand,
    obj: PackedObject,
    config: SelectionConfig,
) -> NDArray[np.float32]:
    """Mean difference [m] of observed and rendered depth of every pose, shape (m,).

    Hand and object are rendered together, on a grid of rays about `config.ray_spacing` apart.
    """
    device, camera = obj.device, observation.camera
    step = max(1, round(config.ray_spacing * camera.fx / hand_state.T_camera_hand[2, 3]))
    view = camera.subsampled(step)
    observed = _observed(observation, hand, obj, step, config)
    hand_depth, _ = hand.renderer.render_on_device(view, hand_state.T_camera_link)
    inputs = [
        pinhole(view),
        wp.array(observed.reshape(-1), dtype=float, device=device),
        hand_depth,
        obj.renderer.mesh_ids,
        obj.renderer.spheres,
        device_poses(poses.T_camera_object, device),
        config.max_discrepancy,
    ]
    shape, work = (len(poses), view.height), 10 * view.width
    total = computed(depth_discrepancy, shape, float, inputs, device, work_per_item=work)
    known = max(1, int((observed > 0).sum()))
    return np.asarray(total.sum(axis=1) / known)


def _observed(
    observation: Observation,
    hand: PackedHand,
    obj: PackedObject,
    step: int,
    config: SelectionConfig,
) -> NDArray[np.float32]:
    """Every `step`-th observed depth [m], EMPTY where the camera saw nothing in reach, 0 where it
    is not known what it saw."""
    depth = observation.depth[::step, ::step].copy()
    missing = observation.view.missing.numpy().reshape(observation.depth.shape)
    depth[(depth <= 0) & (missing[::step, ::step] >= config.empty_share)] = EMPTY
    centre, radius = hand.hand.reach
    middle = transform(observation.T_camera_hand, centre[None])[0]
    depth[depth > middle[2] + radius + obj.model.diameter] = EMPTY
    return depth
