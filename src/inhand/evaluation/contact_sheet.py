"""A picture of the frames that went worst, with truth and estimate drawn in."""

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from inhand.camera import Camera
from inhand.datasets.frames import LABEL_HAND, LABEL_OBJECT, Frame, read_frame
from inhand.evaluation.results import FrameResult
from inhand.hand import Hand
from inhand.kernels.depth import DepthRenderer
from inhand.object_model import ObjectModel

TILE = 320
"""Edge of a frame's picture [pixel]."""
COLUMNS = 6
"""Pictures in a row."""

TRUE_OBJECT = (70, 255, 70)
ESTIMATED_OBJECT = (255, 60, 60)
ESTIMATED_HAND = (90, 170, 255)
NO_READING = (24, 24, 48)

_MARGIN = 0.15
_LINE = 15

Pixels = NDArray[np.uint8]


def worst_frames(results: Iterable[FrameResult], count: int) -> list[FrameResult]:
    """The frames with the largest ADI, those without an answer first; failures left out."""
    scored = [r for r in results if r.outcome in ("answer", "no answer")]
    return sorted(scored, key=lambda r: (-(math.inf if r.adi is None else r.adi), r.frame))[
        :count
    ]


class ContactSheet:
    """Draws frames with the contours of the true object, the estimated object and hand.

    Args:
        hand: the hand in the frames.
        load_object: gives the model of the object of a name.
        device: Warp device of the rendering.
    """

    def __init__(
        self, hand: Hand, load_object: Callable[[str], ObjectModel], device: str = "cpu"
    ) -> None:
        self._hand = hand
        self._load_object = load_object
        self._device = device
        self._hand_renderer = DepthRenderer([link.mesh for link in hand.links], device)
        self._object_renderers: dict[str, DepthRenderer] = {}

    def save(self, path: Path, results: Sequence[FrameResult]) -> None:
        """Draw one picture a result, row by row, and write them to the image file `path`."""
        tiles = [self.tile(result) for result in results]
        rows = -(-len(tiles) // COLUMNS)
        sheet = Image.new("RGB", (COLUMNS * TILE, rows * (TILE + 2 * _LINE)))
        for i, tile in enumerate(tiles):
            sheet.paste(tile, (i % COLUMNS * tile.width, i // COLUMNS * tile.height))
        sheet.save(path)

    def tile(self, result: FrameResult) -> Image.Image:
        """The picture of one frame: its part of the depth image, contours, and a caption."""
        frame = read_frame(Path(result.file))
        camera, pixels = _view(frame)
        self._outline_object(pixels, frame, camera, frame.truth.T_camera_object, TRUE_OBJECT)
        if result.T_camera_hand is not None and result.joint_positions:
            q = [result.joint_positions[name] for name in self._hand.joint_names]
            poses = np.array(result.T_camera_hand) @ self._hand.forward_kinematics(q)
            pixels[_outline(self._hand_renderer, camera, poses)] = ESTIMATED_HAND
        if result.T_camera_object is not None:
            pose = np.array(result.T_camera_object)
            self._outline_object(pixels, frame, camera, pose, ESTIMATED_OBJECT)
        return _captioned(pixels, _caption(result))

    def _outline_object(
        self,
        pixels: Pixels,
        frame: Frame,
        camera: Camera,
        pose: NDArray[np.float64],
        colour: tuple[int, int, int],
    ) -> None:
        name = frame.object_name
        if name not in self._object_renderers:
            mesh = self._load_object(name).mesh
            self._object_renderers[name] = DepthRenderer([mesh], self._device)
        pixels[_outline(self._object_renderers[name], camera, pose[None])] = colour


def _outline(
    renderer: DepthRenderer, camera: Camera, poses: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Pixels of the silhouette that touch a pixel outside it."""
    shape = renderer.render(camera, poses)[1] >= 0
    padded = np.pad(shape, 1)
    inner = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return np.asarray(shape & ~inner)


def _view(frame: Frame) -> tuple[Camera, Pixels]:
    """The square around hand and object, enlarged: its camera and the grey depth image."""
    shown = np.isin(frame.truth.label, (LABEL_HAND, LABEL_OBJECT))
    v, u = np.nonzero(shown) if shown.any() else np.nonzero(np.ones_like(shown))
    side = (1 + 2 * _MARGIN) * float(np.max([np.ptp(u), np.ptp(v), 10]))
    u0, v0 = (u.min() + u.max() - side) / 2, (v.min() + v.max() - side) / 2
    scale = TILE / side
    c = frame.camera
    camera = Camera(
        c.fx * scale,
        c.fy * scale,
        (c.cx - u0 + 0.5) * scale - 0.5,
        (c.cy - v0 + 0.5) * scale - 0.5,
        TILE,
        TILE,
    )
    at = (np.arange(TILE) + 0.5) / scale - 0.5
    columns, rows = np.rint(at + u0).astype(int), np.rint(at + v0).astype(int)
    inside = ((rows >= 0) & (rows < c.height))[:, None] & (columns >= 0) & (columns < c.width)
    window = frame.depth[np.ix_(rows.clip(0, c.height - 1), columns.clip(0, c.width - 1))]
    return camera, _grey(np.where(inside, window, 0), frame.depth[shown])


def _grey(depth: NDArray[np.float32], scene: NDArray[np.float32]) -> Pixels:
    """Near bright, far dark, over the depth range of hand and object, shape (h, w, 3)."""
    readings = scene[scene > 0]
    near, far = np.percentile(readings, (1, 99)) if len(readings) else (0.0, 1.0)
    level = 210 - 150 * np.clip((depth - near) / max(far - near, 1e-3), 0, 1.2)
    pixels = np.repeat(level[..., None], 3, axis=2).astype(np.uint8)
    pixels[depth <= 0] = NO_READING
    return pixels


def _caption(result: FrameResult) -> list[str]:
    share = f"{result.visible_share:.0%} visible" if result.visible_share is not None else ""
    error = result.outcome if result.adi is None else f"ADI {result.adi * 1000:.1f} mm"
    blame = f", lost at {result.lost_at}" if result.lost_at else ""
    return [f"{result.frame}  {share}", error + blame]


def _captioned(pixels: Pixels, lines: Sequence[str]) -> Image.Image:
    tile = Image.new("RGB", (TILE, TILE + 2 * _LINE))
    tile.paste(Image.fromarray(pixels), (0, 0))
    draw = ImageDraw.Draw(tile)
    font = ImageFont.load_default(size=12)
    for i, line in enumerate(lines):
        draw.text((3, TILE + i * _LINE), line, fill=(255, 255, 255), font=font)
    return tile
