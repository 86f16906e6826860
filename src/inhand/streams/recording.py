"""A ROS recording as a source: depth images, camera info and the wrist's pose."""

from collections.abc import Collection, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.errors import InputError
from inhand.streams.bag import DamagedRecording, Message
from inhand.streams.bag_files import open_bag
from inhand.streams.bag_wrist import find_wrist
from inhand.streams.camera_info import read_camera_info
from inhand.streams.config import StreamConfig
from inhand.streams.depth_messages import decode_depth, find_encoding
from inhand.streams.ros_types import CAMERA_INFO, COMPRESSED_IMAGE, IMAGE, Decoder, stamp_ns
from inhand.streams.source import Arrival, Frame, NoPose
from inhand.streams.topics import check_topic, choose_camera_topic, image_topics, only_one
from inhand.streams.transform_tree import plain_name


class Recording:
    """A ROS 1 or ROS 2 recording; see `source.Source`.

    Args:
        path: a ROS 1 bag, a ROS 2 bag's folder, or one of its .db3 or .mcap files.
        config: what to take of it.

    Raises:
        InputError: it cannot be read, lacks what is needed, or leaves a choice.
    """

    def __init__(self, path: Path, config: StreamConfig) -> None:
        self._bag = open_bag(path)
        self._decoder = Decoder(self._bag.kind)
        self._damage: InputError | None = None
        self.name, self.kind = str(path), self._bag.kind
        try:
            self._choose(config)
        except InputError as error:
            self._bag.close()
            if damage := self._bag.damage:
                raise InputError(
                    f"{path} is damaged or was never finished ({damage}); in what could be read of "
                    f"it: {error}"
                ) from error
            raise

    def _choose(self, config: StreamConfig) -> None:
        """Find the topics, the camera and the wrist."""
        topics = self._bag.topics
        self._topic = self._choose_depth_topic(config.depth_topic)
        first = self._first(self._topic)
        frame_id = plain_name(first.header.frame_id)
        self._camera, camera_from = self._find_camera(config)
        _check_size(first, self._camera, camera_from)
        self._wrist, wrist_from = find_wrist(topics, self._read, config, frame_id)
        self.count = topics[self._topic].messages
        self.description = (
            f"depth: {self._topic}, {self.count} images",
            f"camera: {camera_from}",
            f"wrist: {wrist_from}",
            *([] if stamp_ns(first.header) else ["time: of recording; the images carry none"]),
        )

    def arrivals(self) -> Iterator[Arrival]:
        """See `source.Source.arrivals`."""
        for number, message in enumerate(self._messages([self._topic])):
            yield Arrival(message.time_ns, partial(self._frame, number, message))
        if self._damage is not None:
            raise self._damage

    def close(self) -> None:
        """See `source.Source.close`."""
        self._bag.close()

    def _frame(self, number: int, message: Message) -> Frame:
        time_ns, frame_id, problem = message.time_ns, "", ""
        depth: NDArray[np.float32] | None = None
        T_camera_hand: NDArray[np.float64] | None = None
        try:
            image = self._decoder.decode(message)
            time_ns = stamp_ns(image.header) or time_ns
            frame_id = plain_name(image.header.frame_id)
            depth = decode_depth(image, self._camera.depth_unit)
            T_camera_hand = self._wrist.T_camera_hand(time_ns, frame_id)
        except InputError as error:
            problem = str(error)
        except NoPose as error:
            problem = f"no wrist pose: {error}"
        return Frame(str(number), time_ns, frame_id, self._camera, depth, T_camera_hand, problem)

    def _choose_depth_topic(self, asked: str | None) -> str:
        topics = self._bag.topics
        if asked is not None:
            check_topic(topics, asked, [IMAGE, COMPRESSED_IMAGE], "--depth-topic")
        found, refused = [], []
        for topic in image_topics(topics) if asked is None else [asked]:
            try:
                find_encoding(self._first(topic))
                found.append(topic)
            except InputError as error:
                refused.append(f"{topic}: {error}")
        if not found and refused:
            raise InputError(f"the recording has no depth images: {'; '.join(refused)}")
        return only_one(found, topics, "depth images", "--depth-topic")

    def _find_camera(self, config: StreamConfig) -> tuple[Camera, str]:
        if config.camera is not None:
            return config.camera, "as given"
        topics, topic = self._bag.topics, config.camera_topic
        if topic is None:
            topic = choose_camera_topic(topics, self._topic)
        check_topic(topics, topic, [CAMERA_INFO], "--camera-topic")
        rectified = "image_rect" in self._topic
        return read_camera_info(self._first(topic), topic, rectified=rectified), topic

    def _first(self, topic: str) -> Any:
        """The first message of a topic that is not damaged.

        Raises:
            InputError: there is none.
        """
        problem: InputError | None = None
        for message in self._messages([topic]):
            try:
                return self._decoder.decode(message)
            except InputError as error:  # it will be reported in its turn
                problem = problem or error
        raise problem or self._damage or InputError(f"the topic {topic} holds no message")

    def _read(self, topics: Collection[str]) -> Iterator[tuple[str, Any]]:
        """Topic and content of messages; damage is kept for the end of the run."""
        for message in self._messages(topics):
            try:
                yield message.topic, self._decoder.decode(message)
            except InputError as error:
                self._damage = error

    def _messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Messages; damage is kept for the end of the run."""
        try:
            yield from self._bag.messages(topics)
        except DamagedRecording as error:
            self._damage = error


def _check_size(image: Any, camera: Camera, camera_from: str) -> None:
    """Raise InputError if a message's image has another size than the camera."""
    try:
        height, width = decode_depth(image, camera.depth_unit).shape
    except InputError:  # only this image is damaged: its frame will say so
        return
    if (width, height) != (camera.width, camera.height):
        raise InputError(
            f"the depth images have {width} x {height} pixels but the camera ({camera_from}) "
            f"{camera.width} x {camera.height}; choose another by --camera-topic or --camera"
        )
