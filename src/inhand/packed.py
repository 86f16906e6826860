"""Hand and object models laid out for kernels on one device."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import trimesh
import warp as wp
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.hand import Hand
from inhand.kernels.bodies import body_distances
from inhand.kernels.depth import DepthRenderer, pinhole
from inhand.kernels.fields import fields_of, pack_fields
from inhand.kernels.hand_depth import trace_bodies
from inhand.kernels.hand_terms import FittedHand
from inhand.kernels.kinematics import Chain, pose_links
from inhand.kernels.launch import computed, copied, empty, filled, launch, on_device, pack
from inhand.kernels.pair_matching import PairTable
from inhand.kernels.pose_distance import Surface
from inhand.object_model import ObjectModel

COMPARED_POINTS = 24
"""Surface samples by which two poses of an object are compared."""
NEAREST = 1e-3
"""A body that comes nearer to the camera's plane than this may show anywhere [m]."""


class PackedHand:
    """A hand on a device.

    Attributes:
        hand: the model.
        device: Warp device name.
        fields: distance fields of the links, `kernels.fields.Fields`.
        points, normals: surface samples of all links, link frames, `wp.vec3`.
        link: index of the link of every sample, int.
        point_start: first sample of every link, and the end of the last, numpy (L + 1,).
        chain: the kinematics, `kernels.kinematics.Chain`.
        lower, upper: limits of the independent joints [rad, m], float64 (n).
        fitted: all this as `kernels.hand_terms.FittedHand`.
        is_palm: whether each link is rigid with the root, numpy (L,).
        apart: whether two links belong to different parts, palm or fingers, flat (L * L), int.
        whole: all links, `PackedPart`.
        fingers: the fingers, in the order of `hand.fingers`, `PackedPart`.
        finger_fields: distance fields of the links of each.
        corners: corners of the links' bounding boxes, link frames [m], numpy (L, 8, 3).
    """

    def __init__(self, hand: Hand, device: str) -> None:
        self.hand = hand
        self.device = device
        self.fields = pack_fields(
            [link.distance_field for link in hand.links], [link.mesh for link in hand.links], device
        )
        surfaces = [link.surface for link in hand.links]
        self.points, self.normals = (
            wp.array(np.concatenate(vectors), dtype=wp.vec3, device=device)
            for vectors in ([x.points for x in surfaces], [x.normals for x in surfaces])
        )
        counts = [len(surface.points) for surface in surfaces]
        self.point_start = np.cumsum([0, *counts])
        self.link = wp.array(np.repeat(np.arange(len(counts)), counts), dtype=int, device=device)
        self.chain = pack(Chain, device, **vars(hand.chain))
        self.lower, self.upper = (
            wp.array(limits, dtype=wp.float64, device=device) for limits in (hand.lower, hand.upper)
        )
        self.fitted = FittedHand()
        for name in ("fields", "points", "normals", "link", "chain", "lower", "upper"):
            setattr(self.fitted, name, getattr(self, name))
        self.is_palm = np.isin(np.arange(len(hand.links)), hand.palm_links)
        part = np.zeros(len(hand.links), dtype=int)
        for i, finger in enumerate(hand.fingers):
            part[list(finger.links)] = i + 1
        apart = (part[:, None] != part).astype(np.int32)
        self.apart = wp.array(apart.reshape(-1), dtype=int, device=device)
        self._no_image = wp.empty(0, dtype=int, device=device)
        self.corners = np.stack([trimesh.bounds.corners(link.mesh.bounds) for link in hand.links])
        self.whole = PackedPart(hand, range(len(hand.links)), device)
        self.fingers = [PackedPart(hand, finger.links, device) for finger in hand.fingers]
        self.finger_fields = [fields_of(self.fields, f.links, device) for f in hand.fingers]

    @cached_property
    def palm(self) -> "PackedPart":
        """The links that are rigid with the root; there must be some."""
        return PackedPart(self.hand, self.hand.palm_links, self.device)

    @cached_property
    def renderer(self) -> DepthRenderer:
        """Ray caster of the links' meshes: exact, and slower than `render`."""
        return DepthRenderer([link.mesh for link in self.hand.links], self.device)

    def link_poses(
        self, q: NDArray[np.float64], T_camera_hand: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """T_camera_link, shape (b, L, 4, 4), at joint vectors (b, n) and wrist poses (b, 4, 4)."""
        return np.asarray(T_camera_hand[:, None] @ self.hand.forward_kinematics(q))

    def pose(self, q: NDArray[np.float64], T_camera_hand: NDArray[np.float64]) -> Any:
        """As `link_poses`, flat (b * L), on the device; one wrist pose, (1, 4, 4), does for all."""
        return self.whole.pose(q[:, self.whole.joints], T_camera_hand)

    def distances(
        self,
        points: NDArray[np.float32],
        T_camera_link: Any,
        links: NDArray[np.bool_],
        farthest: float,
        finger: int | None = None,
    ) -> NDArray[np.float32]:
        """Signed distances [m], (c, n), of points to some of the links, cut off at `farthest`.

        Args:
            points: camera frame [m], shape (n, 3).
            T_camera_link: poses of all links, flat (c * L), on the device.
            links: whether each of them counts, shape (L,).
            farthest: [m].
            finger: if given, the links are those of this finger, and only these.
        """
        fields = self.fields if finger is None else self.finger_fields[finger]
        return _distances(points, fields, T_camera_link, links, farthest, self.device)

    def render(
        self,
        camera: Camera,
        T_camera_link: NDArray[np.floating[Any]],
        shown: NDArray[np.bool_],
        others: Any = None,
        link: Any = None,
    ) -> Any:
        """Depth image [m] of the links that are `shown` (L,), flat, on the device.

        Args:
            camera: the camera.
            T_camera_link: poses of the links, shape (L, 4, 4).
            shown: whether to draw each of them, shape (L,).
            others: an image of what else is there.
            link: in and out, if given: the link that every pixel shows, int.
        """
        if others is None:
            depth = filled((camera.width * camera.height,), 0.0, float, self.device)
        else:
            depth = copied(others)
        windows = _windows(camera, T_camera_link, self.corners)
        windows[~shown] = 0
        if not shown.any():
            return depth
        around = [*windows[shown, :2].min(axis=0), *windows[shown, 2:].max(axis=0)]
        pixels = (around[2] - around[0]) * (around[3] - around[1])
        inputs = [pinhole(camera), self.fields, device_poses(T_camera_link, self.device)]
        inputs += [on_device(windows, wp.vec4i, self.device), wp.vec4i(*around), depth]
        inputs += [self._no_image if link is None else link]
        launch(trace_bodies, pixels, inputs, self.device, work_per_item=50)
        return depth


class PackedPart:
    """Some links of a hand with the joints that move them, on a device.

    Attributes:
        links: their indices, numpy (l,).
        joints: indices of the k independent joints that move them, numpy (k,).
        chain: the kinematics of these alone, `kernels.kinematics.Chain`.
        points, normals: surface samples, `wp.vec3`, the first of every link first.
        link: which of the links each sample is on, int.
        counts: number of samples of every link, numpy (l,).
    """

    def __init__(self, hand: Hand, links: Sequence[int], device: str) -> None:
        self.device, self.links = device, np.array(links)
        chain, self.joints = hand.chain.part(links)
        self.chain, self._joint_count = pack(Chain, device, **vars(chain)), len(chain.parent)
        surfaces = [hand.links[i].surface for i in links]
        self.counts = np.array([len(surface.points) for surface in surfaces])
        order = np.argsort(np.concatenate([np.arange(n) for n in self.counts]), kind="stable")
        self.points, self.normals = (
            wp.array(np.concatenate(vectors)[order], dtype=wp.vec3, device=device)
            for vectors in ([x.points for x in surfaces], [x.normals for x in surfaces])
        )
        link = np.repeat(np.arange(len(links)), self.counts)[order]
        self.link = wp.array(link, dtype=int, device=device)

    def pose(self, q: NDArray[np.float64], T_camera_hand: NDArray[np.float64]) -> Any:
        """Link poses, flat (c * l), on the device.

        Args:
            q: positions of the joints [rad, m], shape (c, k).
            T_camera_hand: wrist poses, shape (c, 4, 4), or (1, 4, 4) for all.
        """
        joints = empty((len(q), self._joint_count), wp.mat44d, self.device)
        links = empty((len(q) * len(self.links),), wp.mat44, self.device)
        wrists = on_device(T_camera_hand, wp.mat44d, self.device)
        positions = on_device(q, wp.float64, self.device)
        inputs = [self.chain, positions, wrists, joints, links]
        launch(pose_links, len(q), inputs, self.device, work_per_item=20 * self._joint_count)
        return links


class PackedObject:
    """An object on a device.

    Attributes:
        model: the object model.
        device: Warp device name.
        fields: its distance field, `kernels.fields.Fields` with one body.
        points, normals: surface samples in progressive order, object frame, `wp.vec3`.
        surface: what poses are compared by, `kernels.pose_distance.Surface`.
        pairs: the pair table, `kernels.pair_matching.PairTable`.
        renderer: ray caster of the object.
    """

    def __init__(self, model: ObjectModel, device: str) -> None:
        self.model = model
        self.device = device
        self.fields = pack_fields([model.distance_field], [model.mesh], device)
        self.points = wp.array(model.surface.points, dtype=wp.vec3, device=device)
        self.normals = wp.array(model.surface.normals, dtype=wp.vec3, device=device)
        few, centre = model.surface.points[:COMPARED_POINTS], wp.vec3(*model.centre.tolist())
        self.surface = pack(Surface, device, points=few, fields=self.fields, centre=centre)
        self.pairs = pack(PairTable, device, **vars(model.pairs), **vars(model.surface))
        self.renderer = DepthRenderer([model.mesh], device)

    def distances(
        self, points: NDArray[np.float32], T_camera_object: NDArray[Any], farthest: float
    ) -> NDArray[np.float32]:
        """Signed distances [m], (n,), of points to the posed object, cut off at `farthest`.

        Args:
            points: camera frame [m], shape (n, 3).
            T_camera_object: pose, shape (4, 4).
            farthest: [m].
        """
        pose, whole = device_poses(T_camera_object, self.device), np.ones(1, dtype=bool)
        return _distances(points, self.fields, pose, whole, farthest, self.device)[0]


def _distances(
    points: NDArray[np.float32],
    fields: Any,
    T_camera_body: Any,
    used: NDArray[np.bool_],
    farthest: float,
    device: str,
) -> NDArray[np.float32]:
    """Signed distances [m], (c, n), of points (n, 3) to the nearest body that is `used` (b,), cut
    off at `farthest`; poses flat, (c * b), on the device."""
    shape = len(T_camera_body) // len(used), len(points)
    inputs = [on_device(points, wp.vec3, device), fields, T_camera_body]
    inputs += [on_device(used, int, device), farthest]
    return computed(body_distances, shape, float, inputs, device, work_per_item=20)


def _windows(
    camera: Camera, T_camera_body: NDArray[np.floating[Any]], corners: NDArray[np.float64]
) -> NDArray[np.int32]:
    """Windows (u0, v0, u1, v1), shape (b, 4), of an image that show boxes by their corners.

    Args:
        camera: the camera.
        T_camera_body: poses, shape (b, 4, 4).
        corners: corners of the boxes [m], shape (b, 8, 3).
    """
    size = [camera.width, camera.height]
    p = corners @ T_camera_body[:, :3, :3].swapaxes(1, 2) + T_camera_body[:, None, :3, 3]
    z = np.maximum(p[..., 2:], NEAREST)
    pixels = p[..., :2] / z * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    low = np.minimum(np.maximum(pixels.min(axis=1), 0), size)
    high = np.minimum(np.maximum(pixels.max(axis=1) + 1, low), size)
    windows = np.concatenate([low, high], axis=1).astype(np.int32)
    windows[p[..., 2].min(axis=1) < NEAREST] = [0, 0, *size]
    return windows


def device_poses(T: NDArray[Any], device: str) -> Any:
    """Transforms of shape (..., 4, 4) as a flat Warp array of `wp.mat44` for kernels to read."""
    flat = np.ascontiguousarray(T, dtype=np.float32).reshape(-1, 4, 4)
    return on_device(flat, wp.mat44, device)
