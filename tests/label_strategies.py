"""Random labels and sessions, for property-based tests."""

import numpy as np
from hypothesis import strategies as st

from inhand.annotation.session import STATUSES, Label, Session
from inhand.geometry.se3 import exp

IMAGES = ("000001/000003", "first", "last")
NUMBERS = st.floats(-3, 3)


@st.composite
def poses(draw: st.DrawFn) -> np.ndarray:
    return exp(np.array(draw(st.lists(NUMBERS, min_size=6, max_size=6))))


def labels() -> st.SearchStrategy[Label]:
    return st.builds(
        Label,
        object_name=st.sampled_from(["can", "bottle"]),
        T_camera_object=poses(),
        T_camera_hand=poses(),
        joint_positions=st.fixed_dictionaries({"bend": NUMBERS, "turn": NUMBERS}),
        status=st.sampled_from(STATUSES),
    )


Action = tuple[str, object]
"""What the user does, with its argument."""


def actions() -> st.SearchStrategy[list[Action]]:
    change = st.tuples(st.sampled_from(["change", "drag"]), labels())
    move = st.tuples(st.just("go"), st.integers(-1, 4))
    others = st.tuples(st.sampled_from(["undo", "redo", "next open"]), st.none())
    return st.lists(st.one_of(change, move, others), max_size=25)


def play(session: Session, todo: list[Action]) -> Session:
    """The session after some actions."""
    for name, argument in todo:
        if isinstance(argument, Label):
            session = session.change(argument, name, join=name == "drag")
        elif isinstance(argument, int):
            session = session.go_to(argument)
        else:
            action = {"undo": Session.undo, "redo": Session.redo}
            session = action.get(name, Session.go_to_next_open)(session)
    return session
