"""The wrist's pose in a recording: read ahead, so that every image finds the poses around it."""

from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from inhand.errors import InputError
from inhand.streams.config import StreamConfig
from inhand.streams.pose_track import PoseTrack
from inhand.streams.ros_types import POSE, stamp_ns
from inhand.streams.source import NoPose, Wrist
from inhand.streams.topics import (
    Topics,
    check_topic,
    list_topics,
    only_one,
    pose_topics,
    transform_topics,
)
from inhand.streams.transform_tree import TransformTree, plain_name
from inhand.streams.wrist import ConstantWrist, TopicWrist, TreeWrist

Read = Callable[[Collection[str]], Iterator[tuple[str, Any]]]
"""Reads all messages of some topics: topic and message."""


class FoundWrist(NamedTuple):
    """A wrist, and where it was found."""

    wrist: Wrist
    description: str


def find_wrist(topics: Topics, read: Read, config: StreamConfig, camera_frame: str) -> FoundWrist:
    """The wrist as the user chose it, else from tf, else from the only topic of poses.

    Args:
        topics: what the recording has.
        read: reads messages of it.
        config: what the user chose.
        camera_frame: the frame of the depth images.

    Raises:
        InputError: the recording does not tell the wrist's pose, or leaves a choice.
    """
    if config.T_camera_hand is not None:
        return FoundWrist(ConstantWrist(config.T_camera_hand), "as given, the same for all images")
    if config.hand_frame and config.pose_topic:
        raise InputError("give --hand-frame or --pose-topic, not both")
    T_frame_hand = np.eye(4) if config.T_frame_hand is None else config.T_frame_hand
    tree = _read_tree(topics, read, config.longest_gap)
    frame = config.hand_frame or (config.root_link if config.root_link in tree.frames else None)
    if frame and not config.pose_topic:
        _check_connected(tree, frame, camera_frame, "--hand-frame")
        wrist = TreeWrist(tree, frame, T_frame_hand)
        return FoundWrist(wrist, f"tf, frame {frame} in {camera_frame}")
    topic = _choose_pose_topic(topics, tree, config)
    track, parent = _read_track(topic, read, config.longest_gap)
    if parent != camera_frame:
        _check_connected(tree, parent, camera_frame, "--pose-topic")
    wrist_of_topic = TopicWrist(track, parent, tree, T_frame_hand)
    return FoundWrist(wrist_of_topic, f"{topic}, in frame {parent}")


def _choose_pose_topic(topics: Topics, tree: TransformTree, config: StreamConfig) -> str:
    if config.pose_topic:
        return check_topic(topics, config.pose_topic, [POSE], "--pose-topic")
    if found := pose_topics(topics):
        return only_one(found, topics, "poses", "--pose-topic", "or --hand-frame FRAME")
    raise InputError(
        f'the recording does not tell the wrist\'s pose: tf has no frame "{config.root_link}", the '
        f"hand's root link, and there is no topic of {POSE}. Give --hand-frame FRAME, --pose-topic "
        "TOPIC or, for a camera that does not move against the wrist, --hand-pose FILE. Frames in "
        f"tf: {', '.join(tree.frames) or 'none'}; topics: {list_topics(topics)}"
    )


def _read_tree(topics: Topics, read: Read, longest_gap: float) -> TransformTree:
    tree = TransformTree(longest_gap)
    for topic, message in read(transform_topics(topics)):
        static = topic.endswith("tf_static")
        for transform in message.transforms:
            t, q = transform.transform.translation, transform.transform.rotation
            with suppress(ValueError):  # as tf2: a pose that is none is left out
                tree.add(
                    transform.header.frame_id,
                    transform.child_frame_id,
                    stamp_ns(transform.header),
                    (t.x, t.y, t.z),
                    (q.x, q.y, q.z, q.w),
                    static=static,
                )
    return tree


def _read_track(topic: str, read: Read, longest_gap: float) -> tuple[PoseTrack, str]:
    """The poses of a topic, and the frame that they are in."""
    track, parents = PoseTrack("the wrist's pose", longest_gap), set()
    for _, message in read([topic]):
        p, q = message.pose.position, message.pose.orientation
        with suppress(ValueError):
            track.add(stamp_ns(message.header), (p.x, p.y, p.z), (q.x, q.y, q.z, q.w))
            parents.add(plain_name(message.header.frame_id))
    if len(parents) != 1:
        raise InputError(
            f"--pose-topic: the poses of {topic} must be in one frame, they are in "
            f"{', '.join(sorted(parents)) or 'none'}"
        )
    return track, parents.pop()


def _check_connected(tree: TransformTree, frame: str, camera_frame: str, option: str) -> None:
    try:
        connected = tree.connected(camera_frame, frame)
    except NoPose as problem:
        raise InputError(f"{option}: {problem}") from problem
    if not connected:
        raise InputError(
            f"{option}: tf does not connect {frame} with the camera's frame {camera_frame}; "
            f"frames in tf: {', '.join(tree.frames) or 'none'}"
        )
