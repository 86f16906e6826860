"""Which topics of a recording hold what: found by type, or chosen by the user."""

from collections.abc import Iterable, Mapping

from inhand.errors import InputError
from inhand.streams.bag import Topic
from inhand.streams.ros_types import (
    CAMERA_INFO,
    COMPRESSED_IMAGE,
    EARLY_TRANSFORMS,
    IMAGE,
    POSE,
    TRANSFORMS,
)

Topics = Mapping[str, Topic]


def image_topics(topics: Topics) -> list[str]:
    """Topics that may hold depth, by their type."""
    return _of_type(topics, IMAGE, COMPRESSED_IMAGE)


def transform_topics(topics: Topics) -> list[str]:
    """Topics of tf."""
    return _of_type(topics, TRANSFORMS, EARLY_TRANSFORMS)


def pose_topics(topics: Topics) -> list[str]:
    """Topics that may hold the wrist's pose."""
    return _of_type(topics, POSE)


def choose_camera_topic(topics: Topics, depth_topic: str) -> str:
    """The topic with the camera info of a depth topic.

    ROS's convention goes first: `camera_info` beside the image's topic.

    Raises:
        InputError: there is none, or several without one beside the image.
    """
    found = _of_type(topics, CAMERA_INFO)
    # A compressed image's topic is one level below that of the image.
    folders = [depth_topic.rsplit("/", 1)[0], depth_topic.rsplit("/", 2)[0]]
    beside = [f"{folder}/camera_info" for folder in folders]
    if near := [topic for topic in beside if topic in found]:
        return near[0]
    return only_one(found, topics, "camera info", "--camera-topic", "or --camera FILE")


def check_topic(topics: Topics, topic: str, kinds: Iterable[str], option: str) -> str:
    """A topic that the user chose.

    Raises:
        InputError: the recording lacks it, or it is of another type.
    """
    if topic not in topics:
        raise InputError(
            f"{option}: the recording has no topic {topic}; it has: {list_topics(topics)}"
        )
    if topics[topic].type not in kinds:
        raise InputError(
            f"{option}: {topic} is of type {topics[topic].type}, expected {' or '.join(kinds)}"
        )
    return topic


def only_one(found: list[str], topics: Topics, what: str, option: str, other: str = "") -> str:
    """The only topic found.

    Raises:
        InputError: there is none, or there are several.
    """
    if len(found) == 1:
        return found[0]
    choose = f"{option} TOPIC {other}".strip()
    if found:
        raise InputError(
            f"the recording has several topics of {what}; choose one by {choose}: "
            f"{', '.join(found)}"
        )
    raise InputError(
        f"the recording has no topic of {what}; give {choose}; it has: {list_topics(topics)}"
    )


def list_topics(topics: Topics) -> str:
    """All topics with their types, for a message."""
    listed = (f"{name} ({topic.type}, {topic.messages})" for name, topic in sorted(topics.items()))
    return ", ".join(listed) or "nothing"


def _of_type(topics: Topics, *kinds: str) -> list[str]:
    return sorted(name for name, topic in topics.items() if topic.type in kinds and topic.messages)
