"""The session on disk: saved after every change, so that nothing is lost, and read back.

One JSON file. It is written anew beside the old one, forced onto the disk and then renamed, so that
a process or machine that stops at any moment leaves a whole file: the old one or the new one.
"""

import json
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from inhand.annotation.session import STATUSES, Change, Label, Session
from inhand.checks import finite_number
from inhand.errors import InputError
from inhand.geometry.se3 import check_rigid
from inhand.hand import Hand
from inhand.whole_file import write_whole

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

FORMAT = "inhand annotation 1"
"""What the file says it is."""
SESSION_FILE = "annotation.json"
"""Name of the file in the output folder."""
LOCK_FILE = ".annotation.lock"


def check_folder(folder: Path) -> None:
    """Raise InputError when a folder cannot hold labels, or holds something else."""
    try:
        names = [path.name for path in folder.iterdir() if not path.name.startswith(".")]
    except FileNotFoundError:
        return
    except OSError as error:
        raise InputError(f"cannot use the folder {folder}: {error.strerror or error}") from error
    if names and not any(name.startswith("annotation.") for name in names):
        raise InputError(
            f"{folder} is not empty and holds no {SESSION_FILE}: choose another folder"
        )


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other processes from labelling into a folder, until this one is done or dead.

    Two that save to one file would lose each other's labels. Systems without `fcntl` (Windows) do
    without.

    Raises:
        InputError: another process does that, or the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = (folder / LOCK_FILE).open("a")
    except OSError as error:
        raise InputError(f"cannot write to {folder}: {error.strerror or error}") from error
    with file:
        if fcntl is not None:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise InputError(
                    f"another process is labelling into {folder}: stop that, or open its page"
                ) from error
        yield


def save_session(path: Path, session: Session) -> None:
    """Save a session; the file is there completely or as it was.

    Raises:
        InputError: it cannot be written, such as when the disk is full.
    """
    fields = {
        "format": FORMAT,
        "image": session.image,
        "images": session.images,
        "labels": {name: _label_fields(label) for name, label in session.labels.items()},
        "past": [_change_fields(change) for change in session.past],
        "future": [_change_fields(change) for change in session.future],
    }
    write_whole(path, json.dumps(fields), durable=True)


def load_session(path: Path, images: Sequence[str]) -> tuple[Session, str]:
    """The session saved at `path`, for the images that are there now, and a remark for the user.

    Labels of images that are gone stay; the history starts anew when the images are others. A file
    that is broken is set aside under another name, and the session starts anew.

    Raises:
        InputError: the file, or its folder, cannot be read or written.
    """
    names = tuple(images)
    if not path.exists():
        return Session(names), ""
    try:
        text = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    try:
        saved = parse_session(text)
    except InputError as error:
        aside = _set_aside(path)
        return Session(names), f"{path.name} is broken ({error}). It is kept as {aside.name}."
    if saved.images == names:
        return saved, ""
    position = names.index(saved.image) if saved.image in names else 0
    return Session(names, saved.labels, position), _difference(saved, names)


def check_fits(session: Session, hand: Hand, objects: Collection[str], path: Path) -> None:
    """Raise InputError when labels are of another hand, or of objects that are not among these.

    Args:
        session: the labels.
        hand: the hand.
        objects: names of the objects.
        path: where the labels were saved.
    """
    for image, label in session.labels.items():
        if label.object_name not in objects:
            raise InputError(
                f'the label of {image} in {path} is of the object "{label.object_name}", which is '
                f"not among {', '.join(objects)}: name its mesh too"
            )
        try:
            hand.joint_vector(label.joint_positions)
        except InputError as error:
            raise InputError(f"the labels in {path} are of another hand: {error}") from error


def parse_session(text: bytes) -> Session:
    """The session in a saved file's content.

    Raises:
        InputError: it is no saved session, or holds impossible values.
    """
    try:
        fields = json.loads(text)
        if fields["format"] != FORMAT:
            raise InputError(f'its format is {fields["format"]!r:.40}, expected "{FORMAT}"')
        images = tuple(map(str, fields["images"]))
        return Session(
            images,
            MappingProxyType({n: parse_label(entry) for n, entry in fields["labels"].items()}),
            images.index(fields["image"]),
            tuple(_parse_change(change, images) for change in fields["past"]),
            tuple(_parse_change(change, images) for change in fields["future"]),
        )
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"not a whole saved session: {error!r:.120}") from error


def parse_label(fields: Mapping[str, Any]) -> Label:
    """A label from its JSON fields.

    Raises:
        InputError, KeyError, TypeError, ValueError, AttributeError: they are no label.
    """
    if fields["status"] not in STATUSES:
        raise InputError(f"a label's status is {fields['status']!r:.40}")
    return Label(
        object_name=str(fields["object"]),
        T_camera_object=_pose(fields["T_camera_object"], "T_camera_object"),
        T_camera_hand=_pose(fields["T_camera_hand"], "T_camera_hand"),
        joint_positions={
            str(name): finite_number(q, f"joint {name}") for name, q in fields["joints"].items()
        },
        status=fields["status"],
    )


def _label_fields(label: Label) -> dict[str, Any]:
    return {
        "status": label.status,
        "object": label.object_name,
        "T_camera_object": label.T_camera_object.tolist(),
        "T_camera_hand": label.T_camera_hand.tolist(),
        "joints": dict(label.joint_positions),
    }


def _pose(rows: Any, name: str) -> Any:
    """The numbers as they were saved, once they are found to be a pose."""
    T = np.array(rows, dtype=np.float64)
    check_rigid(T, name)
    return T


def _change_fields(change: Change) -> dict[str, Any]:
    return {
        "image": change.image,
        "what": change.what,
        "before": None if change.before is None else _label_fields(change.before),
        "after": None if change.after is None else _label_fields(change.after),
    }


def _parse_change(fields: Mapping[str, Any], images: Sequence[str]) -> Change:
    if fields["image"] not in images:
        raise InputError(f"its history speaks of the unknown image {fields['image']!r:.40}")
    before, after = (
        None if fields[key] is None else parse_label(fields[key]) for key in ("before", "after")
    )
    return Change(str(fields["image"]), str(fields["what"]), before, after)


def _difference(saved: Session, names: tuple[str, ...]) -> str:
    new = len(set(names) - set(saved.images))
    kept = sorted(set(saved.labels) - set(names))
    remark = f"The images are not those of the last time: {new} are new, {len(kept)} labels belong "
    return remark + "to images that are not here (they are kept). Undo starts anew."


def _set_aside(path: Path) -> Path:
    """Rename a broken file to a name that is free, and return that.

    Raises:
        InputError: it cannot be renamed.
    """
    number = 1
    while (aside := path.with_name(f"{path.stem}.broken-{number}{path.suffix}")).exists():
        number += 1
    try:
        os.replace(path, aside)
    except OSError as error:
        raise InputError(
            f"{path} is broken and cannot be renamed: {error.strerror or error}"
        ) from error
    return aside
