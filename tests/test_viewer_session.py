"""Which frames are shown, and what is known of them."""

import pytest
from viewed_scenes import SceneSource, analyst, demo_analysis, three_scenes, viewed

from inhand.errors import InputError
from inhand.estimate import PoseEstimate
from inhand.evaluation.results import FrameResult
from inhand.viewer.filters import Filter, Kind, Outcome
from inhand.viewer.session import KEPT, Session, estimate_of

RIGHT = Outcome(True, 0.9, 0.001)
WRONG = Outcome(True, 0.8, 0.020)
UNSURE = Outcome(True, 0.2, 0.002)
UNSCORED = Outcome(True, 0.7)
NOTHING = Outcome(False, 0.0)


@pytest.mark.parametrize(
    ("kind", "kept"),
    [
        ("all", [RIGHT, WRONG, UNSURE, UNSCORED, NOTHING, None]),
        ("failed", [WRONG, NOTHING]),
        ("not found", [NOTHING]),
        ("low confidence", [UNSURE, NOTHING]),
    ],
)
def test_filters(kind: Kind, kept: list[Outcome | None]) -> None:
    outcomes = [RIGHT, WRONG, UNSURE, UNSCORED, NOTHING, None]
    assert [o for o in outcomes if Filter(kind).keeps("can", o)] == kept
    assert not any(Filter(kind, "box").keeps("can", o) for o in outcomes)
    assert [o for o in outcomes if Filter(kind, "can").keeps("can", o)] == kept


def test_the_limit_of_confidence() -> None:
    assert Filter("low confidence", confidence=0.75).keeps("can", UNSCORED)
    assert not Filter("low confidence", confidence=0.7).keeps("can", UNSCORED)


@pytest.fixture
def session() -> Session:
    return Session(SceneSource(three_scenes()), analyst())


def test_frames_are_read_when_they_are_looked_at(session: Session) -> None:
    assert isinstance(session.source, SceneSource)
    assert session.source.reads == []
    first = session.analysis(0)
    assert session.source.reads == ["part"]
    assert session.analysis(0) is first
    assert session.outcomes[0] is not None
    assert session.outcomes[0].adi == pytest.approx(
        demo_analysis().adi(first.estimate.T_camera_object)
    )
    assert session.outcomes[1:] == [None, None]
    assert KEPT > 2


def test_outcomes_decide_what_is_listed(session: Session) -> None:
    assert session.matching(Filter()) == [0, 1, 2]
    assert session.matching(Filter("failed")) == []
    assert session.first_unknown() == 0
    session.analysis(0)
    with pytest.raises(InputError, match="cut short"):
        session.analysis(1)
    assert session.first_unknown() == 2
    session.analysis(2)
    assert session.first_unknown() is None
    assert session.matching(Filter("failed")) == [1]
    assert session.matching(Filter("not found")) == [1]
    assert session.matching(Filter("all", "cylinder")) == [1, 2]


def test_a_benchmarks_results_are_known_from_the_start() -> None:
    results = {
        "part": FrameResult("part", "", "answer", confidence=0.9, adi=0.002),
        "cylinder": FrameResult("cylinder", "", "answer", confidence=0.9, adi=0.030),
    }
    session = Session(SceneSource(three_scenes()), analyst(), results)
    assert session.matching(Filter("failed")) == [2]
    # The estimator's own are run again, to see the stages.
    assert len(session.analysis(0).stages) > 1


def test_what_another_method_found_is_shown_as_it_is() -> None:
    right = demo_analysis().estimate
    assert right.T_camera_object is not None
    result = FrameResult(
        "part",
        "",
        "answer",
        method="super4pcs",
        confidence=0.3,
        T_camera_object=right.T_camera_object.tolist(),
    )
    session = Session(SceneSource(three_scenes()), analyst(), {"part": result})
    shown = session.analysis(0)
    assert len(shown.stages) == 1
    assert shown.estimate.confidence == 0.3
    placement = shown.stages[0].placement(0)
    assert placement.T_camera_hand is None
    assert placement.T_camera_object == pytest.approx(right.T_camera_object)


def test_an_estimate_that_was_read_is_shown_as_it_is() -> None:
    known = PoseEstimate(False, "the object is hidden", None, {}, None, 0.0)
    session = Session(SceneSource(three_scenes()), analyst(), {"part": known})
    assert session.analysis(0).estimate is known
    assert session.outcomes[0] == NOTHING


def test_a_result_without_an_answer_is_an_estimate_without_one() -> None:
    estimate = estimate_of(FrameResult("part", "", "no answer", reason="too few points"))
    assert not estimate.found
    assert estimate.reason == "too few points"
    assert estimate.T_camera_object is None


def test_a_frame_without_a_wrist_shows_what_there_is() -> None:
    from dataclasses import replace

    source = SceneSource(three_scenes())
    frame, obj = source.read(0)
    assert frame.labelled is not None
    truth = replace(frame.labelled.truth, wrist=None, joint_positions={})
    bare = replace(viewed(three_scenes()["part"], "x"), T_camera_hand=None)
    bare = replace(bare, labelled=replace(frame.labelled, truth=truth, wrist=None))
    analysis = analyst().analyse(bare, obj)
    assert "wrist pose" in analysis.estimate.reason
    assert analysis.truth is not None
    assert analysis.truth.T_camera_hand is None
    assert analysis.verdict is None
    assert analysis.pictures.silhouettes(analysis.stages[0].placement(0), analysis.truth).any()
