"""The camera of depth images, from sensor_msgs/CameraInfo."""

from typing import Any

import numpy as np

from inhand.camera import Camera
from inhand.errors import InputError


def read_camera_info(info: Any, topic: str, *, rectified: bool) -> Camera:
    """The pinhole camera that a message describes; depth images of ROS count millimetres.

    Args:
        info: the message.
        topic: where it came from, for messages.
        rectified: whether the images are free of distortion whatever the message says.

    Raises:
        InputError: the intrinsics are missing, or the images are distorted.
    """
    ros1 = hasattr(info, "K")
    K = np.reshape(info.K if ros1 else info.k, (3, 3))
    P = np.reshape(info.P if ros1 else info.p, (3, 4))
    distortion = np.asarray(info.D if ros1 else info.d)
    if not K[0, 0]:
        raise InputError(f"{topic} says nothing of the camera's intrinsics; give --camera FILE")
    if distortion.any():
        if not rectified or not P[0, 0]:
            raise InputError(
                f"the images are distorted, says {topic} (D = {distortion.round(4).tolist()}): "
                "record the rectified ones (image_rect), or give --camera FILE if they are"
            )
        K = P[:, :3]
    try:
        return Camera.from_matrix(K, width=int(info.width), height=int(info.height))
    except InputError as error:
        raise InputError(f"{topic}: {error}") from error
