"""Fingers that were lost out of sight, looked for again where the image may show them."""

from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from inhand.kernels.depth import pinhole
from inhand.kernels.hand_depth import trace_bodies
from inhand.kernels.launch import launch
from inhand.packed import PackedHand, PackedObject, PackedPart, device_poses
from inhand.stages.hand_visibility import HandVisibility
from inhand.stages.observation import Observation
from inhand.tracking.config import TrackerConfig
from inhand.tracking.gaussian import Array
from inhand.tracking.track import Track, joint_scale


def find_lost_fingers(
    observation: Observation,
    hand: PackedHand,
    obj: PackedObject,
    track: Track,
    config: TrackerConfig,
    rng: np.random.Generator,
) -> Track:
    """The track with every finger that the last image did not support where this image shows it.

    Configurations near the last one and all over the finger's range are scored as the estimator
    does. What the rest of the hand or the object hides or explains says nothing. A finger that no
    configuration explains clearly better stays where it is.

    Args:
        observation: the image.
        hand, obj: the models.
        track: the track as predicted.
        config: parameters.
        rng: source of the configurations.
    """
    c, shared = config.fingers, config.finger_score
    visibility = HandVisibility(observation, hand, shared)
    q, covariance = track.joint_vector.copy(), track.hand_covariance.copy()
    scale = joint_scale(hand.hand, config)
    for finger in hand.fingers:
        if track.certain[finger.links].all():
            continue
        joints = finger.joints
        tried = _configurations(finger, q, scale, hand, config, rng)
        others = _others(observation, hand, obj, finger, track, q, config)
        wrist = track.T_camera_hand[None]
        score = visibility.score(
            finger, tried, wrist, others, shared.coarse_tolerance, shared.coarse_points
        ).strict
        best = int(score.argmax())
        if score[best] < max(score[0] + c.lead, c.least):
            continue
        q[joints] = tried[best]
        at = 6 + joints
        covariance[at], covariance[:, at] = 0.0, 0.0
        covariance[at, at] = (config.start.joint * scale[joints]) ** 2
    return replace(track, joint_vector=q, hand_covariance=covariance)


def _configurations(
    finger: PackedPart,
    q: Array,
    scale: Array,
    hand: PackedHand,
    config: TrackerConfig,
    rng: np.random.Generator,
) -> Array:
    """Joints (c, k) of a finger: as they are, around that, and anywhere."""
    c, joints = config.fingers, finger.joints
    lower, upper = hand.hand.lower[joints], hand.hand.upper[joints]
    near = q[joints] + rng.normal(0, c.spread, (c.near, len(joints))) * scale[joints]
    anywhere = rng.uniform(lower, upper, (c.anywhere, len(joints)))
    return np.clip(np.concatenate([q[None, joints], near, anywhere]), lower, upper)


def _others(
    observation: Observation,
    hand: PackedHand,
    obj: PackedObject,
    finger: PackedPart,
    track: Track,
    q: Array,
    config: TrackerConfig,
) -> Any:
    """Depth [m] of all but one finger, flat, at every `render_step`-th pixel."""
    coarse = observation.camera.subsampled(config.fingers.render_step)
    shown = np.ones(len(hand.hand.links), dtype=bool)
    shown[finger.links] = False
    depth = hand.render(coarse, hand.link_poses(q[None], track.T_camera_hand[None])[0], shown)
    everywhere = np.array([[0, 0, coarse.width, coarse.height]], dtype=np.int32)
    launch(
        trace_bodies,
        coarse.width * coarse.height,
        [pinhole(coarse), obj.fields, device_poses(track.T_camera_object, obj.device)]
        + [
            wp.array(everywhere, dtype=wp.vec4i, device=obj.device),
            wp.vec4i(*everywhere[0]),
            depth,
            wp.empty(0, dtype=int, device=obj.device),
        ],
        obj.device,
        work_per_item=10,
    )
    return depth
