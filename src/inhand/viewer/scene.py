"""What a page draws in 3D of an analysis."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from inhand.geometry.se3 import transform
from inhand.hand import Hand
from inhand.object_model import ObjectModel
from inhand.overlay import HAND_COLOUR, OBJECT_COLOUR, Placement, grey_depth, residual_colours
from inhand.viewer.analysis import Analysis
from inhand.viewer.clouds import DIM, scene_cloud, score_colours
from inhand.viewer.controls import CloudKind, LayerControls
from inhand.viewer.drawing import (
    CameraDrawing,
    CloudDrawing,
    HandDrawing,
    ObjectDrawing,
    View,
)
from inhand.viewer.silhouettes import TRUE_COLOUR
from inhand.viewer.stages import StageView

POSE_SIZE = 0.003
"""Edge length of the points that stand for poses [m]."""


@dataclass(frozen=True, eq=False)
class Shown:
    """What is to be seen."""

    analysis: Analysis
    stage: StageView
    """The chosen stage."""
    placement: Placement
    """Where hand and object are drawn."""


class SceneDrawing:
    """Draws an analysis, and sends anew only what has changed.

    Args:
        view: the 3D view.
        hand: the hand in all frames.
    """

    def __init__(self, view: View, hand: Hand) -> None:
        self._view = view
        self._cloud = CloudDrawing(view, "cloud")
        self._poses = CloudDrawing(view, "poses")
        self._hand = HandDrawing(view, "hand", hand, HAND_COLOUR, 0.6)
        self._true_hand = HandDrawing(view, "true_hand", hand, TRUE_COLOUR, 0.3)
        self._camera = CameraDrawing(view)
        self._objects: tuple[ObjectDrawing, ObjectDrawing] | None = None
        self._drawn: dict[str, Any] = {}

    def draw(self, shown: Shown, layers: LayerControls) -> None:
        """Show it."""
        if self._is_new("frame", shown.analysis.frame):
            self._view.look_at(shown.analysis.sphere[0])
        self._draw_cloud(shown, layers.cloud if layers.shows("Cloud") else None)
        self._draw_hands(shown, layers)
        self._draw_objects(shown, layers)
        self._draw_poses(shown, layers.shows("All poses"))
        self._draw_camera(shown.analysis, layers.shows("Camera"))

    def clear(self) -> None:
        """Show nothing."""
        drawings = (self._cloud, self._poses, self._hand, self._true_hand, self._camera)
        for drawing in (*drawings, *(self._objects or ())):
            drawing.hide()
        for part in ("cloud", "poses", "camera"):
            self._drawn.pop(part, None)

    def _is_new(self, what: str, *state: Any) -> bool:
        """Whether a part of the scene was drawn for another state the last time."""
        last = self._drawn.get(what)
        self._drawn[what] = state
        return last is None or any(a is not b for a, b in zip(last, state, strict=True))

    def _draw_cloud(self, shown: Shown, kind: CloudKind | None) -> None:
        of_residual = shown.placement if kind == "by residual" else None
        if not self._is_new("cloud", shown.analysis, shown.stage, kind, of_residual):
            return
        if kind is None:
            self._cloud.hide()
        elif kind == "by stage" and shown.stage.cloud is not None:
            self._cloud.draw(shown.stage.cloud.points, shown.stage.cloud.colours)
        else:
            self._draw_image_cloud(shown.analysis, of_residual)

    def _draw_image_cloud(self, analysis: Analysis, of_residual: Placement | None) -> None:
        """Every reading around the hand, in the image's colours or in those of the residual."""
        frame = analysis.frame
        pixels = grey_depth(frame.depth) if frame.colour is None else frame.colour
        points, colours, index = scene_cloud(
            frame.depth, frame.camera, pixels, sphere=analysis.sphere
        )
        if of_residual is not None:
            rendering = analysis.pictures.rendering(of_residual)
            residual = rendering.residual(frame.depth).reshape(-1)[index]
            known = np.isfinite(residual)
            colours = np.tile(np.array(DIM, dtype=np.uint8), (len(points), 1))
            colours[known] = residual_colours(residual[known])
        self._cloud.draw(points, colours)

    def _draw_hands(self, shown: Shown, layers: LayerControls) -> None:
        for drawing, placement, links, visible in (
            (self._hand, shown.placement, shown.stage.links, layers.shows("Hand")),
            (self._true_hand, shown.analysis.truth, None, layers.shows("True hand")),
        ):
            T = None if placement is None else placement.T_camera_hand
            q = None if placement is None else placement.joint_vector
            if visible and T is not None and q is not None:
                drawing.draw(T, q, links)
            else:
                drawing.hide()

    def _draw_objects(self, shown: Shown, layers: LayerControls) -> None:
        estimated, true = self._object_drawings(shown.analysis.obj)
        for drawing, placement, visible in (
            (estimated, shown.placement, layers.shows("Object")),
            (true, shown.analysis.truth, layers.shows("True object")),
        ):
            T = None if placement is None else placement.T_camera_object
            if visible and T is not None:
                drawing.draw(T)
            else:
                drawing.hide()

    def _object_drawings(self, obj: ObjectModel) -> tuple[ObjectDrawing, ObjectDrawing]:
        if self._objects is None or self._is_new("object", obj):
            for drawing in self._objects or ():
                drawing.remove()
            view, mesh, axes = self._view, obj.mesh, 0.6 * obj.diameter
            self._objects = (
                ObjectDrawing(
                    view, "object", mesh, OBJECT_COLOUR, 0.7, axes=axes, centre=obj.centre
                ),
                ObjectDrawing(view, "true_object", mesh, TRUE_COLOUR, 0.2),
            )
        return self._objects

    def _draw_poses(self, shown: Shown, visible: bool) -> None:
        """The middle of the object at every pose of the stage, coloured by score."""
        if not self._is_new("poses", shown.stage, visible):
            return
        poses = shown.stage.poses
        if not visible or not len(poses):
            self._poses.hide()
            return
        centre = shown.analysis.obj.centre
        middles = np.stack([transform(T, centre[None])[0] for T in poses])
        self._poses.draw(middles, score_colours(shown.stage.scores), POSE_SIZE)

    def _draw_camera(self, analysis: Analysis, visible: bool) -> None:
        if not self._is_new("camera", analysis, visible):
            return
        frame = analysis.frame
        if visible:
            pixels = grey_depth(frame.depth) if frame.colour is None else frame.colour
            self._camera.draw(frame.camera, pixels)
        else:
            self._camera.hide()
