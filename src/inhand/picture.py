"""A picture of an estimate: outlines over the image, and what depth says against it beside it."""

from collections.abc import Sequence
from textwrap import wrap
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from inhand.camera import Camera
from inhand.estimate import PoseEstimate
from inhand.geometry.se3 import transform
from inhand.hand import Hand
from inhand.object_model import ObjectModel
from inhand.overlay import (
    HAND_COLOUR,
    HIDDEN_COLOUR,
    OBJECT_COLOUR,
    OUTSIDE,
    PANEL,
    RESIDUAL_LIMIT,
    Colour,
    ModelRenderer,
    Pixels,
    Placement,
    Rendering,
    Window,
    draw_outlines,
    grey_depth,
    outline,
    residual_colours,
    residual_map,
)

_AXES = (("x", (255, 70, 70)), ("y", (80, 220, 80)), ("z", (90, 120, 255)))
_PAPER, _INK, _FAINT = OUTSIDE, (240, 240, 240), (150, 150, 155)
_GAP = 14
_LINE = 20


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
    models, placement = ModelRenderer(hand, obj, device), Placement.of_estimate(estimate, hand)
    rendering = models.render(camera, placement)
    shown = rendering.is_hand | rendering.is_object
    window = Window.around(shown)
    enlarged = models.render(window.camera(camera), placement)
    background = grey_depth(depth, depth[shown]) if colour is None else colour
    overlay = Image.fromarray(draw_outlines(window.cut(background, _PAPER), enlarged))
    if estimate.T_camera_object is not None:
        T = estimate.T_camera_object
        _draw_axes(ImageDraw.Draw(overlay), window.camera(camera), T, obj)
    lines = _title(estimate, obj, rendering.residual(depth), rendering.is_object)
    top = _GAP + _LINE * len(lines)
    picture = Image.new("RGB", (2 * PANEL + 3 * _GAP, top + PANEL + 2 * _GAP + 2 * _LINE), _PAPER)
    draw = ImageDraw.Draw(picture)
    for i, line in enumerate(lines):
        draw.text((_GAP, _GAP // 2 + i * _LINE), line, fill=_INK, font=_font(15))
    picture.paste(overlay, (_GAP, top))
    residual = _residual_panel(window, rendering, enlarged, depth)
    picture.paste(residual, (PANEL + 2 * _GAP, top))
    below = top + PANEL + _GAP // 2
    _draw_legend(draw, _GAP, below)
    _draw_scale(picture, PANEL + 2 * _GAP, below)
    return picture


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


def _residual_panel(
    window: Window, rendering: Rendering, enlarged: Rendering, depth: NDArray[np.float32]
) -> Image.Image:
    """The window of the residual map, with the object's outline from a rendering enlarged alike."""
    pixels = window.cut(residual_map(depth, rendering), _PAPER)
    pixels[outline(enlarged.is_object, 2)] = OBJECT_COLOUR
    image = Image.fromarray(pixels)
    if not np.isfinite(rendering.residual(depth)).any():
        nothing = not (rendering.is_hand | rendering.is_object).any()
        note = "no estimate to compare with" if nothing else "no readings to compare"
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
