"""What the labelling page shows of an image and its label: in 3D, and in two pictures."""

from typing import Any

import numpy as np

from inhand.annotation.images import RawImage
from inhand.annotation.session import Array, Label
from inhand.annotation.status import describe
from inhand.annotation.workbench import Workbench
from inhand.errors import InputError
from inhand.hand import Hand
from inhand.object_model import ObjectModel
from inhand.overlay import HAND_COLOUR, OBJECT_COLOUR, Placement, Rendering, Window, grey_depth
from inhand.viewer.clouds import reach_sphere, scene_cloud
from inhand.viewer.drawing import (
    CloudDrawing,
    HandDrawing,
    ObjectDrawing,
    View,
)
from inhand.viewer.silhouettes import SIZE, Pictures

CLOUD_MARGIN = 0.15
"""How much more than the hand's reach is shown of the scene [m]."""
OPACITY = 0.75
"""Of hand and object, so that the cloud shows through."""
PANEL_WIDTH = 410
"""Of the panel with the pictures [pixel]."""
LEGEND = """\
**Above**: outlines of the hand (blue) and of the object (orange; brown where it is hidden).
**Below**: observed minus rendered depth, blue in front of the model, red behind it, at 10 mm full;
grey where there is no reading."""


class LabelDrawing:
    """Cloud, hand and object in the 3D view.

    Args:
        server: the `viser.ViserServer`.
        hand: the hand.
    """

    def __init__(self, server: Any, hand: Hand) -> None:
        self._view, self._hand_model = View(server), hand
        self._cloud = CloudDrawing(self._view, "cloud")
        self._hand = HandDrawing(self._view, "hand", hand, HAND_COLOUR, OPACITY)
        self._object: tuple[str, ObjectDrawing] | None = None
        self._drawn = ""

    def show(self, image: str, raw: RawImage, label: Label, q: Array, obj: ObjectModel) -> None:
        """Show an image, by its name, with hand and object where its label says."""
        if image != self._drawn:
            self._draw_cloud(raw, label)
            self._drawn = image
        self._hand.draw(label.T_camera_hand, q)
        self._drawing_of(label.object_name, obj).draw(label.T_camera_object)

    def look_from_camera(self) -> None:
        """Show what the depth camera sees."""
        self._view.look_from_camera()

    def hide(self, cloud: bool = True, hand: bool = True, obj: bool = True) -> None:
        """Show some of it no more, until it is shown again."""
        if cloud:
            self._drawn = ""
            self._cloud.hide()
        if hand:
            self._hand.hide()
        if obj and self._object is not None:
            self._object[1].hide()

    def _drawing_of(self, name: str, obj: ObjectModel) -> ObjectDrawing:
        """The object's drawing; that of another one before is removed."""
        if self._object is None or self._object[0] != name:
            if self._object is not None:
                self._object[1].remove()
            drawing = ObjectDrawing(self._view, "object", obj.mesh, OBJECT_COLOUR, OPACITY)
            self._object = (name, drawing)
        return self._object[1]

    def _draw_cloud(self, raw: RawImage, label: Label) -> None:
        centre, radius = reach_sphere(self._hand_model, label.T_camera_hand, CLOUD_MARGIN)
        near = np.abs(raw.depth - centre[2]) < radius
        pixels = grey_depth(raw.depth, raw.depth[near]) if raw.rgb is None else raw.rgb
        points, colours, _ = scene_cloud(raw.depth, raw.camera, pixels, sphere=(centre, radius))
        self._cloud.draw(points, colours)
        self._view.look_at(centre)


class LabelPictures:
    """Silhouettes over the image, and the residual as colours below it.

    Args:
        gui: `server.gui` of viser.
    """

    def __init__(self, gui: Any) -> None:
        self._nothing = np.full((SIZE, SIZE, 3), 24, dtype=np.uint8)
        panel = gui.add_panel()
        with panel.add_tab("Image"):
            self._numbers = gui.add_markdown("")
            self._silhouettes = gui.add_image(self._nothing, jpeg_quality=90)
            self._residuals = gui.add_image(self._nothing, jpeg_quality=90)
            gui.add_markdown(LEGEND)
        panel.dock_left()
        panel.set_width(PANEL_WIDTH)
        gui.main_panel.dock_right()
        self._image, self._window = "", Window(0.0, 0.0, 1.0)

    def show(self, bench: Workbench) -> None:
        """Show the image that is looked at, with its label."""
        try:
            raw, label, tools = bench.raw, bench.label, bench.tools
        except InputError:
            return  # the page has said so
        placement = Placement(label.T_camera_hand, bench.joint_vector, label.T_camera_object)
        shown = tools.renderer.render(raw.camera, placement)
        if bench.file.name != self._image or not _fits(self._window, shown):
            self._image = bench.file.name
            self._window = Window.around(shown.is_hand | shown.is_object)
        pictures = Pictures(tools.renderer, raw.depth, raw.camera, self._window, raw.rgb)
        self._silhouettes.image = pictures.silhouettes(placement)
        self._residuals.image, residuals = pictures.residuals(placement)
        self._numbers.content = describe(bench, residuals)

    def clear(self) -> None:
        """Show nothing."""
        self._image = ""
        self._silhouettes.image = self._residuals.image = self._nothing
        self._numbers.content = ""


def _fits(window: Window, rendering: Rendering) -> bool:
    """Whether all that is seen of hand and object, and something, lies in a window."""
    v, u = np.nonzero(rendering.is_hand | rendering.is_object)
    if not len(u):
        return False
    low, high = np.array([window.u0, window.v0]), np.array([window.u0, window.v0]) + window.side
    return bool((low <= [u.min(), v.min()]).all() and ([u.max(), v.max()] <= high).all())
