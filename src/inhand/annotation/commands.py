"""What can be done with a button or a key; the page and its table of keys are made from this.

The 3D view keeps the keys W, A, S, D, Q, E and the arrows for itself: they move the view.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from inhand.annotation.session import Array
from inhand.annotation.workbench import Workbench

Modifier = Literal["cmd/ctrl", "shift", "cmd/ctrl+shift"]


@dataclass(frozen=True)
class Key:
    """A key with what is held beside it."""

    key: str
    """As viser calls it, such as "F"."""
    modifier: Modifier | None = None

    def __str__(self) -> str:
        words = {None: "", "cmd/ctrl": "Ctrl+", "shift": "Shift+", "cmd/ctrl+shift": "Ctrl+Shift+"}
        return words[self.modifier] + self.key


@dataclass(frozen=True)
class Command:
    """Something to be done with the image that is looked at, or with the session."""

    group: str
    """The row of buttons it belongs to."""
    name: str
    """Text of its button."""
    keys: tuple[Key, ...]
    act: Callable[[Workbench], None]
    meaning: str
    """What it does."""


@dataclass(frozen=True)
class Nudge:
    """A small step of the object, by a key."""

    key: Key
    axis: Array
    """Unit vector along a camera axis, shape (3,)."""
    turns: bool
    """Whether the object is turned about the axis, or moved along it."""
    meaning: str

    def act(self, bench: Workbench, millimetres: float, degrees: float) -> None:
        """Take a step of this size."""
        nothing = np.zeros(3)
        if self.turns:
            bench.nudge_object(np.radians(degrees) * self.axis, nothing, "object turned")
        else:
            bench.nudge_object(nothing, millimetres / 1000 * self.axis, "object moved")


COMMANDS = (
    Command("Image", "Previous", (Key("B"),), lambda b: b.go(-1), "the image before"),
    Command("Image", "Next", (Key("N"),), lambda b: b.go(1), "the next image"),
    Command("Image", "Next open", (Key("M"),), Workbench.go_to_next_open, "the next one to do"),
    Command("Mark", "Labelled", (Key("Y"),), lambda b: b.mark("labelled"), "finished; go on"),
    Command("Mark", "Skip", (Key("X"),), lambda b: b.mark("skipped"), "cannot be labelled; go on"),
    Command("Mark", "Reopen", (Key("R"),), lambda b: b.mark("open"), "neither of both"),
    Command("Change", "Undo", (Key("Z"), Key("Z", "cmd/ctrl")), Workbench.undo, "take it back"),
    Command(
        "Change",
        "Redo",
        (Key("Z", "shift"), Key("Z", "cmd/ctrl+shift")),
        Workbench.redo,
        "make it again",
    ),
    Command("Estimator", "Propose", (Key("P"),), Workbench.propose, "its best answer"),
    Command("Estimator", "Another", (Key("C"),), Workbench.take_next_proposal, "its next answer"),
    Command("Snap", "Both", (Key("F"),), Workbench.snap, "hand, then object"),
    Command("Snap", "Object", (Key("G"),), Workbench.snap_object, "the object alone"),
    Command("Snap", "Hand", (Key("H"),), Workbench.snap_hand, "wrist and fingers alone"),
)

_X, _Y, _Z = np.eye(3)
NUDGES = (
    Nudge(Key("J"), -_X, False, "object left"),
    Nudge(Key("L"), _X, False, "object right"),
    Nudge(Key("I"), -_Y, False, "object up"),
    Nudge(Key("K"), _Y, False, "object down"),
    Nudge(Key("U"), -_Z, False, "object nearer"),
    Nudge(Key("O"), _Z, False, "object farther"),
    Nudge(Key("J", "shift"), _Y, True, "turn its front to the left"),
    Nudge(Key("L", "shift"), -_Y, True, "turn its front to the right"),
    Nudge(Key("I", "shift"), -_X, True, "turn its front up"),
    Nudge(Key("K", "shift"), _X, True, "turn its front down"),
    Nudge(Key("U", "shift"), -_Z, True, "turn it against the clock"),
    Nudge(Key("O", "shift"), _Z, True, "turn it with the clock"),
)


def groups() -> dict[str, list[Command]]:
    """The commands by their row of buttons, in order."""
    rows: dict[str, list[Command]] = {}
    for command in COMMANDS:
        rows.setdefault(command.group, []).append(command)
    return rows


def keys_table() -> str:
    """All keys and what they do, as a table in Markdown."""
    lines = ["| key | |", "|---|---|"]
    for command in COMMANDS:
        keys = ", ".join(map(str, command.keys))
        lines.append(f"| {keys} | **{command.name}**: {command.meaning} |")
    lines += [f"| {nudge.key} | {nudge.meaning} |" for nudge in NUDGES]
    return "\n".join(lines)
