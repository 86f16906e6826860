"""What an open ROS recording is, whatever its format."""

from collections.abc import Collection, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Literal, NamedTuple, Protocol

from inhand.errors import InputError

BagKind = Literal["ros1", "sqlite3", "mcap"]
"""A ROS 1 bag, or a ROS 2 bag by its storage."""
KIND_OF_SUFFIX: dict[str, BagKind] = {".bag": "ros1", ".db3": "sqlite3", ".mcap": "mcap"}
METADATA = "metadata.yaml"
"""In the folder of a ROS 2 bag."""


class DamagedRecording(InputError):
    """A recording breaks off; what came before was read."""


class Message(NamedTuple):
    """One message of a recording, serialised."""

    topic: str
    type: str
    """Such as sensor_msgs/msg/Image, for ROS 1 too."""
    time_ns: int
    """When it was recorded [ns]."""
    data: bytes


class Topic(NamedTuple):
    """What a recording holds of a topic."""

    type: str
    messages: int
    """How many."""


class Bag(Protocol):
    """An open recording."""

    kind: BagKind
    topics: dict[str, Topic]
    damage: str
    """Why it could not be opened as a whole; empty if it could."""

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """The messages of some topics, in the order in which they were recorded.

        Raises:
            DamagedRecording: the recording breaks off here.
        """
        ...

    def close(self) -> None:
        """Close the files."""
        ...


def is_recording(path: Path) -> bool:
    """Whether `path` looks like a recording: a file's ending, or a folder's files, say so."""
    if path.is_dir():
        return (path / METADATA).exists() or bool(storage_files(path))
    return path.suffix in KIND_OF_SUFFIX


def storage_files(folder: Path) -> list[Path]:
    """The files of a ROS 2 bag's folder, in the order in which they were recorded."""
    files = [
        file
        for file in folder.iterdir()
        if Path(file.name.removesuffix(".zstd")).suffix in (".db3", ".mcap")
    ]
    return sorted(files, key=lambda file: (len(file.name), file.name))


def need_rosbags() -> None:
    """Raise InputError, with what to do, if the library for recordings is not installed."""
    if find_spec("rosbags") is None:
        raise InputError("ROS recordings need the library rosbags: pip install 'inhand[streams]'")
