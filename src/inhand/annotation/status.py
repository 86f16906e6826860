"""What the labelling page says about the image, the progress, and whether all is saved."""

from collections.abc import Callable
from typing import Any

import numpy as np

from inhand.annotation.workbench import Workbench
from inhand.viewer.silhouettes import Residuals


class ImageStatus:
    """Which image is looked at, how far it is, and how far all are.

    Args:
        gui: `server.gui` of viser.
    """

    def __init__(self, gui: Any) -> None:
        self._text = gui.add_markdown("")
        self._progress = gui.add_progress_bar(0.0, color="teal")

    def show(self, bench: Workbench) -> None:
        """Show how far a session is."""
        session = bench.session
        total, labelled, skipped = (
            len(session.images),
            session.count("labelled"),
            session.count("skipped"),
        )
        self._text.content = (
            f"**{session.image}** (image {session.position + 1} of {total}): "
            f"**{session.status(session.image)}**  \n"
            f"**{labelled} of {total} labelled**" + (f", {skipped} skipped" if skipped else "")
        )
        self._progress.value = 100.0 * (labelled + skipped) / total


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
        apart = bench.difference_from(best)
        lines.append(
            f"- **estimator** (confidence {bench.proposals.confidence:.2f}): its best answer is "
            f"{1000 * apart.translation:.1f} mm and {np.degrees(apart.rotation):.1f}° away, up to "
            "the object's symmetry"
        )
    return "\n".join(lines)
