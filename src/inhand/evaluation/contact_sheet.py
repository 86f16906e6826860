"""A picture of the frames that went worst, with truth and estimate drawn in."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from inhand.camera import Camera
from inhand.datasets.frames import LABEL_HAND, LABEL_OBJECT, read_frame
from inhand.evaluation.results import FrameResult
from inhand.evaluation.summary import is_solved
from inhand.hand import Hand
from inhand.io import write_picture
from inhand.kernels.depth import DepthRenderer
from inhand.object_model import ObjectModel
from inhand.overlay import HAND_COLOUR, NO_READING, Window, grey_depth, outline

TILE = 320
"""Edge of a frame's picture [pixel]."""
COLUMNS = 6
"""Pictures in a row."""

TRUE_COLOUR = (70, 255, 70)
"""Contour of the object at its true pose."""
ESTIMATE_COLOUR = (255, 60, 60)
"""Contour of the object at its estimated pose."""

_LINE = 15


def worst_frames(results: Iterable[FrameResult], count: int) -> list[FrameResult]:
    """The frames with the largest ADI, those without an answer first; failures left out."""
    scored = [r for r in results if r.outcome in ("answer", "no answer")]
    return sorted(scored, key=lambda r: (-(math.inf if r.adi is None else r.adi), r.frame))[:count]


def hardest_solved(results: Iterable[FrameResult], count: int) -> list[FrameResult]:
    """Solved frames with the least of the object visible, every object in turn."""
    solved = sorted((r for r in results if is_solved(r)), key=lambda r: r.visible_share or 0.0)
    turn: Counter[str] = Counter()
    ranked = []
    for r in solved:
        ranked.append((turn[r.object_name], r.visible_share or 0.0, r.frame, r))
        turn[r.object_name] += 1
    return [r for *_, r in sorted(ranked, key=lambda entry: entry[:3])[:count]]


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
        """Draw one picture a result, row by row, and write them to the image file `path`.

        Raises:
            InputError: it cannot be written.
        """
        tiles = [self.tile(result) for result in results]
        rows = -(-len(tiles) // COLUMNS)
        sheet = Image.new("RGB", (COLUMNS * TILE, rows * (TILE + 2 * _LINE)))
        for i, tile in enumerate(tiles):
            sheet.paste(tile, (i % COLUMNS * tile.width, i // COLUMNS * tile.height))
        write_picture(path, sheet)

    def tile(self, result: FrameResult) -> Image.Image:
        """The picture of one frame: its part of the depth image, contours, and a caption."""
        frame = read_frame(result.file)
        shown = np.isin(frame.truth.label, (LABEL_HAND, LABEL_OBJECT))
        window = Window.around(shown)
        camera = window.camera(frame.camera, TILE)
        pixels = window.cut(grey_depth(frame.depth, frame.depth[shown]), NO_READING, TILE)

        is_object = self._object_renderer(frame.object_name)
        pixels[_contour(is_object, camera, frame.truth.T_camera_object[None])] = TRUE_COLOUR
        if result.T_camera_hand is not None and result.joint_positions:
            q = self._hand.joint_vector(result.joint_positions)
            T_camera_link = np.array(result.T_camera_hand) @ self._hand.forward_kinematics(q)
            pixels[_contour(self._hand_renderer, camera, T_camera_link)] = HAND_COLOUR
        if result.T_camera_object is not None:
            T_camera_object = np.array(result.T_camera_object)[None]
            pixels[_contour(is_object, camera, T_camera_object)] = ESTIMATE_COLOUR
        return _captioned(pixels, _caption(result))

    def _object_renderer(self, name: str) -> DepthRenderer:
        if name not in self._object_renderers:
            mesh = self._load_object(name).mesh
            self._object_renderers[name] = DepthRenderer([mesh], self._device)
        return self._object_renderers[name]


def _contour(
    renderer: DepthRenderer, camera: Camera, poses: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Pixels on the edge of the meshes' common silhouette."""
    return outline(renderer.render(camera, poses)[1] >= 0)


def _caption(result: FrameResult) -> list[str]:
    share = f"{result.visible_share:.0%} visible" if result.visible_share is not None else ""
    error = result.outcome if result.adi is None else f"ADI {result.adi * 1000:.1f} mm"
    blame = f", lost at {result.lost_at}" if result.lost_at else ""
    return [f"{result.frame}  {share}", error + blame]


def _captioned(pixels: NDArray[np.uint8], lines: Sequence[str]) -> Image.Image:
    tile = Image.new("RGB", (TILE, TILE + 2 * _LINE))
    tile.paste(Image.fromarray(pixels), (0, 0))
    draw = ImageDraw.Draw(tile)
    font = ImageFont.load_default(size=12)
    for i, line in enumerate(lines):
        draw.text((3, TILE + i * _LINE), line, fill=(255, 255, 255), font=font)
    return tile
