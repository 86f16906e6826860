"""What is drawn over a depth image: outlines of hand and object, and the residual as colours."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.estimate import PoseEstimate
from inhand.hand import Hand
from inhand.kernels.depth import DepthRenderer
from inhand.object_model import ObjectModel

PANEL = 540
"""Edge of an enlarged window [pixel]."""
RESIDUAL_LIMIT = 0.01
"""Residual [m] at which the colours of the residual map end."""

HAND_COLOUR = (80, 170, 255)
OBJECT_COLOUR = (255, 150, 40)
HIDDEN_COLOUR = (150, 95, 40)
NO_READING = (24, 24, 48)
OUTSIDE = (18, 18, 22)
"""What is drawn beside the image."""
_UNEXPLAINED = (100, 85, 100)
_TINT = 0.25
_WINDOW_MARGIN = 0.12
_SMALLEST_WINDOW = 24

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


@dataclass(frozen=True, eq=False)
class Placement:
    """Where hand and object are, as far as that is known."""

    T_camera_hand: NDArray[np.float64] | None = None
    """Pose of the hand's root link, shape (4, 4)."""
    joint_vector: NDArray[np.float64] | None = None
    """Positions of the independent joints [rad, m], shape (n,)."""
    T_camera_object: NDArray[np.float64] | None = None
    """Pose of the object, shape (4, 4)."""

    @classmethod
    def of_estimate(cls, estimate: PoseEstimate, hand: Hand) -> "Placement":
        """Where an estimate says they are."""
        if estimate.T_camera_hand is None or not estimate.joint_positions:
            return cls(T_camera_object=estimate.T_camera_object)
        q = hand.joint_vector(estimate.joint_positions)
        return cls(estimate.T_camera_hand, q, estimate.T_camera_object)


@dataclass(frozen=True, eq=False)
class Rendering:
    """Hand and object as a camera sees them."""

    depth: NDArray[np.float32]
    """Depth of the nearer of both [m], shape (H, W), 0 where neither is."""
    link: NDArray[np.int32]
    """Index of the hand's link that is seen, shape (H, W), -1 for none."""
    silhouette: NDArray[np.bool_]
    """Where the object would be seen without the hand, shape (H, W)."""

    @cached_property
    def is_hand(self) -> NDArray[np.bool_]:
        """Where the hand is seen, shape (H, W)."""
        return self.link >= 0

    @cached_property
    def is_object(self) -> NDArray[np.bool_]:
        """Where the object is seen, shape (H, W)."""
        return self.silhouette & ~self.is_hand

    def residual(self, observed: NDArray[np.float32]) -> NDArray[np.float32]:
        """Observed minus rendered depth [m], shape (H, W), NaN where either is missing."""
        both = (self.depth > 0) & (observed > 0)
        return np.where(both, observed - self.depth, np.nan).astype(np.float32)


class ModelRenderer:
    """Renders a hand and an object, together and as often as wanted.

    Args:
        hand: the hand.
        obj: the object.
        device: Warp device name.
    """

    def __init__(self, hand: Hand, obj: ObjectModel, device: str = "cpu") -> None:
        self.hand, self.obj = hand, obj
        self._links = DepthRenderer([link.mesh for link in hand.links], device)
        self._object = DepthRenderer([obj.mesh], device)

    def render(self, camera: Camera, placement: Placement) -> Rendering:
        """What the camera sees of them where they are; nothing of what has no place."""
        size = (camera.height, camera.width)
        depth, link = np.zeros(size, dtype=np.float32), np.full(size, -1, dtype=np.int32)
        if placement.T_camera_hand is not None and placement.joint_vector is not None:
            links = self.hand.forward_kinematics(placement.joint_vector)
            depth, link = self._links.render(camera, placement.T_camera_hand @ links)
        if placement.T_camera_object is None:
            return Rendering(depth, link, np.zeros(size, dtype=bool))
        in_object, seen = self._object.render(camera, placement.T_camera_object[None])
        in_front = (seen >= 0) & ((link < 0) | (in_object < depth))
        return Rendering(
            np.where(in_front, in_object, depth), np.where(in_front, -1, link), seen >= 0
        )


def draw_outlines(pixels: Pixels, rendering: Rendering) -> Pixels:
    """A picture, shape (H, W, 3), with hand and object tinted and outlined."""
    drawn = pixels.copy()
    is_hand, is_object = rendering.is_hand, rendering.is_object
    for mask, colour in ((is_hand, HAND_COLOUR), (is_object, OBJECT_COLOUR)):
        drawn[mask] = (1 - _TINT) * drawn[mask] + _TINT * np.array(colour)
    drawn[outline(rendering.silhouette)] = HIDDEN_COLOUR
    drawn[outline(rendering.link)] = HAND_COLOUR
    drawn[outline(is_hand | is_object, 2)] = HAND_COLOUR
    drawn[outline(is_object, 2)] = OBJECT_COLOUR
    return drawn


def residual_map(observed: NDArray[np.float32], rendering: Rendering) -> Pixels:
    """The residual as colours, shape (H, W, 3).

    What the models do not explain stays dimly visible around it.

    Args:
        observed: depth image [m], shape (H, W), 0 where there is no reading.
        rendering: the models, rendered by the camera of that image.
    """
    shown = rendering.is_hand | rendering.is_object
    dim = 0.35 * grey_depth(observed, observed[shown]).astype(float)
    pixels = np.where(observed[..., None] > 0, dim, OUTSIDE).astype(np.uint8)
    pixels[shown] = _UNEXPLAINED
    residual = rendering.residual(observed)
    known = np.isfinite(residual)
    pixels[known] = residual_colours(residual[known])
    return pixels
