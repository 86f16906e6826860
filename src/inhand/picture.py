"""A picture of an estimate: outlines over the image, and what depth says against it beside it."""

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import wrap
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from inhand.camera import Camera
from inhand.estimate import PoseEstimate
from inhand.geometry.mesh import TriangleMesh
from inhand.geometry.se3 import transform
from inhand.hand import Hand
from inhand.kernels.depth import DepthRenderer
from inhand.object_model import ObjectModel

PANEL = 540
"""Edge of each of the two panels [pixel]."""
RESIDUAL_LIMIT = 0.01
"""Residual [m] at which the colours of the residual map end."""

HAND_COLOUR = (80, 170, 255)
OBJECT_COLOUR = (255, 150, 40)
HIDDEN_COLOUR = (150, 95, 40)
NO_READING = (24, 24, 48)
_AXES = (("x", (255, 70, 70)), ("y", (80, 220, 80)), ("z", (90, 120, 255)))
_PAPER, _INK, _FAINT = (18, 18, 22), (240, 240, 240), (150, 150, 155)
_TINT = 0.25
_WINDOW_MARGIN = 0.12
_SMALLEST_WINDOW = 24
_GAP = 14
_LINE = 20

Pixels = NDArray[np.uint8]
Colour = tuple[int, int, int]


@dataclass(frozen=True)
class Window:
    """A square part of an image that is shown enlarged; it may reach over the image's edge."""

    u0: float
    """Left edge [pixel]; pixel u covers u - 0.5 to u + 0.5."""
    v0: float
    """Upper edge [pixel]."""
    side: float
    """Edge length [pixel]."""

    @classmethod
    def around(cls, shown: NDArray[np.bool_]) -> "Window":
        """The window around the marked pixels of an image, shape (H, W); around all if none is."""
        v, u = np.nonzero(shown if shown.any() else np.ones_like(shown))
        side = float(max(int(np.ptp(u)) + 1, int(np.ptp(v)) + 1, _SMALLEST_WINDOW))
        if shown.any():
            side *= 1 + 2 * _WINDOW_MARGIN
        return cls((u.min() + u.max() - side) / 2, (v.min() + v.max() - side) / 2, side)

    def camera(self, camera: Camera, size: int = PANEL) -> Camera:
        """The camera of the window, enlarged to `size` x `size` pixels."""
        scale = size / self.side
        return Camera(
            fx=camera.fx * scale,
            fy=camera.fy * scale,
            cx=(camera.cx - self.u0) * scale - 0.5,
            cy=(camera.cy - self.v0) * scale - 0.5,
            width=size,
            height=size,
        )

    def cut(self, image: NDArray[Any], fill: Any, size: int = PANEL) -> NDArray[Any]:
        """The window of an image, shape (H, W, ...), enlarged without smoothing."""
        at = (np.arange(size) + 0.5) * self.side / size
        rows, columns = (np.rint(at + first).astype(int) for first in (self.v0, self.u0))
        height, width = image.shape[:2]
        inside = ((rows >= 0) & (rows < height))[:, None] & (columns >= 0) & (columns < width)
        window = image[np.ix_(rows.clip(0, height - 1), columns.clip(0, width - 1))].copy()
        window[~inside] = fill
        return window


def grey_depth(depth: NDArray[np.float32], scene: NDArray[np.float32] | None = None) -> Pixels:
    """A depth image [m] as a picture, shape (H, W, 3): near is bright, far dark.

    Args:
        depth: shape (H, W), 0 where there is no reading.
        scene: depth values [m] whose range the grey levels span; None for all of the image.
    """
    readings = depth[depth > 0] if scene is None else scene[scene > 0]
    near, far = np.percentile(readings, (1, 99)) if len(readings) else (0.0, 1.0)
    level = 220 - 120 * np.clip((depth - near) / max(far - near, 1e-3), 0, 1.4)
    pixels = np.repeat(level[..., None], 3, axis=2).astype(np.uint8)
    pixels[depth <= 0] = NO_READING
    return pixels


def outline(labels: NDArray[Any], thickness: int = 1) -> NDArray[np.bool_]:
    """Pixels of a label image, shape (H, W), at the border between two labels."""
    border = np.zeros(labels.shape, dtype=bool)
    border[:, 1:] |= labels[:, 1:] != labels[:, :-1]
    border[1:, :] |= labels[1:, :] != labels[:-1, :]
    for _ in range(thickness - 1):
        grown = border.copy()
        grown[:, :-1] |= border[:, 1:]
        grown[:-1, :] |= border[1:, :]
        border = grown
    return border


