"""The pictures beside the 3D view: silhouettes over the image, and the residual as colours."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.overlay import (
    OBJECT_COLOUR,
    OUTSIDE,
    ModelRenderer,
    Pixels,
    Placement,
    Rendering,
    Window,
    draw_outlines,
    grey_depth,
    outline,
    residual_map,
)

SIZE = 480
"""Edge of a picture [pixel]."""
TRUE_COLOUR = (70, 255, 70)
"""Outline of the object where it truly is."""
AGREES = 0.003
"""Readings this near to the model's surface agree with it [m]."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """How depth and models differ where the models are seen."""

    hand: NDArray[np.float32]
    """Observed minus rendered depth [m] at the pixels that show the hand and have a reading,
    shape (n,): negative in front of the model, positive behind it."""
    object: NDArray[np.float32]
    """The same of the object, shape (m,)."""
    object_missing: int
    """Pixels that should show the object and have no reading."""

    @classmethod
    def of(cls, rendering: Rendering, observed: NDArray[np.float32]) -> "Residuals":
        """The residuals of models rendered by the camera of a depth image [m], shape (H, W)."""
        residual = rendering.residual(observed)
        known = np.isfinite(residual)
        return cls(
            residual[known & rendering.is_hand],
            residual[known & rendering.is_object],
            int(np.count_nonzero(rendering.is_object & ~known)),
        )

    def summary(self) -> str:
        """A line each for hand and object, in Markdown."""
        return "\n".join(
            f"- **{name}**: {_describe(values)}{missing}"
            for name, values, missing in (
                ("hand", self.hand, ""),
                ("object", self.object, _percent_missing(len(self.object), self.object_missing)),
            )
        )


class Pictures:
    """Draws pictures of one image, a window of it enlarged.

    Args:
        models: renders hand and object.
        depth: depth image [m], shape (H, W), 0 where there is no reading.
        camera: its camera.
        window: the window; see `Window.around`.
        colour: colour image to draw on instead of depth, shape (H, W, 3).
        size: edge of the pictures [pixel].
    """

    def __init__(
        self,
        models: ModelRenderer,
        depth: NDArray[np.float32],
        camera: Camera,
        window: Window,
        colour: Pixels | None = None,
        size: int = SIZE,
    ) -> None:
        self.models, self.depth, self.camera, self.window = models, depth, camera, window
        self._size = size
        self._last: dict[Camera, tuple[Placement, Rendering]] = {}
        self._truth: tuple[Placement | None, NDArray[np.bool_] | None] = (None, None)
        self._enlarged_camera = window.camera(camera, size)
        background = grey_depth(depth, window.cut(depth, 0.0)) if colour is None else colour
        self._background = window.cut(background, OUTSIDE, size)

    def silhouettes(self, placement: Placement, truth: Placement | None = None) -> Pixels:
        """Hand and object outlined, and the true object if it is given, (size, size, 3)."""
        drawn = draw_outlines(self._background, self._render(self._enlarged_camera, placement))
        if truth is not None:
            drawn[self._true_outline(truth)] = TRUE_COLOUR
        return drawn

    def residuals(self, placement: Placement) -> tuple[Pixels, Residuals]:
        """The residual as colours, (size, size, 3), and in numbers."""
        rendering = self.rendering(placement)
        enlarged = self._render(self._enlarged_camera, placement)
        pixels = self.window.cut(residual_map(self.depth, rendering), OUTSIDE, self._size)
        pixels[outline(enlarged.is_object, 2)] = OBJECT_COLOUR
        return pixels, Residuals.of(rendering, self.depth)

    def rendering(self, placement: Placement) -> Rendering:
        """Hand and object as the camera of the image sees them."""
        return self._render(self.camera, placement)

    def _true_outline(self, truth: Placement) -> NDArray[np.bool_]:
        """Outline of the object where it truly is, shape (size, size); the last one is kept."""
        last, mask = self._truth
        if mask is None or last is not truth:
            alone = replace(truth, T_camera_hand=None)
            mask = outline(self.models.render(self._enlarged_camera, alone).silhouette)
            self._truth = truth, mask
        return mask

    def _render(self, camera: Camera, placement: Placement) -> Rendering:
        """A rendering; the last one by every camera is kept, as several pictures need it."""
        last = self._last.get(camera)
        if last is None or last[0] is not placement:
            last = placement, self.models.render(camera, placement)
            self._last[camera] = last
        return last[1]


def _describe(residual: NDArray[np.float32]) -> str:
    if not len(residual):
        return "not seen"
    agree = np.mean(np.abs(residual) < AGREES)
    return (
        f"{1000 * np.median(np.abs(residual)):.1f} mm in the median, {agree:.0%} of "
        f"{len(residual)} px within {1000 * AGREES:.0f} mm"
    )


def _percent_missing(seen: int, missing: int) -> str:
    return f", {missing / (seen + missing):.0%} without a reading" if missing else ""
