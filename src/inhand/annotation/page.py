"""The labelling page: the image in 3D and with silhouettes, and controls to move hand and object.

Everything is done by one worker, one thing after the other, so that no two changes of a label meet.
The page holds nothing that the workbench does not: a browser that comes back, or a second one, sees
what is there.
"""

from collections.abc import Callable
from itertools import count
from typing import Any

from inhand.annotation.commands import Command
from inhand.annotation.controls import (
    CENTRE,
    TURN,
    CommandButtons,
    JointControls,
    LayerControls,
    ObjectControls,
    add_keys,
)
from inhand.annotation.drawing import LabelDrawing, LabelPictures
from inhand.annotation.gizmo import Gizmo
from inhand.annotation.status import ImageStatus, SaveStatus
from inhand.annotation.workbench import Workbench
from inhand.errors import InputError, NoAnswer
from inhand.viewer.worker import Worker


class LabellingPage:
    """The page of a workbench.

    Args:
        server: the `viser.ViserServer`.
        bench: the workbench.
    """

    def __init__(self, server: Any, bench: Workbench) -> None:
        self._server, self._bench = server, bench
        self.worker = Worker(self.tell)
        self._number = count()
        gui = server.gui
        self._image_status = ImageStatus(
            gui, len(bench.files), lambda index: self._do(lambda: bench.go_to(index))
        )
        self._save_status = SaveStatus(gui, lambda: self._do(bench.save))
        self._message = gui.add_markdown("")
        self._drawing = LabelDrawing(server, bench.hand.model)
        self._pictures = LabelPictures(gui)
        CommandButtons(gui, self._command)
        self._gizmo = Gizmo(server, self._dragged)
        self._object = ObjectControls(
            gui,
            tuple(bench.objects),
            lambda name: self._do(lambda: bench.take_object(name)),
            lambda centre: self._do(lambda: bench.place_centre(centre), moving=CENTRE),
            lambda rotation: self._do(lambda: bench.turn_object(rotation), moving=TURN),
            lambda nudge, mm, deg: self._do(lambda: nudge.act(bench, mm, deg)),
        )
        self._joints = JointControls(gui, bench.hand.model, self._bent)
        self._layers = LayerControls(
            gui, lambda: self._do(lambda: None), self._drawing.look_from_camera
        )
        write = gui.add_button("Write the data set", color="teal")
        write.on_click(lambda _: self._do(self._write_data_set))
        add_keys(gui)
        self._do(lambda: None)
        if bench.remark:
            self.worker.submit("remark", lambda: self.tell(bench.remark))

    def tell(self, message: str) -> None:
        """Show a message, to every browser and to those that come later."""
        self._message.content = f"⚠ {message}"
        for client in self._server.get_clients().values():
            client.add_notification("inhand", message, color="orange", auto_close_seconds=8.0)

    def stop(self) -> None:
        """Do what was asked for, then no more."""
        self.worker.wait(timeout=10.0)
        self.worker.stop()

    # What the user does

    def _command(self, command: Command) -> None:
        self._do(lambda: command.act(self._bench))

    def _bent(self, joint: str, position: float) -> None:
        self._do(lambda: self._bench.bend(joint, position), moving=joint)

    def _dragged(self, begins: bool) -> None:
        if begins:
            self._do(self._bench.begin_step)
        self._do(self._take_gizmo, moving="gizmo")

    def _take_gizmo(self) -> None:
        if self._gizmo.has_moved and self._gizmo.target == "object":
            self._bench.place_object(self._gizmo.pose)
        elif self._gizmo.has_moved and self._gizmo.target == "hand":
            self._bench.place_hand(self._gizmo.pose)

    def _write_data_set(self) -> None:
        def tell(done: int, total: int) -> None:
            self._message.content = f"Writing image {done + 1} of {total}"

        number = self._bench.write(tell)
        self._message.content = f"Images written to `{self._bench.folder}`: {number}"

    # How

    def _do(self, act: Callable[[], object], moving: str = "") -> None:
        """Have something done and shown; of one slider's positions only the latest."""
        name = moving or f"action {next(self._number)}"

        def job() -> None:
            self._message.content = ""
            try:
                act()
            except (InputError, NoAnswer) as problem:
                self.tell(str(problem))
            self._show(moving)

        self.worker.submit(name, job)

    def _show(self, moving: str) -> None:
        """Show what the workbench holds; the control that is being moved stays as it is."""
        bench = self._bench
        self._image_status.show(bench)
        self._save_status.show(bench)
        try:
            raw, label, q, tools = bench.raw, bench.label, bench.joint_vector, bench.tools
        except InputError as problem:
            self.tell(str(problem))
            self._drawing.hide()
            self._pictures.clear()
            return
        self._drawing.show(bench.file.name, raw, label, q, tools.obj)
        self._drawing.hide(*self._layers.hidden())
        self._object.show(label, tools.obj, moving)
        self._joints.show(q, moving)
        self._gizmo.show(tools.centred(label.T_camera_object), label.T_camera_hand)
        self.worker.submit("pictures", lambda: self._pictures.show(bench))
