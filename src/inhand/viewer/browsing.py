"""Going through many frames: next, previous, and only those of a kind."""

from contextlib import suppress

from inhand.errors import InputError
from inhand.viewer.controls import on_user
from inhand.viewer.filters import KINDS, Filter
from inhand.viewer.page import Page
from inhand.viewer.session import Session

ALL = "all"


class Browsing:
    """The controls that go through the frames of a session.

    Args:
        page: shows the frame that is chosen.
        session: the frames.
    """

    def __init__(self, page: Page, session: Session) -> None:
        self._page, self._session = page, session
        self._listed = session.matching(Filter())
        self._estimating = False
        gui = page.server.gui
        with gui.add_folder("Frames", order=-1, visible=len(session) > 1):
            self._number = gui.add_slider(
                "Frame", min=1, max=max(len(session), 1), step=1, initial_value=1
            )
            self._step = gui.add_button_group("Go to", ("previous", "next"))
            self._kind = gui.add_dropdown("Only", KINDS, initial_value=KINDS[0])
            self._limit = gui.add_slider(
                "Confidence below", min=0.0, max=1.0, step=0.05, initial_value=0.5, visible=False
            )
            objects = sorted({name for name in session.source.object_names if name})
            self._object = gui.add_dropdown("Object", (ALL, *objects), initial_value=ALL)
            self._object.visible = len(objects) > 1
            self._found = gui.add_markdown("")
            self._estimate_all = gui.add_button("Estimate all frames")
        on_user(self._number, self._show)
        for handle in (self._kind, self._limit, self._object):
            on_user(handle, self._filter)
        self._step.on_click(lambda _: self.turn(1 if self._step.value == "next" else -1))
        self._estimate_all.on_click(lambda _: self._toggle_estimating())
        for key, step, name in (("N", 1, "Next frame"), ("P", -1, "Previous frame")):
            command = gui.add_command(name, hotkey=key)
            command.on_trigger(lambda _, step=step: self.turn(step))
        self._tell_found()

    def start(self) -> None:
        """Show the first frame."""
        self._show()

    def turn(self, step: int) -> None:
        """Go on by some frames, among those that are listed."""
        self._number.value = min(max(self._number.value + step, 1), max(len(self._listed), 1))
        self._show()

    @property
    def _index(self) -> int | None:
        """The chosen frame; None where the filter keeps none."""
        position = int(self._number.value) - 1
        return self._listed[position] if position < len(self._listed) else None

    def _show(self) -> None:
        index = self._index
        if index is not None:
            self._page.worker.submit("frame", lambda: self._show_frame(index))

    def _show_frame(self, index: int) -> None:
        try:
            analysis = self._session.analysis(index)
        except InputError as error:
            self._page.clear()  # what is left of another frame would pass for this one
            name = self._session.source.names[index]
            raise InputError(f"{name} cannot be shown: {error}") from error
        self._page.show(analysis)
        self._tell_found()

    def _filter(self) -> None:
        """List the frames that the filter keeps; go to the first, or stay where that is kept."""
        before = self._index
        kind = self._kind.value
        self._limit.visible = kind == "low confidence"
        chosen = None if self._object.value == ALL else self._object.value
        self._listed = self._session.matching(Filter(kind, chosen, self._limit.value))
        self._number.max = max(len(self._listed), 1)
        kept = before in self._listed
        self._number.value = self._listed.index(before) + 1 if kept and before is not None else 1
        self._tell_found()
        if not kept:
            self._show()

    def _tell_found(self) -> None:
        """Say how many frames are listed, and how many are not estimated yet."""
        unknown = sum(outcome is None for outcome in self._session.outcomes)
        text = f"{len(self._listed)} of {len(self._session)} frames"
        if not self._listed:
            text = f"**No frame is like that**, of {len(self._session)}"
        if unknown:
            text += f"; {unknown} not estimated yet"
            text += "" if self._kind.value == "all" else ", so not listed"
        self._found.content = text
        self._estimate_all.visible = unknown > 0
        self._estimate_all.label = "Stop" if self._estimating else "Estimate all frames"

    def _toggle_estimating(self) -> None:
        self._estimating = not self._estimating
        self._tell_found()
        if self._estimating:
            self._page.worker.submit("estimate", self._estimate_next)

    def _estimate_next(self) -> None:
        """Estimate one frame, then let the worker do what else there is before the next."""
        index = self._session.first_unknown()
        if index is None or not self._estimating:
            self._estimating = False
            self._filter()
            return
        with suppress(InputError):  # it counts as not found, and says why when it is looked at
            self._session.analysis(index)
        self._tell_found()
        self._page.worker.submit("estimate", self._estimate_next)
