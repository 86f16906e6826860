"""The labelling session: undo and redo, navigation, progress."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from label_strategies import IMAGES, Action, actions, labels, play

from inhand.annotation.session import HISTORY, Label, Session
from inhand.errors import InputError

LABEL = Label("can", np.eye(4), np.eye(4), {"bend": 0.5})


def moved(metres: float, status: str = "open") -> Label:
    T = np.eye(4)
    T[0, 3] = metres
    return replace(LABEL, T_camera_object=T, status=status)  # type: ignore[arg-type]


@given(actions())
def test_everything_undone_is_the_first_state(todo: list[Action]) -> None:
    session = play(Session(IMAGES), todo)
    while session.past:
        session = session.undo()
    assert dict(session.labels) == {}


@given(actions(), st.integers(1, 30))
def test_redo_takes_undo_back(todo: list[Action], steps: int) -> None:
    session = back = play(Session(IMAGES), todo)
    steps = min(steps, len(session.past))
    for _ in range(steps):
        back = back.undo()
    for _ in range(steps):
        back = back.redo()
    assert dict(back.labels) == dict(session.labels)
    assert (back.past, back.future) == (session.past, session.future)


@given(actions(), labels())
def test_a_change_is_seen_and_ends_what_could_be_redone(todo: list[Action], label: Label) -> None:
    session = play(Session(IMAGES), todo)
    before = session.labels
    after = session.change(label, "object moved")
    assert after.label == label
    assert not after.future or session.label == label
    assert session.labels is before
    others = [image for image in IMAGES if image != session.image]
    assert [after.labels.get(i) for i in others] == [before.get(i) for i in others]


@given(actions())
def test_every_image_has_one_status(todo: list[Action]) -> None:
    session = play(Session(IMAGES), todo)
    counts = [session.count("labelled"), session.count("skipped"), session.count("open")]
    assert sum(counts) == len(IMAGES)
    assert 0 <= session.position < len(IMAGES)
    found = session.go_to_next_open()
    assert (found.status(found.image) == "open") == (session.count("open") > 0)


def test_a_slider_on_its_way_is_one_step() -> None:
    session = Session(IMAGES).change(moved(1), "object moved")
    for i in range(5):
        session = session.change(moved(2 + i), "finger bent", join=True)
    assert [change.what for change in session.past] == ["object moved", "finger bent"]
    assert session.undo().label == moved(1)
    assert session.undo().redo().label == moved(6)


def test_other_controls_other_images_and_undone_steps_are_not_joined() -> None:
    session = Session(IMAGES).change(moved(1), "a", join=True).change(moved(2), "b", join=True)
    assert len(session.past) == 2
    session = session.go_to(1).change(moved(3), "b", join=True)
    assert len(session.past) == 3
    session = session.change(moved(4), "c").undo().change(moved(5), "b", join=True)
    assert len(session.past) == 4


def test_the_same_label_again_is_no_step() -> None:
    session = Session(IMAGES).change(moved(1), "object moved")
    assert session.change(moved(1), "object moved") is session


def test_undo_goes_to_the_image_it_changes() -> None:
    session = Session(IMAGES).change(moved(1), "object moved").go_to(2)
    assert session.undo().position == 0
    assert session.undo().go_to(1).redo().position == 0


def test_the_history_is_bounded_and_keeps_the_latest() -> None:
    session = Session(IMAGES)
    for i in range(HISTORY + 10):
        session = session.change(moved(1 + i), "object moved")
    assert len(session.past) == HISTORY
    while session.past:
        session = session.undo()
    assert session.label == moved(10)


def test_next_open_image_skips_what_is_finished_and_begins_again() -> None:
    session = Session(IMAGES).change(moved(1, "labelled"), "labelled").go_to_next_open()
    assert session.position == 1
    session = session.change(moved(1, "skipped"), "skipped").go_to_next_open()
    assert session.position == 2
    assert session.go_to_next_open().position == 2
    session = session.change(moved(1, "labelled"), "labelled").go_to_next_open()
    assert session.position == 2
    assert (session.count("labelled"), session.count("skipped")) == (2, 1)


def test_a_session_needs_images() -> None:
    with pytest.raises(InputError, match="at least one image"):
        Session(())
