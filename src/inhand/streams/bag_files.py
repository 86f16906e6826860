"""ROS 1 and ROS 2 recordings: opened with `rosbags`, or as far as they are whole."""

from collections.abc import Collection, Iterator
from pathlib import Path

from rosbags import rosbag1, rosbag2

from inhand.errors import InputError
from inhand.streams.bag import (
    KIND_OF_SUFFIX,
    Bag,
    BagKind,
    DamagedRecording,
    Message,
    Topic,
    storage_files,
)
from inhand.streams.salvage import salvage


def open_bag(path: Path) -> Bag:
    """Open a ROS 1 bag, a ROS 2 bag's folder, or one of its .db3 or .mcap files.

    A damaged recording is opened as far as it is whole; its messages then end in an error.

    Raises:
        InputError: there is no such file, or nothing in it can be read.
    """
    if not path.exists():
        raise InputError(f"there is no recording {path}")
    files = storage_files(path) if path.is_dir() else [path]
    kind = KIND_OF_SUFFIX[Path(files[0].name.removesuffix(".zstd")).suffix] if files else "mcap"
    try:
        return IndexedBag(path, kind)
    except PermissionError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from error
    except Exception as error:  # damaged files make the library raise nearly anything
        reason = _what_is_wrong(error)
    if (bag := salvage(files, kind, reason)) is not None:
        return bag
    raise InputError(f"nothing in the recording {path} can be read: {reason}")


class IndexedBag:
    """A whole recording, read with `rosbags`.

    Args:
        path: as for `open_bag`.
        kind: what it is.
    """

    def __init__(self, path: Path, kind: BagKind) -> None:
        self.kind, self.damage = kind, ""
        self._path = path
        self._reader = self._open()
        counts: dict[str, int] = {}
        for c in self._reader.connections:
            counts[c.topic] = counts.get(c.topic, 0) + c.msgcount
        self.topics = {c.topic: Topic(c.msgtype, counts[c.topic]) for c in self._reader.connections}

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """See `Bag.messages`."""
        connections = [c for c in self._reader.connections if c.topic in topics]
        if not connections:  # for which `rosbags` would read all
            return
        try:
            for connection, time_ns, data in self._reader.messages(connections):
                yield Message(connection.topic, connection.msgtype, time_ns, data)
        except Exception as error:  # as above
            self._reader.close()
            self._reader = self._open()  # the ROS 1 reader does not survive damage
            raise DamagedRecording(
                f"{self._path} is damaged, and was read up to there: {_what_is_wrong(error)}"
            ) from error

    def close(self) -> None:
        """See `Bag.close`."""
        self._reader.close()

    def _open(self) -> rosbag1.Reader | rosbag2.Reader:
        path = self._path
        reader = rosbag1.Reader(path) if self.kind == "ros1" else rosbag2.Reader(path)
        reader.open()
        return reader


def _what_is_wrong(error: Exception) -> str:
    """What the library says of a damaged file; of some damage it says nothing."""
    return str(error).rstrip(".") or "its parts do not fit together"
