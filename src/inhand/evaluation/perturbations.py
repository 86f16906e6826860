"""Frames made harder: pure functions from a frame to a perturbed frame.

What an estimator is told (wrist, intrinsics) or what the camera sees is changed by a known amount;
the ground truth stays the truth. Whatever is random comes from a generator, and only its scale
depends on the amount: the same generator state gives the same errors, larger or smaller.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from inhand.camera import Camera
from inhand.datasets.frames import (
    LABEL_BACKGROUND,
    LABEL_HAND,
    LABEL_NOTHING,
    LABEL_OBJECT,
    Frame,
)
from inhand.geometry import se3
from inhand.geometry.mesh import TriangleMesh
from inhand.hand import Hand
from inhand.kernels.depth import DepthRenderer
from inhand.object_model import ObjectModel
from inhand.synth.sensor import STRUCTURED_LIGHT, smooth_noise

TABLE_SLOPE = np.radians(45)
"""Angle between the camera's axis and the table that it looks down at [rad]."""
FARTHEST_TABLE = 3.0
"""Where the table ends, seen from the camera [m]."""
BLOB_SIZE = 3.0
"""Sd of the Gaussian that shapes lost areas [pixel]."""

Image = NDArray[np.float32]
"""Depth z [m], shape (H, W), 0 where there is nothing."""


@dataclass(frozen=True, eq=False)
class Bodies:
    """The hand and the object of a frame, which may be rendered where they truly are."""

    hand: Hand
    """The hand."""
    object_mesh: TriangleMesh
    """The object's surface."""
    device: str = "cpu"
    """Warp device of the rendering."""

    @cached_property
    def _links(self) -> list[TriangleMesh]:
        return [link.mesh for link in self.hand.links]

    @cached_property
    def _renderer(self) -> DepthRenderer:
        return DepthRenderer([*self._links, self.object_mesh], self.device)

    @cached_property
    def _hand_renderer(self) -> DepthRenderer:
        return DepthRenderer(self._links, self.device)

    def points(self, frame: Frame) -> NDArray[np.float64]:
        """Corners of all surfaces where they truly are [m], camera frame, shape (n, 3)."""
        meshes = [*self._links, self.object_mesh]
        poses = self._poses(frame)
        return np.concatenate(
            [se3.transform(T, m.hull_vertices) for T, m in zip(poses, meshes, strict=True)]
        )

    def render(self, frame: Frame, camera: Camera) -> tuple[Image, NDArray[np.int32]]:
        """True depth [m] and index of the body in every pixel, -1 for none, each (H, W)."""
        return self._renderer.render(camera, self._poses(frame))

    def render_hand(self, frame: Frame, shift: NDArray[np.float64]) -> Image:
        """Depth of the hand alone, moved from where it is by `shift` [m], camera frame, (3,)."""
        poses = self._poses(frame)[:-1]
        poses[:, :3, 3] += shift
        return self._hand_renderer.render(frame.camera, poses)[0]

    def _poses(self, frame: Frame) -> NDArray[np.float64]:
        """T_camera_link of all links, then T_camera_object, shape (L + 1, 4, 4)."""
        q = self.hand.joint_vector(frame.truth.joint_positions)
        links = frame.truth.T_camera_hand @ self.hand.forward_kinematics(q)
        return np.concatenate([links, frame.truth.T_camera_object[None]])


def with_wrist_error(
    frame: Frame, translation: float, rotation: float, rng: np.random.Generator
) -> Frame:
    """The wrist is given off by exactly this much [m, rad], in random directions.

    The error that the frame came with is gone. The rotation is about the wrist's own origin.
    """
    along, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    wrist = frame.truth.T_camera_hand.copy()
    wrist[:3, :3] = se3.exp_so3(rotation * axis) @ wrist[:3, :3]
    wrist[:3, 3] += translation * along
    return replace(frame, wrist=wrist)


def with_focal_length(frame: Frame, factor: float) -> Frame:
    """The camera's focal lengths are given wrong by this factor."""
    camera = replace(frame.camera, fx=factor * frame.camera.fx, fy=factor * frame.camera.fy)
    return replace(frame, camera=camera)


def with_depth_noise(frame: Frame, factor: float, rng: np.random.Generator) -> Frame:
    """Every reading has this many times a structured-light camera's axial noise on top.

    That is the head-on noise of `synth.sensor.STRUCTURED_LIGHT`, which grows with distance and
    over which neighbouring pixels agree.
    """
    model, depth = STRUCTURED_LIGHT, frame.depth
    sd = factor * (model.axial + model.axial_growth * (depth - 0.4) ** 2)
    noisy = depth + sd * smooth_noise(depth.shape, model.correlation, rng)
    return _with_depth(frame, np.where(depth > 0, np.maximum(noisy, 0), 0))


def with_missing_depth(frame: Frame, share: float, rng: np.random.Generator) -> Frame:
    """This share of the image has no reading: areas and single pixels, as many of either."""
    single = 1 - np.sqrt(1 - share)  # two independent losses of this share make the whole
    lost = rng.random(frame.depth.shape) < single
    lost |= smooth_noise(frame.depth.shape, BLOB_SIZE, rng) > -ndtri(single)
    return _with_depth(frame, np.where(lost, 0, frame.depth))


def with_wall(frame: Frame, gap: float, bodies: Bodies) -> Frame:
    """A wall across the camera's axis, this far behind the last of hand and object [m]."""
    z = bodies.points(frame)[:, 2].max() + gap
    return _with_surface(frame, np.full(frame.depth.shape, z))


