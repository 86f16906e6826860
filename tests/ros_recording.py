"""Writes ROS recordings for tests, with the messages that a depth camera on a robot gives."""

import io
import struct
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from inhand.camera import Camera
from inhand.streams.bag import BagKind

KINDS: tuple[BagKind, ...] = ("ros1", "sqlite3", "mcap")
PLUGIN = {"sqlite3": rosbag2.StoragePlugin.SQLITE3, "mcap": rosbag2.StoragePlugin.MCAP}
OPTICAL = "camera_depth_optical_frame"
MS = 1_000_000


class Sent(NamedTuple):
    """A message on its way into a recording."""

    topic: str
    time_ns: int
    message: Any


class Messages:
    """Makes messages of one release of ROS."""

    def __init__(self, kind: BagKind) -> None:
        self.kind = kind
        store = Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE
        self.types = get_typestore(store)
        if kind == "ros1":
            text = "geometry_msgs/TransformStamped[] transforms"
            self.types.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))

    def make(self, name: str, **fields: Any) -> Any:
        return self.types.types[name](**fields)

    def header(self, time_ns: int, frame_id: str) -> Any:
        sec, nanosec = divmod(time_ns, 10**9)
        stamp = self.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        seq = {"seq": 0} if self.kind == "ros1" else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id, **seq)

    def image(
        self, pixels: NDArray[Any], time_ns: int, encoding: str = "16UC1", frame_id: str = OPTICAL
    ) -> Any:
        height, width = pixels.shape[:2]
        return self.make(
            "sensor_msgs/msg/Image",
            header=self.header(time_ns, frame_id),
            height=height,
            width=width,
            encoding=encoding,
            is_bigendian=0,
            step=pixels.nbytes // height,
            data=np.frombuffer(pixels.tobytes(), dtype=np.uint8),
        )

    def compressed(self, data: bytes, time_ns: int, encoding: str, frame_id: str = OPTICAL) -> Any:
        return self.make(
            "sensor_msgs/msg/CompressedImage",
            header=self.header(time_ns, frame_id),
            format=encoding,
            data=np.frombuffer(data, dtype=np.uint8),
        )

    def camera_info(self, camera: Camera, distortion: Sequence[float] = (0,) * 5) -> Any:
        K, P = camera.matrix.ravel(), np.hstack([camera.matrix, np.zeros((3, 1))]).ravel()
        matrices = {"d": np.array(distortion, dtype=float), "k": K, "r": np.eye(3).ravel(), "p": P}
        if self.kind == "ros1":
            matrices = {name.upper(): matrix for name, matrix in matrices.items()}
        region = self.make(
            "sensor_msgs/msg/RegionOfInterest",
            x_offset=0,
            y_offset=0,
            height=0,
            width=0,
            do_rectify=False,
        )
        return self.make(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(0, OPTICAL),
            height=camera.height,
            width=camera.width,
            distortion_model="plumb_bob",
            binning_x=0,
            binning_y=0,
            roi=region,
            **matrices,
        )

    def pose(self, T: NDArray[np.float64], time_ns: int, frame_id: str) -> Any:
        position, orientation = self._position(T), self._orientation(T)
        return self.make(
            "geometry_msgs/msg/PoseStamped",
            header=self.header(time_ns, frame_id),
            pose=self.make("geometry_msgs/msg/Pose", position=position, orientation=orientation),
        )

    def transforms(self, *edges: tuple[str, str, NDArray[np.float64], int]) -> Any:
        """Parent, child, T_parent_child and time [ns] of each."""
        return self.make(
            "tf2_msgs/msg/TFMessage",
            transforms=[
                self.make(
                    "geometry_msgs/msg/TransformStamped",
                    header=self.header(time_ns, parent),
                    child_frame_id=child,
                    transform=self.make(
                        "geometry_msgs/msg/Transform",
                        translation=self.make(
                            "geometry_msgs/msg/Vector3", **dict(zip("xyz", T[:3, 3], strict=True))
                        ),
                        rotation=self._orientation(T),
                    ),
                )
                for parent, child, T, time_ns in edges
            ],
        )

    def text(self, data: str) -> Any:
        return self.make("std_msgs/msg/String", data=data)

    def _position(self, T: NDArray[np.float64]) -> Any:
        return self.make("geometry_msgs/msg/Point", **dict(zip("xyz", T[:3, 3], strict=True)))

    def _orientation(self, T: NDArray[np.float64]) -> Any:
        q = Rotation.from_matrix(T[:3, :3]).as_quat()
        return self.make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", q, strict=True)))


def recording_path(folder: Path, kind: BagKind, name: str = "recording") -> Path:
    return folder / f"{name}.bag" if kind == "ros1" else folder / name


def write_recording(
    folder: Path,
    kind: BagKind,
    make: Callable[[Messages], list[Sent]],
    name: str = "recording",
    *,
    packed: bool = False,
    mode: rosbag2.CompressionMode | None = None,
    cut: Mapping[int, int] = MappingProxyType({}),
) -> Path:
    """Write what `make` makes, in order of time; returns the recording's path.

    Packed: in compressed chunks, which SQLite does not have. Mode: compressed as ROS 2 does it.
    Cut: bytes left of messages, by time.
    """
    messages = Messages(kind)
    path = recording_path(folder, kind, name)
    writer = (
        rosbag1.Writer(path)
        if kind == "ros1"
        else rosbag2.Writer(path, version=9, storage_plugin=PLUGIN[kind])
    )
    if packed and isinstance(writer, rosbag1.Writer):
        writer.set_compression(rosbag1.Writer.CompressionFormat.LZ4)
    if packed and kind == "mcap":
        mode = rosbag2.CompressionMode.STORAGE
    if mode and isinstance(writer, rosbag2.Writer):
        writer.set_compression(mode, rosbag2.CompressionFormat.ZSTD)
    connections: dict[str, Any] = {}
    types = messages.types
    serialise = types.serialize_ros1 if kind == "ros1" else types.serialize_cdr
    with writer:
        for topic, time_ns, message in sorted(make(messages), key=lambda sent: sent.time_ns):
            kind_of_message = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind_of_message, typestore=types)
            data = bytes(serialise(message, kind_of_message))
            writer.write(connections[topic], time_ns, data[: cut.get(time_ns)])
    return path


def storage_file(path: Path) -> Path:
    """The file that holds a recording's messages."""
    return path if path.is_file() else next(f for f in path.iterdir() if f.suffix != ".yaml")


def png(pixels: NDArray[np.uint16]) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    return buffer.getvalue()


def compressed_depth(packed: bytes, scale: float = 0.0, offset: float = 0.0) -> bytes:
    """A compressedDepth payload: header and packed pixels."""
    return struct.pack("<iff", 0, scale, offset) + packed
