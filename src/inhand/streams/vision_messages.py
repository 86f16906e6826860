"""vision_msgs/Detection3DArray, which does not come with ROS: its definition for either release."""

from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore

from inhand.streams.bag import BagKind

DETECTIONS = "vision_msgs/msg/Detection3DArray"

_BOTH = {
    "BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
}
_ROS1 = {
    "ObjectHypothesisWithPose": "int64 id\nfloat64 score\ngeometry_msgs/PoseWithCovariance pose",
    "Detection3D": "std_msgs/Header header\n"
    "vision_msgs/ObjectHypothesisWithPose[] results\n"
    "vision_msgs/BoundingBox3D bbox\n"
    "sensor_msgs/PointCloud2 source_cloud",
}
_ROS2 = {
    "ObjectHypothesis": "string class_id\nfloat64 score",
    "ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis\n"
    "geometry_msgs/PoseWithCovariance pose",
    "Detection3D": "std_msgs/Header header\n"
    "vision_msgs/ObjectHypothesisWithPose[] results\n"
    "vision_msgs/BoundingBox3D bbox\n"
    "string id",
}


def add_vision_messages(types: Typestore, kind: BagKind) -> None:
    """Teach `types` the messages of vision_msgs 0.0 (ROS 1) or 4 (ROS 2)."""
    for name, text in {**_BOTH, **(_ROS1 if kind == "ros1" else _ROS2)}.items():
        types.register(get_types_from_msg(text, f"vision_msgs/msg/{name}"))
