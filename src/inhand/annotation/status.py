"""What the labelling page says about the image, the progress, and whether all is saved."""

from collections.abc import Callable
from typing import Any

import numpy as np

from inhand.annotation.controls import on_user, set_value
from inhand.annotation.workbench import Workbench
from inhand.viewer.silhouettes import Residuals


class ImageStatus:
    """Which image is looked at, how far it is, and how far all are.

    Args:
        gui: `server.gui` of viser.
        images: number of images.
        go: called with the index of the image that the user wants.
    """

    def __init__(self, gui: Any, images: int, go: Callable[[int], None]) -> None:
        self._text = gui.add_markdown("")
        self._progress = gui.add_progress_bar(0.0, color="teal")
        self._number = gui.add_number(
            f"Image (of {images})", 1, min=1, max=images, step=1, visible=images > 1
        )
        on_user(self._number, lambda: go(int(self._number.value) - 1))

    def show(self, bench: Workbench) -> None:
        """Show how far a session is."""
        session = bench.session
        total, labelled = len(session.images), session.count("labelled")
        skipped = session.count("skipped")
        text = f"**{session.image}**: **{session.status(session.image)}**  \n"
        text += f"**{labelled} of {total} labelled**" + (f", {skipped} skipped" if skipped else "")
        if labelled + skipped == total:
            text += "  \nNone is left: write the data set."
        self._text.content = text
        self._progress.value = 100.0 * (labelled + skipped) / total
        set_value(self._number, session.position + 1)


class SaveStatus:
    """Whether the labels are saved, and a button for when they are not.

    Args:
        gui: `server.gui` of viser.
        save: called when the user wants them saved again.
    """

    def __init__(self, gui: Any, save: Callable[[], object]) -> None:
        self._text = gui.add_markdown("")
        self._button = gui.add_button("Save again", color="red", visible=False)
        self._button.on_click(lambda _: save())

    def show(self, bench: Workbench) -> None:
        """Show why the labels are not saved, or that they are, and what the last change was."""
        problem, past = bench.save_problem, bench.session.past
        if problem:
            self._text.content = (
                f"**NOT SAVED**: {problem}. Your labels are kept in memory: do not stop the "
                "program; make room, then save again."
            )
        else:
            last = f" Last: {past[-1].what}." if past else ""
            self._text.content = f"All changes are saved.{last}"
        self._button.visible = bool(problem)


def describe(bench: Workbench, residuals: Residuals) -> str:
    """How well the label agrees with the image, and with the estimator, in Markdown."""
    lines = [residuals.summary()]
    if bench.proposals is not None:
        best = bench.proposals.labels[0]
        apart = bench.tools.difference(bench.label, best)
        lines.append(
            f"- **estimator** (confidence {bench.proposals.confidence:.2f}): its best answer is "
            f"{1000 * apart.translation:.1f} mm and {np.degrees(apart.rotation):.1f}° away, up to "
            "the object's symmetry"
        )
    return "\n".join(lines)
