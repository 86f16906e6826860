"""The paper's score of object poses: the largest common pointset (LCP) of segment and model."""

import numpy as np
from numpy.typing import NDArray

from inhand.config import HypothesesConfig, RefinementConfig, SelectionConfig
from inhand.kernels.lcp import pose_lcp
from inhand.packed import PackedObject
from inhand.stages.results import Segment


def segment_lcp(
    T_camera_object: NDArray[np.float32],
    segment: Segment,
    obj: PackedObject,
    config: HypothesesConfig | RefinementConfig | SelectionConfig,
    stride: int = 1,
) -> NDArray[np.float32]:
    """Share of every `stride`-th segment point that lies on the model at poses (m, 4, 4), (m,)."""
    points, normals = segment.points[::stride], segment.normals[::stride]
    rule = config.lcp_distance, config.lcp_normal_angle
    return pose_lcp(T_camera_object, points, normals, obj.fields, *rule, obj.device)
