"""What the user of the labelling page can do, without the page.

Every change of a label is saved at once. When that fails, the label stays in memory, the workbench
says why, and saves again with the next change or when it is told to.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inhand.annotation.ground_truth import LabelledHand, write_ground_truth
from inhand.annotation.images import ImageFile, RawImage
from inhand.annotation.moves import centred_at, exchanged, nudged, placed, turned_to
from inhand.annotation.objects import ObjectSource
from inhand.annotation.session import Label, Session, Status
from inhand.annotation.start import last_labelled, start_label
from inhand.annotation.storage import (
    SESSION_FILE,
    check_fits,
    check_folder,
    load_session,
    save_session,
)
from inhand.annotation.tools import Proposals, Tools
from inhand.config import EstimatorConfig
from inhand.errors import InputError
from inhand.object_model import ObjectModel

Array = NDArray[np.float64]


PAUSE = 1.0
"""A control that rests for longer [s] begins another step of the history."""


class Workbench:
    """A labelling session with its images and tools.

    Args:
        files: the images.
        hand: the hand.
        objects: the objects that may be in it, by name.
        folder: folder of the labels and of the data set that is made of them.
        config: the estimator's parameters.
        device: Warp device name.
        clock: tells the time [s].

    Raises:
        InputError: the folder holds something else, or cannot be written, or its labels are of
            another hand or of objects that are not among these.
    """

    def __init__(
        self,
        files: Sequence[ImageFile],
        hand: LabelledHand,
        objects: Mapping[str, ObjectSource],
        folder: Path,
        config: EstimatorConfig | None = None,
        device: str = "cpu",
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.files, self.hand, self.objects, self.folder = tuple(files), hand, objects, folder
        self._config = EstimatorConfig() if config is None else config
        self._device = device
        self._path = folder / SESSION_FILE
        self._tools: dict[str, Tools] = {}
        self._image: tuple[str, RawImage] | None = None
        self._proposals: Proposals | None = None
        self._taken = 0
        self._clock, self._last_change = clock, -np.inf
        self.save_problem = ""
        """Why the labels are not saved; empty when they are."""
        check_folder(folder)
        self.session, self.remark = load_session(self._path, [file.name for file in files])
        check_fits(self.session, hand.model, objects, self._path)
        save_session(self._path, self.session)

    # What is there

    @property
    def file(self) -> ImageFile:
        """The image that is looked at."""
        return self.files[self.session.position]

    @property
    def raw(self) -> RawImage:
        """The image that is looked at, read.

        Raises:
            InputError: it cannot be read.
        """
        if self._image is None or self._image[0] != self.file.name:
            self._image = (self.file.name, self.file.read())
        return self._image[1]

    @property
    def label(self) -> Label:
        """The label of the image that is looked at, or where its labelling starts.

        Raises:
            InputError: it has none, and the image cannot be read.
        """
        if self.session.label is not None:
            return self.session.label
        before = last_labelled(self.session)
        name = self._expected_object(before)
        return start_label(before, self.raw, self.hand.model, name, self._model)

    @property
    def joint_vector(self) -> Array:
        """The label's joints [rad, m], shape (n,)."""
        return self.hand.model.joint_vector(self.label.joint_positions)

    @property
    def tools(self) -> Tools:
        """The tools for the label's object."""
        return self._tools_for(self.label.object_name)

    @property
    def proposals(self) -> Proposals | None:
        """The estimator's answer to the image that is looked at, if it was asked."""
        found = self._proposals
        return found if found is not None and found.image == self.file.name else None

    # What the user does

    def go_to(self, position: int) -> None:
        """Look at the image at an index."""
        self._commit(self.session.go_to(position))

    def go(self, step: int) -> None:
        """Look at the image so many farther on."""
        self.go_to(self.session.position + step)

    def go_to_next_open(self) -> None:
        """Look at the next image that is neither labelled nor skipped."""
        self._commit(self.session.go_to_next_open())

    def undo(self) -> None:
        """Take the last change back."""
        self._commit(self.session.undo())

    def redo(self) -> None:
        """Make it again."""
        self._commit(self.session.redo())

    def begin_step(self) -> None:
        """Make the next change a step of its own, although the one before is the same."""
        self._last_change = -np.inf

    def place_object(self, T_camera_centre: Array) -> None:
        """Put the object at a pose, (4, 4), with its origin at the object's centre: a drag.

        All of a drag is one step, which begins with `begin_step`.
        """
        self._change(placed(self.tools, self.label, T_camera_centre), "object dragged", np.inf)

    def place_centre(self, centre: Array) -> None:
        """Put the object's centre to a point [m], camera frame, shape (3,), and turn nothing."""
        self._change(centred_at(self.tools, self.label, centre), "object placed", PAUSE)

    def turn_object(self, rotation: Array) -> None:
        """Turn the object's axes against the camera's by a rotation, (3, 3), and move nothing."""
        self._change(turned_to(self.tools, self.label, rotation), "object turned", PAUSE)

    def place_hand(self, T_camera_hand: Array) -> None:
        """Put the hand at a wrist pose, shape (4, 4): a drag, as `place_object`."""
        label = replace(self.label, T_camera_hand=T_camera_hand)
        self._change(label, "hand dragged", np.inf)

    def nudge_object(self, turn: Array, shift: Array, what: str) -> None:
        """Move the object a little.

        Args:
            turn: rotation vector about axes parallel to the camera's through the object's centre
                [rad], shape (3,).
            shift: translation along the camera's axes [m], shape (3,).
            what: what the user did.
        """
        self._change(nudged(self.tools, self.label, turn, shift), what, PAUSE)

    def bend(self, joint: str, position: float) -> None:
        """Put a joint, by its name, to a position [rad, m]."""
        joints = {**self.label.joint_positions, joint: position}
        self._change(replace(self.label, joint_positions=joints), f"{joint} moved", PAUSE)

    def take_object(self, name: str) -> None:
        """Say that another object is in the hand; it takes the place of the one before."""
        self._change(
            exchanged(self.tools, self._tools_for(name), self.label, name), "object chosen"
        )

    def snap_object(self) -> None:
        """Refine the object's pose from where it is.

        Raises:
            NoAnswer: the image shows no object there.
        """
        label = self.tools.snapper.snap_object(self.raw, self.label)
        self._change(label, "object snapped")

    def snap_hand(self) -> None:
        """Refine wrist and fingers from where they are.

        Raises:
            NoAnswer: the image shows no hand there.
        """
        self._change(self.tools.snapper.snap_hand(self.raw, self.label), "hand snapped")

    def snap(self) -> None:
        """Refine the hand, then the object, from where they are.

        Raises:
            NoAnswer: the image does not show them there.
        """
        snapper, raw = self.tools.snapper, self.raw
        self._change(
            snapper.snap_object(raw, snapper.snap_hand(raw, self.label)), "hand and object snapped"
        )

    def propose(self) -> None:
        """Ask the estimator, and take its answer.

        Raises:
            NoAnswer: it has none.
        """
        self._proposals = self.tools.propose(self.file.name, self.raw, self.label)
        self._take(self._proposals, 0)

    def take_next_proposal(self) -> None:
        """Take the estimator's next answer to this image, after the last one the first."""
        if self.proposals is None:
            self.propose()
        else:
            self._take(self.proposals, (self._taken + 1) % len(self.proposals.labels))

    def mark(self, status: Status) -> None:
        """Say how far the image is, and go to the next open one if it is finished."""
        self._change(replace(self.label, status=status), f"marked as {status}")
        if status != "open":
            self.go_to_next_open()

    def save(self) -> None:
        """Save the labels; `save_problem` says if that failed."""
        try:
            save_session(self._path, self.session)
            self.save_problem = ""
        except InputError as error:
            self.save_problem = str(error)

    def write(self, tell: Callable[[int, int], None] = lambda done, total: None) -> int:
        """Write the data set; arguments, result and errors as `write_ground_truth`."""
        used = {
            label.object_name
            for label in self.session.labels.values()
            if label.status == "labelled"
        }
        objects = {name: (self.objects[name].number, self._model(name)) for name in sorted(used)}
        return write_ground_truth(self.folder, self.session, self.files, self.hand, objects, tell)

    # How

    def _take(self, proposals: Proposals, index: int) -> None:
        self._taken = index
        label = replace(proposals.labels[index], status=self.label.status)
        self._change(label, f"proposal {1 + index} taken")

    def _change(self, label: Label, what: str, within: float = 0.0) -> None:
        """Change the label; the same again `within` so many seconds is one step."""
        now, last = self._clock(), self._last_change
        self._last_change = now
        self._commit(self.session.change(label, what, join=now - last < within))

    def _commit(self, session: Session) -> None:
        if session is not self.session or self.save_problem:
            self.session = session
            self.save()

    def _expected_object(self, before: Label | None) -> str:
        """The object that the data set names, or else that of a label before, or the first one."""
        named = self.file.object_name
        if named in self.objects:
            return str(named)
        return before.object_name if before is not None else next(iter(self.objects))

    def _model(self, name: str) -> ObjectModel:
        return self._tools_for(name).obj

    def _tools_for(self, name: str) -> Tools:
        if name not in self._tools:
            obj = self.objects[name].load()
            self._tools[name] = Tools(self.hand.model, obj, self._config, self._device)
        return self._tools[name]
