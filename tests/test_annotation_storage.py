"""Saved sessions come back as they were; what goes wrong is said, and costs nothing."""

import errno
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from label_strategies import IMAGES, Action, actions, play

from inhand.annotation.session import Label, Session
from inhand.annotation.storage import (
    SESSION_FILE,
    check_folder,
    load_session,
    locked,
    parse_session,
    save_session,
)
from inhand.errors import InputError

LABEL = Label("can", np.eye(4), np.eye(4), {"bend": 0.5})


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "out" / SESSION_FILE


@given(actions())
def test_a_session_comes_back_equal(todo: list[Action]) -> None:
    session = play(Session(IMAGES), todo)
    with TemporaryDirectory() as folder:
        path = Path(folder) / SESSION_FILE
        save_session(path, session)
        loaded, remark = load_session(path, IMAGES)
        assert os.listdir(folder) == [SESSION_FILE]
    assert loaded == session
    assert remark == ""


def test_a_session_that_was_never_saved_is_new(path: Path) -> None:
    assert load_session(path, IMAGES) == (Session(IMAGES), "")


def test_labels_survive_other_images(path: Path) -> None:
    session = Session(("a", "b", "c")).go_to(2).change(LABEL, "object moved").go_to(1)
    session = session.change(LABEL, "object moved")
    save_session(path, session)
    loaded, remark = load_session(path, ("b", "d"))
    assert (loaded.images, loaded.image) == (("b", "d"), "b")
    assert dict(loaded.labels) == dict(session.labels)
    assert "1 are new, 1 labels" in remark
    save_session(path, loaded)
    assert dict(load_session(path, ("a", "b", "c"))[0].labels) == dict(session.labels)


def cut_short(text: str) -> str:
    return text[: len(text) // 2]


def edited(change: Callable[[dict[str, Any]], Any]) -> Callable[[str], str]:
    def edit(text: str) -> str:
        fields = json.loads(text)
        change(fields)
        return json.dumps(fields)

    return edit


BROKEN: dict[str, Callable[[str], str]] = {
    "empty": lambda _: "",
    "cut short": cut_short,
    "another file": lambda _: '{"fx": 600}',
    "a list": lambda _: "[1, 2]",
    "deep": lambda _: "[" * 100_000,
    "another format": edited(lambda f: f.update(format="inhand annotation 9")),
    "mirrored": edited(lambda f: f["labels"]["first"]["T_camera_object"][0].__setitem__(0, -1)),
    "not finite": edited(lambda f: f["labels"]["first"]["joints"].update(bend=float("nan"))),
    "joint is text": edited(lambda f: f["labels"]["first"]["joints"].update(bend="0.5")),
    "status": edited(lambda f: f["labels"]["first"].update(status="perhaps")),
    "unknown image": edited(lambda f: f.update(image="no such")),
    "history of another": edited(lambda f: f["past"][0].update(image="no such")),
    "no images": edited(lambda f: f.update(images=[])),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_file_is_set_aside(what: str, path: Path) -> None:
    save_session(path, Session(IMAGES).go_to(1).change(LABEL, "object moved"))
    text = BROKEN[what](path.read_text())
    for number in (1, 2):  # a second broken file does not replace the first one
        path.write_text(text)
        session, remark = load_session(path, IMAGES)
        assert session == Session(IMAGES)
        aside = path.with_name(f"annotation.broken-{number}.json")
        assert aside.name in remark
        assert "broken" in remark
        assert aside.read_text() == text
        assert not path.exists()


@given(st.binary(max_size=200))
def test_no_content_is_a_traceback(data: bytes) -> None:
    with pytest.raises(InputError):
        parse_session(data)


def test_a_full_disk_leaves_the_last_save(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = Session(IMAGES).change(LABEL, "object moved")
    save_session(path, first)

    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match=r"cannot write .*annotation.json: No space left"):
        save_session(path, first.undo())
    assert os.listdir(path.parent) == [SESSION_FILE]
    monkeypatch.undo()
    assert load_session(path, IMAGES)[0] == first


SAVER = """
import sys
from pathlib import Path
import numpy as np
from inhand.annotation.session import Label, Session
from inhand.annotation.storage import save_session
session = Session(("a", "b"))
for number in range(1, 100_000):
    session = session.change(Label("can", np.eye(4), np.eye(4), {"bend": number}), "finger moved")
    save_session(Path(sys.argv[1]), session)
    print(number, flush=True)
"""


@pytest.mark.parametrize("changes", [1, 20, 57])
def test_a_killed_process_leaves_a_whole_file(path: Path, changes: int) -> None:
    """Nothing that was said to be saved is lost."""
    command = [sys.executable, "-c", SAVER, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        said = [int(process.stdout.readline()) for _ in range(changes)]
        process.send_signal(signal.SIGKILL)
        said += [int(line) for line in process.stdout.read().splitlines()]
    session, remark = load_session(path, ("a", "b"))
    assert remark == ""
    assert session.label is not None
    assert session.label.joint_positions["bend"] >= said[-1]


def test_only_one_process_labels_into_a_folder(path: Path) -> None:
    here = path.parent
    with locked(here), pytest.raises(InputError, match="another process"), locked(here):
        pass
    with locked(here):
        check_folder(here)


def test_a_folder_that_cannot_be_made_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write"):
        save_session(tmp_path / "file" / SESSION_FILE, Session(IMAGES))
    for use in (check_folder, lambda folder: locked(folder).__enter__()):
        with pytest.raises(InputError, match="cannot"):
            use(tmp_path / "file")


def test_a_file_that_cannot_be_read_is_an_error(path: Path) -> None:
    path.mkdir(parents=True)
    with pytest.raises(InputError, match="cannot read"):
        load_session(path, IMAGES)
