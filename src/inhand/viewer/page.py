"""The page of one analysis after the other: 3D view, pictures and controls."""

from typing import Any

import numpy as np

from inhand.hand import Hand
from inhand.overlay import Placement
from inhand.viewer.adjusting import AdjustControls
from inhand.viewer.analysis import Analysis
from inhand.viewer.controls import LayerControls, StageControls, candidate_table
from inhand.viewer.drawing import View
from inhand.viewer.scene import SceneDrawing, Shown
from inhand.viewer.silhouettes import SIZE
from inhand.viewer.stages import CHOICE
from inhand.viewer.worker import Worker

PANEL_WIDTH = 380
"""Of the panel with the pictures [pixel]."""
NO_PICTURE = np.full((SIZE, SIZE, 3), 24, dtype=np.uint8)
LEGEND = """\
**Above**: outlines of the hand (blue), the object (orange; brown where it is hidden) and the true
object (green). **Below**: observed minus rendered depth, blue in front of the model, red behind it,
at 10 mm full; grey where there is no reading."""


class Page:
    """Shows an analysis, and what the user wants to see of it.

    Everything is drawn by one worker, from what the controls say at that time; so any thread may
    ask for it, and a browser that comes back finds what was left.

    Args:
        server: the `viser.ViserServer`.
        hand: the hand in all frames.
    """

    def __init__(self, server: Any, hand: Hand) -> None:
        self.server = server
        self.worker = Worker(self.tell)
        self._view = View(server)
        self._scene = SceneDrawing(self._view, hand)
        self._analysis: Analysis | None = None
        self._status = server.gui.add_markdown("", order=-2)
        self._add_pictures()
        self.stages = StageControls(server.gui, self._chosen)
        with server.gui.add_folder("Candidates", expand_by_default=False):
            self._table = server.gui.add_markdown("")
        self._layers = LayerControls(server.gui, self.redraw)
        server.gui.add_button("Look from the camera").on_click(
            lambda _: self._view.look_from_camera()
        )
        self._adjust = AdjustControls(server.gui, hand, self.redraw)
        for key, step in (("[", -1), ("]", 1)):
            name = "Next stage" if step > 0 else "Previous stage"
            command = server.gui.add_command(name, hotkey=key)
            command.on_trigger(lambda _, step=step: self.stages.turn(step))

    def show(self, analysis: Analysis) -> None:
        """Show an analysis; to be called by the worker."""
        self._analysis = analysis
        self.stages.show(analysis)
        self._layers.offer(analysis)
        self._status.content = _status(analysis)
        self._start_adjusting()
        self._draw_scene()
        self._draw_pictures()
        self._table.content = candidate_table(analysis)

    def clear(self) -> None:
        """Show nothing, as a frame cannot be shown; to be called by the worker."""
        self._analysis = None
        self.stages.clear()
        self._scene.clear()
        self._silhouettes.image = self._residuals.image = NO_PICTURE
        self._numbers.content = self._table.content = ""

    def redraw(self) -> None:
        """Have the page drawn as the controls say now."""
        self.worker.submit("scene", self._draw_scene)
        self.worker.submit("pictures", self._draw_pictures)

    def tell(self, message: str) -> None:
        """Show a message, to every browser and to those that come later."""
        self._status.content = f"⚠ {message}"
        for client in self.server.get_clients().values():
            client.add_notification("inhand", message, color="orange", auto_close_seconds=8.0)

    def stop(self) -> None:
        """Draw no more."""
        self.worker.stop()

    def _add_pictures(self) -> None:
        gui = self.server.gui
        panel = gui.add_panel()
        with panel.add_tab("Image"):
            self._numbers = gui.add_markdown("")
            self._silhouettes = gui.add_image(NO_PICTURE, jpeg_quality=90)
            self._residuals = gui.add_image(NO_PICTURE, jpeg_quality=90)
            gui.add_markdown(LEGEND)
        panel.dock_left()
        panel.set_width(PANEL_WIDTH)
        gui.main_panel.dock_right()

    def _chosen(self) -> None:
        """Another stage or pose was chosen."""
        self.worker.submit("start", self._start_adjusting)
        self.redraw()

    def _start_adjusting(self) -> None:
        if self._analysis is not None:
            base = self.stages.stage.placement(self.stages.rank)
            self._adjust.start_from(base, self._analysis.obj.centre)

    def _draw_scene(self) -> None:
        if self._analysis is not None:
            shown = Shown(self._analysis, self.stages.stage, self._adjust.placement())
            self._scene.draw(shown, self._layers)

    def _draw_pictures(self) -> None:
        analysis = self._analysis
        if analysis is None:
            return
        placement = self._adjust.placement()
        truth = analysis.truth if self._layers.shows("True object") else None
        self._silhouettes.image = analysis.pictures.silhouettes(placement, truth)
        self._residuals.image, residuals = analysis.pictures.residuals(placement)
        self._numbers.content = residuals.summary()
        self.stages.describe_pose(self._facts(analysis, placement))

    def _facts(self, analysis: Analysis, placement: Placement) -> str:
        """How good the object's pose is, where it is shown now."""
        stage, facts, moved = self.stages.stage, [], placement is not self._adjust.base
        if len(stage.scores) and not moved:
            facts.append(f"score in this stage {stage.scores[self.stages.rank]:.3f}")
        if moved or stage.name != CHOICE:
            score = analysis.score(placement)
            facts += (
                [] if score is None else [f"by the final score, the hand as drawn, {score:.3f}"]
            )
        if (adi := analysis.adi(placement.T_camera_object)) is not None:
            facts.append(f"off by **{1000 * adi:.1f} mm** (ADI)")
        return "; ".join(facts)


def _status(analysis: Analysis) -> str:
    """What came of the estimate, in Markdown."""
    estimate, verdict = analysis.estimate, analysis.verdict
    lines = [f"**{analysis.frame.name}** ({analysis.obj.name})"]
    if estimate.found:
        lines.append(f"found, confidence **{estimate.confidence:.2f}**")
    else:
        lines.append(f"**no answer**: {estimate.reason}")
    if verdict is not None and verdict.adi is not None:
        lines[-1] += f", off by **{1000 * verdict.adi:.1f} mm** (ADI)"
    if verdict is not None and verdict.visible_share is not None:
        lines[-1] += f"; {verdict.visible_share:.0%} of the object visible"
    if verdict is not None and verdict.lost_at is not None:
        lines.append(f"lost at: **{verdict.lost_at}**")
    if analysis.frame.remark:
        lines.append(f"⚠ {analysis.frame.remark}")
    return "  \n".join(lines)