def with_table(frame: Frame, gap: float, bodies: Bodies) -> Frame:
    """A table that the camera looks down at, this far below the lowest of hand and object [m]."""
    up = np.array([0, -np.cos(TABLE_SLOPE), -np.sin(TABLE_SLOPE)])
    height = (bodies.points(frame) @ up).min() - gap
    with np.errstate(divide="ignore"):
        z = height / (_rays(frame.camera) @ up)
    return _with_surface(frame, np.where((z > 0) & (z < FARTHEST_TABLE), z, 0))


def with_second_hand(frame: Frame, gap: float, bodies: Bodies) -> Frame:
    """The same hand once more, beside hand and object with this gap between them [m].

    It is moved along the camera's x axis, to where the image has more room.
    """
    x, z = bodies.points(frame)[:, [0, 2]].T
    middle = frame.camera.fx * (x / z).mean() + frame.camera.cx
    side = 1.0 if middle < frame.camera.width / 2 else -1.0
    shift = np.array([side * (np.ptp(x) + gap), 0, 0])
    return _with_surface(frame, bodies.render_hand(frame, shift))


def cropped(frame: Frame, share: float) -> Frame:
    """The image ends in the hand: this share of its pixels, or a little more, lies outside.

    Of the four sides, the one is cut off that loses the fewest pixels of the object.
    """
    hand, is_object = (frame.truth.label == label for label in (LABEL_HAND, LABEL_OBJECT))
    height, width = hand.shape
    windows = []
    for turns in range(4):  # the side to be cut off is on top
        rows = np.rot90(hand, turns).sum(axis=1).cumsum()
        cut = min(int(np.searchsorted(rows, share * rows[-1])) + 1, len(rows) - 1)
        top, right, bottom, left = np.roll([cut, 0, 0, 0], turns)
        windows.append((top, height - bottom, left, width - right))
    objects = [int(is_object[v0:v1, u0:u1].sum()) for v0, v1, u0, u1 in windows]
    v0, v1, u0, u1 = windows[int(np.argmax(objects))]
    left_share = max(objects) / max(int(is_object.sum()), 1)
    truth = replace(frame.truth, visible_share=left_share * frame.truth.visible_share)
    camera = frame.camera.crop(u0, v0, u1 - u0, v1 - v0)
    return _with_pixels(replace(frame, truth=truth), lambda image: image[v0:v1, u0:u1], camera)


def resized(frame: Frame, width: int, height: int, bodies: Bodies) -> Frame:
    """The image at another size, as high as `height`; what it gains or lacks in width is empty.

    Pixels are taken from the nearest ones. Where both show the same body, the true difference in
    depth between the two is added, so that surfaces stay smooth and keep the errors that their
    readings had.
    """
    scale = height / frame.camera.height
    camera = Camera(
        scale * frame.camera.fx,
        scale * frame.camera.fy,
        scale * (frame.camera.cx + 0.5) - 0.5 + (width - scale * frame.camera.width) / 2,
        scale * (frame.camera.cy + 0.5) - 0.5,
        width,
        height,
        frame.camera.depth_unit,
    )
    x, y, _ = np.moveaxis(_rays(camera), -1, 0)
    u = np.rint(frame.camera.fx * x + frame.camera.cx).astype(int)
    v = np.rint(frame.camera.fy * y + frame.camera.cy).astype(int)
    inside = (u >= 0) & (u < frame.camera.width) & (v >= 0) & (v < frame.camera.height)
    u, v = u.clip(0, frame.camera.width - 1), v.clip(0, frame.camera.height - 1)

    def nearest(image: NDArray) -> NDArray:
        pixels = image[v, u]
        pixels[~inside] = 0
        return pixels

    taken = _with_pixels(frame, nearest, camera)
    before, body_before = (image[v, u] for image in bodies.render(frame, frame.camera))
    after, body = bodies.render(frame, camera)
    same = (body >= 0) & (body == body_before) & (taken.depth > 0)
    return _with_depth(taken, np.where(same, taken.depth + after - before, taken.depth))


def scaled(model: ObjectModel, factor: float) -> ObjectModel:
    """The object larger by a factor, about its centre: a wrong model for methods to work with."""
    vertices = model.centre + factor * (model.mesh.vertices - model.centre)
    return ObjectModel.from_mesh(TriangleMesh(vertices, model.mesh.faces))


def _with_depth(frame: Frame, depth: NDArray) -> Frame:
    return replace(frame, depth=depth.astype(np.float32))


def _with_surface(frame: Frame, surface: NDArray) -> Frame:
    """The frame with a surface [m], (H, W), put into it; background, as far as it is seen.

    It is seen where there was nothing, and in front of readings that lie behind it. Where a body
    has no reading, it gets none.
    """
    depth, label = frame.depth, frame.truth.label
    empty = (label == LABEL_NOTHING) & (depth == 0)
    seen = (surface > 0) & (empty | (surface < depth))
    truth = replace(frame.truth, label=np.where(seen, LABEL_BACKGROUND, label).astype(np.uint8))
    return _with_depth(replace(frame, truth=truth), np.where(seen, surface, depth))


def _with_pixels(frame: Frame, pick: Callable[[NDArray], NDArray], camera: Camera) -> Frame:
    """The frame with other pixels of its images, which `camera` sees."""
    label = pick(frame.truth.label)
    return replace(
        frame,
        depth=pick(frame.depth),
        camera=camera,
        truth=replace(frame.truth, label=label),
        rgb=None if frame.rgb is None else pick(frame.rgb),
    )


def _rays(camera: Camera) -> NDArray[np.float64]:
    """Directions of all pixels with z = 1, shape (H, W, 3)."""
    v, u = np.mgrid[: camera.height, : camera.width]
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    return np.stack([x, y, np.ones_like(x)], axis=-1)
