"""What a labelling session holds: labels, where the user is, and the way there, for undo and redo.

Plain data. A session is never changed: every action makes a new one.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from inhand.errors import InputError

Array = NDArray[np.float64]
Status = Literal["open", "labelled", "skipped"]
STATUSES: tuple[Status, ...] = get_args(Status)
HISTORY = 200
"""Changes that can be undone at most; those before are forgotten."""


@dataclass(frozen=True, eq=False)
class Label:
    """Where the hand and the object are in an image."""

    object_name: str
    """Name of the object in the hand."""
    T_camera_object: Array
    """Its pose, shape (4, 4)."""
    T_camera_hand: Array
    """Pose of the hand's root link, shape (4, 4)."""
    joint_positions: Mapping[str, float]
    """Positions of the independent joints [rad, m] by name."""
    status: Status = "open"
    """`labelled`: finished; `skipped`: cannot be labelled; `open`: neither."""

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Label)
            and self.object_name == other.object_name
            and self.status == other.status
            and dict(self.joint_positions) == dict(other.joint_positions)
            and np.array_equal(self.T_camera_object, other.T_camera_object)
            and np.array_equal(self.T_camera_hand, other.T_camera_hand)
        )


@dataclass(frozen=True)
class Change:
    """One step of the history."""

    image: str
    """Name of the image whose label changed."""
    what: str
    """What the user did, such as "object moved"."""
    before: Label | None
    """The label before; None if there was none."""
    after: Label | None
    """The label afterwards."""


@dataclass(frozen=True)
class Session:
    """The labels of a list of images, and how they came about.

    Raises:
        InputError: there are no images.
    """

    images: tuple[str, ...]
    """Names of the images, in order."""
    labels: Mapping[str, Label] = field(default_factory=lambda: MappingProxyType({}))
    """Labels by the image's name. Those of images that are not there now stay."""
    position: int = 0
    """Index of the image that is looked at."""
    past: tuple[Change, ...] = ()
    """Changes that can be undone, oldest first."""
    future: tuple[Change, ...] = ()
    """Changes that can be made again, the next one last."""

    def __post_init__(self) -> None:
        if not self.images:
            raise InputError("a session needs at least one image")

    @property
    def image(self) -> str:
        """Name of the image that is looked at."""
        return self.images[self.position]

    @property
    def label(self) -> Label | None:
        """The label of the image that is looked at; None if it has none yet."""
        return self.labels.get(self.image)

    def status(self, image: str) -> Status:
        """How far an image is."""
        label = self.labels.get(image)
        return "open" if label is None else label.status

    def count(self, status: Status) -> int:
        """How many of the images are so far."""
        return sum(self.status(image) == status for image in self.images)

    def go_to(self, position: int) -> "Session":
        """Look at the image at an index; past either end, at the last one there."""
        return replace(self, position=min(max(position, 0), len(self.images) - 1))

    def go_to_next_open(self) -> "Session":
        """Look at the next image that is open, from the first one after the last; or stay."""
        count = len(self.images)
        for step in range(1, count + 1):
            position = (self.position + step) % count
            if self.status(self.images[position]) == "open":
                return self.go_to(position)
        return self

    def change(self, label: Label, what: str, *, join: bool = False) -> "Session":
        """Give the image that is looked at another label.

        Args:
            label: the label.
            what: what the user did.
            join: make one step of this change and the last one, if that was the same at the same
                image: a slider on its way is one step.
        """
        before, past = self.label, self.past
        if label == before:
            return self
        if (
            join
            and past
            and not self.future
            and (past[-1].image, past[-1].what) == (self.image, what)
        ):
            before, past = past[-1].before, past[:-1]
        change = Change(self.image, what, before, label)
        return replace(
            self,
            labels=_with(self.labels, self.image, label),
            past=(*past, change)[-HISTORY:],
            future=(),
        )

    def undo(self) -> "Session":
        """Take the last change back, and look at its image."""
        if not self.past:
            return self
        *past, change = self.past
        return self._after(change, change.before, tuple(past), (*self.future, change))

    def redo(self) -> "Session":
        """Make the change again that was taken back last, and look at its image."""
        if not self.future:
            return self
        *future, change = self.future
        return self._after(change, change.after, (*self.past, change), tuple(future))

    def _after(
        self,
        change: Change,
        label: Label | None,
        past: tuple[Change, ...],
        future: tuple[Change, ...],
    ) -> "Session":
        labels = _with(self.labels, change.image, label)
        position = self.images.index(change.image)
        return Session(self.images, labels, position, past, future)


def _with(labels: Mapping[str, Label], image: str, label: Label | None) -> Mapping[str, Label]:
    """The labels with one of them replaced, or taken away."""
    others = {name: entry for name, entry in labels.items() if name != image}
    return MappingProxyType(others if label is None else {**others, image: label})
