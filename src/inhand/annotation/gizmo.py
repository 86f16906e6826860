"""The handle in the 3D view that moves the object, or the hand."""

from collections.abc import Callable
from typing import Any, Literal, get_args

import numpy as np

from inhand.annotation.session import Array
from inhand.viewer.drawing import CAMERA, move, pose_of

Target = Literal["object", "hand", "nothing"]


class Gizmo:
    """Arrows, planes and rings to be dragged.

    Args:
        server: the `viser.ViserServer`.
        moved: called when the user drags it, with whether the drag begins.
    """

    def __init__(self, server: Any, moved: Callable[[bool], None]) -> None:
        self._moved, self._dragged = moved, False
        targets = get_args(Target)
        self._target = server.gui.add_dropdown("Handle moves", targets, initial_value="object")
        self._node = server.scene.add_transform_controls(
            f"{CAMERA}/gizmo", scale=0.06, line_width=3.0, depth_test=False, opacity=0.8
        )
        self._node.on_update(self._on_drag)
        self._target.on_update(lambda _: self._place())
        server.on_client_disconnect(lambda _: self._let_go())
        self._poses: dict[str, Array] = {}

    @property
    def target(self) -> Target:
        """What the handle moves."""
        target: Target = self._target.value
        return target

    @property
    def pose(self) -> Array:
        """Where it is in the camera, shape (4, 4)."""
        return pose_of(self._node)

    @property
    def has_moved(self) -> bool:
        """Whether it is elsewhere than it was put: to touch it moves nothing."""
        put = self._poses.get(self.target)
        return put is not None and not np.allclose(put, self.pose, rtol=0, atol=1e-6)

    def show(self, T_camera_object: Array, T_camera_hand: Array) -> None:
        """Put the handle to where hand and object are; poses (4, 4) of what is turned about."""
        self._poses = {"object": T_camera_object, "hand": T_camera_hand}
        if not self._dragged:
            self._place()

    def _place(self) -> None:
        pose = self._poses.get(self.target)
        self._node.visible = pose is not None
        if pose is not None:
            move(self._node, pose)

    def _let_go(self) -> None:
        """A browser that is closed in the middle of a drag never says that it ends."""
        self._dragged = False
        self._place()

    async def _on_drag(self, event: Any) -> None:  # async: viser keeps the phases in order
        self._dragged = event.phase != "end"
        self._moved(event.phase == "start")
