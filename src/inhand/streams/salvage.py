"""Reading recordings that are damaged or were never finished, as far as they are whole.

`rosbags` needs the index at a recording's end, which a full disk or a crash leaves out. Here files
are read from the front, record by record, until something is wrong.
"""

import bz2
import io
import sqlite3
import struct
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import closing
from pathlib import Path
from typing import BinaryIO, NamedTuple

import lz4.frame
from backports import zstd
from rosbags.typesys.msg import normalize_msgtype

from inhand.streams.bag import BagKind, DamagedRecording, Message, Topic

# Each unpacks what there is of a block that is cut short.
UNPACK: dict[str, Callable[[bytes], bytes]] = {
    "": bytes,
    "none": bytes,
    "bz2": lambda data: bz2.BZ2Decompressor().decompress(data),
    "lz4": lambda data: lz4.frame.LZ4FrameDecompressor().decompress(data),
    "zstd": lambda data: zstd.ZstdDecompressor().decompress(data),
}
ROS1_MAGIC = b"#ROSBAG V2.0\n"
MCAP_MAGIC = b"\x89MCAP0\r\n"


class Broken(Exception):
    """The file is not whole from here on."""


class SalvagedBag:
    """A damaged recording; see `bag.Bag`.

    Args:
        files: its files, in the order in which they were recorded.
        kind: what they are.
        damage: why it could not be opened as a whole.
    """

    def __init__(self, files: list[Path], kind: BagKind, damage: str) -> None:
        self.kind = kind
        self._files = files
        self.damage = damage
        types: dict[str, str] = {}
        counts: Counter[str] = Counter()
        for message in self._whole_messages():
            types[message.topic] = message.type
            counts[message.topic] += 1
        self.topics = {topic: Topic(kind, counts[topic]) for topic, kind in types.items()}

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """See `bag.Bag.messages`."""
        yield from (message for message in self._whole_messages() if message.topic in topics)
        count = sum(topic.messages for topic in self.topics.values())
        raise DamagedRecording(
            f"{self._files[0]} is damaged or was never finished ({self.damage}): its first "
            f"{count} messages were read"
        )

    def close(self) -> None:
        """See `bag.Bag.close`."""

    def _whole_messages(self) -> Iterator[Message]:
        for file in self._files:
            try:
                yield from SCANNERS[self.kind](file)
            except Exception:  # damaged data may raise anything
                continue


def salvage(files: list[Path], kind: BagKind, damage: str) -> SalvagedBag | None:
    """What can be read of a damaged recording; None if nothing can."""
    bag = SalvagedBag(files, kind, damage)
    return bag if bag.topics else None


def scan_ros1(path: Path) -> Iterator[Message]:
    """The messages of a ROS 1 bag up to the first that is not whole."""
    with path.open("rb") as file:
        if file.read(len(ROS1_MAGIC)) != ROS1_MAGIC:
            raise Broken
        connections: dict[bytes, tuple[str, str]] = {}
        while True:
            header, size = _ros1_header(file)
            data = file.read(size)  # all there is of it
            if header["op"] != b"\x05":  # a chunk; messages and connections are in those
                continue
            chunk = io.BytesIO(UNPACK[header["compression"].decode()](data))
            while chunk.tell() < len(chunk.getbuffer()):
                header, size = _ros1_header(chunk)
                data = _exactly(chunk, size)
                if header["op"] == b"\x07":
                    fields = _ros1_fields(data)
                    kind = normalize_msgtype(fields["type"].decode())
                    connections[header["conn"]] = header["topic"].decode(), kind
                elif header["op"] == b"\x02":
                    seconds, nanoseconds = struct.unpack("<II", header["time"])
                    topic, kind = connections[header["conn"]]
                    yield Message(topic, kind, seconds * 10**9 + nanoseconds, data)


def _ros1_header(file: BinaryIO) -> tuple[dict[str, bytes], int]:
    """A record's header, and the length of its data, which follow."""
    header = _ros1_fields(_sized(file, "<I"))
    return header, _number(file, "<I")


def _ros1_fields(data: bytes) -> dict[str, bytes]:
    """`name=value` fields, each with its length before it."""
    fields, block = {}, io.BytesIO(data)
    while block.tell() < len(data):
        name, _, value = _sized(block, "<I").partition(b"=")
        fields[name.decode()] = value
    return fields


class _Channel(NamedTuple):
    topic: str
    schema: int


def scan_mcap(path: Path) -> Iterator[Message]:
    """The messages of a ROS 2 MCAP file up to the first that is not whole."""
    with path.open("rb") as file:
        if file.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
            raise Broken
        schemas: dict[int, str] = {}
        channels: dict[int, _Channel] = {}
        for code, record in _mcap_records(file):
            if code == 0x01 and _sized(record, "<I") != b"ros2":
                raise Broken
            if code == 0x03:
                (key,) = struct.unpack("<H", _exactly(record, 2))
                schemas[key] = _sized(record, "<I").decode()
            elif code == 0x04:
                key, schema = struct.unpack("<HH", _exactly(record, 4))
                channels[key] = _Channel(_sized(record, "<I").decode(), schema)
            elif code == 0x05:
                key, _, time_ns, _ = struct.unpack("<HIQQ", _exactly(record, 22))
                topic, schema = channels[key]
                yield Message(topic, schemas[schema], time_ns, record.read())


def _mcap_records(file: BinaryIO) -> Iterator[tuple[int, io.BytesIO]]:
    """Code and content of each record; those in a chunk instead of the chunk."""
    while True:
        code, size = _exactly(file, 1)[0], _number(file, "<Q")
        if code != 0x06:
            yield code, io.BytesIO(_exactly(file, size))
            continue
        record = io.BytesIO(file.read(size))  # all there is of it
        _exactly(record, 28)  # times, size and checksum
        unpack = UNPACK[_sized(record, "<I").decode()]
        _number(record, "<Q")
        chunk = io.BytesIO(unpack(record.read()))
        while chunk.tell() < len(chunk.getbuffer()):
            code = _exactly(chunk, 1)[0]
            yield code, io.BytesIO(_sized(chunk, "<Q"))


def scan_sqlite3(path: Path) -> Iterator[Message]:
    """The messages of a ROS 2 database up to the first that is not whole."""
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?immutable=1", uri=True)) as database:
        # With this, SQLite opens a file that is shorter than it says.
        database.execute("PRAGMA writable_schema=ON")
        rows = database.execute("SELECT id, name, type FROM topics")
        topics = {key: (name, kind) for key, name, kind in rows}
        for key, time_ns, data in database.execute(
            "SELECT topic_id, timestamp, data FROM messages"
        ):
            if not (isinstance(time_ns, int) and isinstance(data, bytes)):
                raise Broken
            yield Message(*topics[key], time_ns, data)


SCANNERS: dict[BagKind, Callable[[Path], Iterator[Message]]] = {
    "ros1": scan_ros1,
    "mcap": scan_mcap,
    "sqlite3": scan_sqlite3,
}


def _sized(file: BinaryIO, size: str) -> bytes:
    """A block with its length before it, of the type `size`."""
    return _exactly(file, _number(file, size))


def _number(file: BinaryIO, kind: str) -> int:
    (number,) = struct.unpack(kind, _exactly(file, struct.calcsize(kind)))
    return int(number)


def _exactly(file: BinaryIO, length: int) -> bytes:
    data = file.read(length)
    if len(data) != length:
        raise Broken
    return data
