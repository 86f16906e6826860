"""ROS messages, read from and written to bytes without a ROS installation."""

from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from inhand.errors import InputError
from inhand.streams.bag import BagKind, Message

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
POSE = "geometry_msgs/msg/PoseStamped"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
EARLY_TRANSFORMS = "tf/msg/tfMessage"
"""The same, in early ROS 1."""


def standard_types(kind: BagKind) -> Typestore:
    """The messages that come with ROS; those used here are the same in all releases of ROS 2."""
    types = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    if TRANSFORMS not in types.types:  # a package of its own in ROS 1
        types.register(
            get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TRANSFORMS)
        )
    return types


class Decoder:
    """Reads the standard messages of a recording.

    Args:
        kind: what the recording is.
    """

    def __init__(self, kind: BagKind) -> None:
        types = standard_types(kind)
        self._read = types.deserialize_ros1 if kind == "ros1" else types.deserialize_cdr

    def decode(self, message: Message) -> Any:
        """The message, with ROS 2's names of fields.

        Raises:
            InputError: its bytes are damaged.
        """
        kind = TRANSFORMS if message.type == EARLY_TRANSFORMS else message.type
        try:
            return self._read(message.data, kind)
        except Exception as error:  # damaged bytes make the library raise nearly anything
            raise InputError(
                f"a message of {message.topic} ({message.type}) is damaged: {error or repr(error)}"
            ) from error


def stamp_ns(header: Any) -> int:
    """Time of a std_msgs/Header [ns]."""
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)
