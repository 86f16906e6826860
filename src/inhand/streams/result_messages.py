"""An estimate as ROS messages."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys.store import Typestore
from scipy.spatial.transform import Rotation

from inhand.estimate import PoseEstimate
from inhand.object_model import ObjectModel
from inhand.streams.bag import BagKind
from inhand.streams.ros_types import POSE
from inhand.streams.runner import Result
from inhand.streams.vision_messages import DETECTIONS

OBJECT_POSE = "/inhand/object_pose"
HAND_POSE = "/inhand/hand_pose"
JOINTS = "/inhand/joint_states"
FOUND = "/inhand/detections"
TYPE_OF_TOPIC = {
    OBJECT_POSE: POSE,
    HAND_POSE: POSE,
    JOINTS: "sensor_msgs/msg/JointState",
    FOUND: DETECTIONS,
}

Array = NDArray[np.float64]


class ResultMessages:
    """Makes messages; they carry the image's time and the camera's frame.

    Args:
        types: the messages' definitions, vision_msgs included.
        kind: the release of ROS.
        obj: the object, for its name and its box.
    """

    def __init__(self, types: Typestore, kind: BagKind, obj: ObjectModel) -> None:
        self._types = types.types
        self._ros1 = kind == "ros1"
        self._name = obj.name
        low, high = obj.mesh.vertices.min(axis=0), obj.mesh.vertices.max(axis=0)
        self._box_size = (high - low).tolist()
        self._T_object_box = np.eye(4)
        self._T_object_box[:3, 3] = (low + high) / 2

    def of(self, result: Result) -> dict[str, Any]:
        """Messages by topic; what is unknown has none, but detections there always are."""
        header, estimate = self._header(result), result.estimate
        found = self._types[DETECTIONS]
        messages = {FOUND: found(header=header, detections=self._detections(header, result))}
        for topic, T in (
            (OBJECT_POSE, estimate.T_camera_object),
            (HAND_POSE, estimate.T_camera_hand),
        ):
            if T is not None:
                messages[topic] = self._types[POSE](header=header, pose=self._pose(T))
        if joints := estimate.joint_positions:
            none = np.zeros(0)
            messages[JOINTS] = self._types[TYPE_OF_TOPIC[JOINTS]](
                header=header,
                name=list(joints),
                position=np.array(list(joints.values()), dtype=np.float64),
                velocity=none,
                effort=none,
            )
        return messages

    def _header(self, result: Result) -> Any:
        seconds, nanoseconds = divmod(result.frame.time_ns, 10**9)
        time = self._types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
        number = {"seq": 0} if self._ros1 else {}
        return self._types["std_msgs/msg/Header"](
            stamp=time, frame_id=result.frame.frame_id, **number
        )

    def _detections(self, header: Any, result: Result) -> list[Any]:
        T = result.estimate.T_camera_object
        if T is None:
            return []
        box = self._types["vision_msgs/msg/BoundingBox3D"](
            center=self._pose(T @ self._T_object_box),
            size=self._types["geometry_msgs/msg/Vector3"](*self._box_size),
        )
        # In ROS 1 the object has a number instead of a name, and there is one object only.
        named = {"source_cloud": self._no_cloud(header)} if self._ros1 else {"id": self._name}
        hypothesis = self._hypothesis(T, result.estimate)
        detection = self._types["vision_msgs/msg/Detection3D"]
        return [detection(header=header, results=[hypothesis], bbox=box, **named)]

    def _hypothesis(self, T: Array, estimate: PoseEstimate) -> Any:
        # ROS has the translation before the rotation, and zeros for unknown.
        known, confidence = estimate.covariance, estimate.confidence
        covariance = np.zeros((6, 6)) if known is None else np.roll(known, 3, axis=(0, 1))
        pose = self._types["geometry_msgs/msg/PoseWithCovariance"](
            pose=self._pose(T), covariance=covariance.reshape(36)
        )
        hypothesis = self._types["vision_msgs/msg/ObjectHypothesisWithPose"]
        if self._ros1:
            return hypothesis(id=0, score=confidence, pose=pose)
        name_and_score = self._types["vision_msgs/msg/ObjectHypothesis"]
        return hypothesis(
            hypothesis=name_and_score(class_id=self._name, score=confidence), pose=pose
        )

    def _pose(self, T: Array) -> Any:
        return self._types["geometry_msgs/msg/Pose"](
            position=self._types["geometry_msgs/msg/Point"](*T[:3, 3].tolist()),
            orientation=self._types["geometry_msgs/msg/Quaternion"](
                *Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
            ),
        )

    def _no_cloud(self, header: Any) -> Any:
        return self._types["sensor_msgs/msg/PointCloud2"](
            header=header,
            height=0,
            width=0,
            fields=[],
            is_bigendian=False,
            point_step=0,
            row_step=0,
            data=np.zeros(0, dtype=np.uint8),
            is_dense=True,
        )
