"""Results as a ROS recording: the poses of object and wrist, the joints, and detections."""

import sqlite3
from contextlib import suppress
from pathlib import Path

from rosbags import rosbag1, rosbag2

from inhand.errors import InputError
from inhand.object_model import ObjectModel
from inhand.streams.bag import BagKind
from inhand.streams.new_file import check_new
from inhand.streams.result_messages import TYPE_OF_TOPIC, ResultMessages
from inhand.streams.ros_types import standard_types
from inhand.streams.runner import Result, Summary
from inhand.streams.vision_messages import add_vision_messages

STORAGE = {"sqlite3": rosbag2.StoragePlugin.SQLITE3, "mcap": rosbag2.StoragePlugin.MCAP}
FAULTS = (OSError, sqlite3.Error)
"""What a full disk raises."""


class ResultsBag:
    """Writes a ROS 1 bag (a file) or a ROS 2 bag (a folder).

    Args:
        path: what does not exist yet.
        kind: ROS 1, or ROS 2's storage.
        obj: the object, for its name and its box.

    Raises:
        InputError: it exists, or cannot be written.
    """

    def __init__(self, path: Path, kind: BagKind, obj: ObjectModel) -> None:
        check_new(path)
        if kind == "ros1" and path.suffix != ".bag":
            raise InputError(f"the name of a ROS 1 bag ends in .bag, got {path}")
        types = standard_types(kind)
        add_vision_messages(types, kind)
        self._path, self._broken = path, False
        self._messages = ResultMessages(types, kind, obj)
        self._serialise = types.serialize_ros1 if kind == "ros1" else types.serialize_cdr
        self._writer = _make_writer(path, kind)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer.open()
            self._topics = {
                topic: self._writer.add_connection(topic, name, typestore=types)
                for topic, name in TYPE_OF_TOPIC.items()
            }
        except FAULTS as error:
            self._abort()
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"cannot write {path}: {reason}") from error

    def write(self, result: Result) -> None:
        """See `runner.Output.write`."""
        for topic, message in self._messages.of(result).items():
            data = self._serialise(message, TYPE_OF_TOPIC[topic])
            try:
                self._writer.write(self._topics[topic], result.frame.time_ns, data)
            except FAULTS as error:
                raise self._give_up(error) from error

    def finish(self, summary: Summary) -> None:
        """See `runner.Output.finish`."""
        if self._broken:
            return
        try:
            self._writer.close()
        except FAULTS as error:
            raise self._give_up(error) from error

    def _give_up(self, error: Exception) -> InputError:
        """Leave what is written as it is: a recording without its index."""
        self._broken = True
        self._abort()
        reason = getattr(error, "strerror", None) or error
        return InputError(
            f"cannot write {self._path}: {reason}; it is cut short, and the results up to there "
            "are in the JSON lines"
        )

    def _abort(self) -> None:
        """Close the file, whose rest may not fit on the disk."""
        with suppress(Exception):
            self._writer.abort()


def _make_writer(path: Path, kind: BagKind) -> rosbag1.Writer | rosbag2.Writer:
    if kind == "ros1":
        return rosbag1.Writer(path)
    return rosbag2.Writer(path, version=9, storage_plugin=STORAGE[kind])