def residual_colours(residual: NDArray[np.floating]) -> Pixels:
    """Colours of observed minus rendered depth [m]: blue in front of the model, red behind it."""
    t = np.clip(residual / RESIDUAL_LIMIT, -1, 1)[..., None]
    white, red, blue = np.array([[245, 245, 245], [215, 25, 30], [30, 80, 220]], dtype=float)
    strength = np.abs(t) ** 0.7  # lifts small residuals out of the white
    return np.asarray(white + strength * (np.where(t > 0, red, blue) - white)).astype(np.uint8)


def draw_estimate(
    estimate: PoseEstimate,
    hand: Hand,
    obj: ObjectModel,
    depth: NDArray[np.float32],
    camera: Camera,
    *,
    colour: Pixels | None = None,
    device: str = "cpu",
) -> Image.Image:
    """Draw the estimated hand and object into the image, and the depth residual beside it.

    Args:
        estimate: what to draw; without an answer the picture says why.
        hand: the estimated hand.
        obj: the estimated object.
        depth: the observed depth image [m], shape (H, W), 0, NaN or inf where there is no reading.
        camera: its camera.
        colour: a colour image with the same pixels, shape (H, W, 3), to draw on instead of depth.
        device: Warp device of the rendering.
    """
    depth = np.nan_to_num(depth, nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32)
    scene = _Scene(estimate, hand, obj, camera, device)
    window = Window.around(scene.labels >= 0)
    background = grey_depth(depth, depth[scene.labels >= 0]) if colour is None else colour
    overlay = _overlay(scene, window, window.cut(background, _PAPER), obj)
    lines = _title(estimate, obj, scene.residual(depth), scene.labels == scene.object_label)
    top = _GAP + _LINE * len(lines)
    picture = Image.new("RGB", (2 * PANEL + 3 * _GAP, top + PANEL + 2 * _GAP + 2 * _LINE), _PAPER)
    draw = ImageDraw.Draw(picture)
    for i, line in enumerate(lines):
        draw.text((_GAP, _GAP // 2 + i * _LINE), line, fill=_INK, font=_font(15))
    picture.paste(overlay, (_GAP, top))
    picture.paste(_residual_panel(scene, window, depth), (PANEL + 2 * _GAP, top))
    below = top + PANEL + _GAP // 2
    _draw_legend(draw, _GAP, below)
    _draw_scale(picture, PANEL + 2 * _GAP, below)
    return picture


class _Scene:
    """The estimated hand and object, rendered."""

    def __init__(
        self, estimate: PoseEstimate, hand: Hand, obj: ObjectModel, camera: Camera, device: str
    ) -> None:
        meshes: list[TriangleMesh] = []
        poses: list[NDArray[np.float64]] = []
        if estimate.T_camera_hand is not None and estimate.joint_positions:
            q = hand.joint_vector(estimate.joint_positions)
            meshes += [link.mesh for link in hand.links]
            poses += list(estimate.T_camera_hand @ hand.forward_kinematics(q))
        self.object_label = len(meshes)
        self.T_camera_object = estimate.T_camera_object
        if self.T_camera_object is not None:
            meshes.append(obj.mesh)
            poses.append(self.T_camera_object)
        self.camera = camera
        self._poses = np.array(poses).reshape(-1, 4, 4)
        self._renderer = DepthRenderer(meshes, device) if meshes else None
        self._object = None if self.T_camera_object is None else DepthRenderer([obj.mesh], device)
        self.depth, self.labels = self.render(camera)

    def render(self, camera: Camera) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """Depth [m] and labels, both (H, W): index of the link, `object_label`, -1 for neither."""
        if self._renderer is None:
            size = (camera.height, camera.width)
            return np.zeros(size, dtype=np.float32), np.full(size, -1, dtype=np.int32)
        return self._renderer.render(camera, self._poses)

    def object_silhouette(self, camera: Camera) -> NDArray[np.bool_]:
        """Where the object would be seen without the hand, shape (H, W)."""
        if self._object is None or self.T_camera_object is None:
            return np.zeros((camera.height, camera.width), dtype=bool)
        return self._object.render(camera, self.T_camera_object[None])[1] >= 0

    def residual(self, observed: NDArray[np.float32]) -> NDArray[np.float32]:
        """Observed minus rendered depth [m], shape (H, W), NaN where either is missing."""
        both = (self.depth > 0) & (observed > 0)
        return np.where(both, observed - self.depth, np.nan).astype(np.float32)


def _overlay(scene: _Scene, window: Window, pixels: Pixels, obj: ObjectModel) -> Image.Image:
    camera = window.camera(scene.camera)
    labels = scene.render(camera)[1]
    is_object = labels == scene.object_label
    is_hand = (labels >= 0) & ~is_object
    for mask, colour in ((is_hand, HAND_COLOUR), (is_object, OBJECT_COLOUR)):
        pixels[mask] = (1 - _TINT) * pixels[mask] + _TINT * np.array(colour)
    pixels[outline(scene.object_silhouette(camera))] = HIDDEN_COLOUR
    pixels[outline(np.where(is_hand, labels, -1))] = HAND_COLOUR
    pixels[outline(labels >= 0, 2)] = HAND_COLOUR
    pixels[outline(is_object, 2)] = OBJECT_COLOUR
    image = Image.fromarray(pixels)
    if scene.T_camera_object is not None:
        _draw_axes(ImageDraw.Draw(image), camera, scene.T_camera_object, obj)
    return image


def _draw_axes(
    draw: ImageDraw.ImageDraw, camera: Camera, T: NDArray[np.float64], obj: ObjectModel
) -> None:
    """The object's axes, drawn from its middle: the frame's origin may lie outside the object."""
    tips = obj.centre + 0.6 * obj.diameter * np.vstack([np.zeros(3), np.eye(3)])
    points = transform(T, tips)
    if points[:, 2].min() <= 0:
        return
    start, *ends = map(tuple, camera.project(points).tolist())
    for (name, colour), end in zip(_AXES, ends, strict=True):
        draw.line([start, end], fill=colour, width=3)
        draw.text(end, name, fill=colour, font=_font(15), stroke_width=2, stroke_fill=_PAPER)


def _residual_panel(scene: _Scene, window: Window, depth: NDArray[np.float32]) -> Image.Image:
    residual = scene.residual(depth)
    known = np.isfinite(residual)
    # What the estimate does not explain stays dimly visible around it.
    dim = 0.35 * grey_depth(depth, depth[scene.labels >= 0]).astype(float)
    pixels = np.where(depth[..., None] > 0, dim, _PAPER).astype(np.uint8)
    pixels[scene.labels >= 0] = (100, 85, 100)
    pixels[known] = residual_colours(residual[known])
    shown = window.cut(pixels, _PAPER)
    labels = scene.render(window.camera(scene.camera))[1]
    shown[outline(labels == scene.object_label, 2)] = OBJECT_COLOUR
    image = Image.fromarray(shown)
    if not known.any():
        note = "no estimate to compare with" if (labels < 0).all() else "no readings to compare"
        ImageDraw.Draw(image).text(
            (PANEL / 2, PANEL / 2), note, fill=_FAINT, font=_font(15), anchor="mm"
        )
    return image


def _title(
    estimate: PoseEstimate,
    obj: ObjectModel,
    residual: NDArray[np.float32],
    is_object: NDArray[np.bool_],
) -> list[str]:
    if not estimate.found:
        return wrap(f"{obj.name}: NO ANSWER. {estimate.reason}", 140)
    parts = []
    for name, mask in (("hand", ~is_object), ("object", is_object)):
        values = np.abs(residual[mask & np.isfinite(residual)])
        size = f"{1000 * np.median(values):.1f} mm" if len(values) else "not visible"
        parts.append(f"{name} {size}")
    return [
        f"{obj.name}: found, confidence {estimate.confidence:.2f}    "
        f"median |observed - rendered|: {', '.join(parts)}"
    ]


def _draw_legend(draw: ImageDraw.ImageDraw, x: int, y: int) -> None:
    entries: Sequence[tuple[str, Colour]] = (
        ("estimated hand", HAND_COLOUR),
        ("estimated object", OBJECT_COLOUR),
        ("its hidden edge", HIDDEN_COLOUR),
        ("no reading", (60, 60, 110)),
    )
    for text, colour in entries:
        draw.rectangle((x, y + 4, x + 12, y + 14), fill=colour)
        draw.text((x + 18, y), text, fill=_INK, font=_font(13))
        x += 36 + int(draw.textlength(text, font=_font(13)))


def _draw_scale(picture: Image.Image, x: int, y: int) -> None:
    """The colour bar of the residual map with millimetres below it."""
    draw = ImageDraw.Draw(picture)
    ramp = np.linspace(-RESIDUAL_LIMIT, RESIDUAL_LIMIT, PANEL // 2)
    bar = Image.fromarray(np.repeat(residual_colours(ramp)[None], 12, axis=0))
    left = x + PANEL // 4
    picture.paste(bar, (left, y + 3))
    draw.text((left - 8, y), "in front", fill=_INK, font=_font(13), anchor="ra")
    draw.text((left + PANEL // 2 + 8, y), "behind the model", fill=_INK, font=_font(13))
    for share in (-1.0, -0.5, 0.0, 0.5, 1.0):
        at = left + PANEL // 4 * (1 + share)
        text = f"{1000 * RESIDUAL_LIMIT * share:+.0f}" if share else "0 mm"
        draw.text((at, y + 18), text, fill=_FAINT, font=_font(12), anchor="ma")


def _font(size: int) -> Any:
    return ImageFont.load_default(size=size)
