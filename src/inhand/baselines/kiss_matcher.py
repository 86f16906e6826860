"""KISS-Matcher (Lim et al., "KISS-Matcher: Fast and Robust Point Cloud Registration Revisited",
2025): Faster-PFH, matches pruned by their consistency, and a robust solver.

Two things make it work on objects. Its parameters are made for scenes of metres, so everything is
enlarged. And it turns normals towards the origin, where a lidar would be: on a whole model those
would look inward, on the cloud of a camera they look outward. So the model is matched as it looks
from all around, one view after the other.
"""

import numpy as np
from numpy.typing import NDArray

from inhand.baselines.method import View
from inhand.baselines.registration import Registration
from inhand.baselines.views import spread_directions
from inhand.camera import Camera
from inhand.errors import NoAnswer
from inhand.geometry import se3
from inhand.packed import PackedObject
from inhand.stages.observation import Cloud

SCALE = 100.0
"""Factor on all lengths; the library refuses voxels of millimetres."""
VOXELS = 30
"""Voxels along the object's diameter."""
VIEWS = 24
"""Views of the model."""
CAMERA = Camera(fx=400, fy=400, cx=47.5, cy=47.5, width=96, height=96)
"""Renders the views, from such a distance that the object fills them."""


class KissMatcher(Registration):
    """The views of one object; all that match the cloud go on to ICP."""

    def __init__(self, obj: PackedObject, seed: int) -> None:
        from kiss_matcher import KISSMatcher, KISSMatcherConfig

        voxel = SCALE * obj.model.diameter / VOXELS
        self._matcher = KISSMatcher(KISSMatcherConfig(voxel_size=voxel))
        self._views = [_view(obj, direction) for direction in spread_directions(VIEWS)]

    def align(self, cloud: Cloud, view: View) -> NDArray[np.float64]:
        """The pose by every view that matches, shape (m, 4, 4)."""
        scene = _enlarged(cloud.points)
        found = []
        for T_view_object, points in self._views:
            solution = self._matcher.estimate(points, scene)
            if solution.valid:
                T_scene_view = np.eye(4)
                T_scene_view[:3, :3] = solution.rotation
                T_scene_view[:3, 3] = np.ravel(solution.translation) / SCALE
                found.append(T_scene_view @ T_view_object)
        if not found:
            raise NoAnswer("no view of the object looks like a part of the cloud")
        return np.stack(found)


def _view(
    obj: PackedObject, direction: NDArray[np.float64]
) -> tuple[NDArray[np.float64], list[NDArray[np.float32]]]:
    """Pose in its camera, and enlarged points, of the object seen from a direction (3,)."""
    distance = obj.model.diameter * CAMERA.fx / CAMERA.width * 1.2
    T = np.eye(4)
    T[:3, :3] = se3.rotation_between(direction, np.array([0.0, 0.0, -1.0]))
    T[:3, 3] = [0, 0, distance] - T[:3, :3] @ obj.model.centre
    depth, _ = obj.renderer.render(CAMERA, T[None])
    v, u = np.nonzero(depth)
    z = depth[v, u]
    return T, _enlarged(
        np.stack([(u - CAMERA.cx) / CAMERA.fx * z, (v - CAMERA.cy) / CAMERA.fy * z, z], axis=1)
    )


def _enlarged(points: NDArray[np.floating]) -> list[NDArray[np.float32]]:
    return list((SCALE * points).astype(np.float32))
