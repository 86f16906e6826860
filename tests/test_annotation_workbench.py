"""What the user can do, without a page: label, undo, save, resume, write the data set."""

import errno
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from labelling_data import hand_files, objects_of, true_label, workbench

from inhand.annotation.angles import rotation_of
from inhand.annotation.commands import NUDGES, Nudge
from inhand.annotation.images import find_images
from inhand.annotation.session import Session
from inhand.annotation.storage import SESSION_FILE, load_session
from inhand.annotation.workbench import Workbench
from inhand.datasets.frames import find_frames, read_frame
from inhand.errors import InputError, NoAnswer
from inhand.geometry.se3 import inverse, transform
from inhand.synth.scene import Scene

X, Y, Z = np.eye(3)
PART, CAN = 3, 5
SCENES = (PART, CAN, CAN)


@pytest.fixture
def bench(tmp_path: Path, scenes: list[Scene]) -> Workbench:
    return workbench(tmp_path, [scenes[i] for i in SCENES])


def saved(bench: Workbench) -> Session:
    return load_session(bench.folder / SESSION_FILE, [f.name for f in bench.files])[0]


def object_error(bench: Workbench, scene: Scene) -> tuple[float, float]:
    """Error of the label's object pose [m, deg], up to symmetries."""
    error = bench.tools.difference(bench.label, true_label(scene))
    return error.translation, float(np.degrees(error.rotation))


def test_the_first_image_starts_between_the_fingers(bench: Workbench, scenes: list[Scene]) -> None:
    label, obj = bench.label, bench.tools.obj
    assert bench.session.label is None
    np.testing.assert_allclose(label.T_camera_hand, scenes[PART].T_camera_hand_given, atol=1e-9)
    centre = transform(label.T_camera_object, obj.centre[None])
    in_hand = transform(inverse(label.T_camera_hand), centre)[0]
    reach, radius = bench.hand.model.reach
    assert np.linalg.norm(in_hand - reach) < radius
    joints = bench.joint_vector
    assert (joints >= bench.hand.model.lower).all()
    assert (joints <= bench.hand.model.upper).all()


def test_the_next_image_starts_from_the_last_label(bench: Workbench, scenes: list[Scene]) -> None:
    truth = true_label(scenes[PART])
    bench.place_object(bench.tools.centred(truth.T_camera_object))
    bench.mark("labelled")
    assert bench.file.name == "b"
    first, second = bench.session.labels["a"], bench.label
    held = [inverse(x.T_camera_hand) @ x.T_camera_object for x in (first, second)]
    np.testing.assert_allclose(held[1], held[0], atol=1e-9)
    assert second.joint_positions == first.joint_positions
    assert second.object_name == first.object_name
    assert second.status == "open"


def test_without_a_wrist_pose_the_hand_starts_in_the_image(
    tmp_path: Path, scenes: list[Scene]
) -> None:
    bench = workbench(tmp_path, scenes[:1])
    (tmp_path / "images" / "hand_poses.json").unlink()
    bench = workbench(tmp_path, scenes[:1])
    centre, radius = bench.hand.model.reach
    x, y, z = transform(bench.label.T_camera_hand, centre[None])[0]
    assert abs(x) + abs(y) < 1e-9
    readings = scenes[0].depth[scenes[0].depth > 0]
    assert readings.min() < z < readings.max() + radius


def test_from_proposal_to_data_set(bench: Workbench, scenes: list[Scene]) -> None:
    for number, name in ((PART, "industrial_part"), (CAN, "can"), (CAN, "can")):
        bench.take_object(name)
        bench.propose()
        bench.snap()
        millimetre, degree = object_error(bench, scenes[number])
        assert millimetre < 0.001
        assert degree < 1
        bench.mark("labelled")
    bench.mark("labelled")
    assert bench.session.count("labelled") == 3
    assert bench.write() == 3
    names = [read_frame(path).object_name for path in find_frames([bench.folder])]
    assert names == ["industrial_part", "can", "can"]


def test_another_proposal_can_be_taken_and_taken_back(bench: Workbench) -> None:
    bench.propose()
    assert bench.proposals is not None
    first, labels = bench.label, bench.proposals.labels
    bench.take_next_proposal()
    assert bench.label == labels[1] != first
    bench.undo()
    assert bench.label == first
    for _ in labels[1:]:
        bench.take_next_proposal()
    assert bench.label == first
    bench.go(1)
    other = bench.label
    bench.take_next_proposal()  # there is none yet: the estimator is asked
    assert bench.label != other


def test_proposals_differ_by_more_than_a_symmetry(bench: Workbench, scenes: list[Scene]) -> None:
    bench.go(1)
    bench.take_object("can")
    bench.propose()
    assert bench.proposals is not None
    labels = bench.proposals.labels
    for i, one in enumerate(labels):
        for other in labels[:i]:
            error = bench.tools.difference(one, other)
            assert error.translation > 1e-4 or error.rotation > 0.01


def test_nudging_turns_about_the_object(bench: Workbench) -> None:
    before = bench.label.T_camera_object
    centre = bench.tools.obj.centre[None]
    bench.nudge_object(np.array([0.0, 0.0, 0.1]), np.zeros(3), "object turned")
    after = bench.label.T_camera_object
    np.testing.assert_allclose(transform(after, centre), transform(before, centre), atol=1e-12)
    cosine = (np.trace(after[:3, :3] @ before[:3, :3].T) - 1) / 2
    assert np.arccos(cosine) == pytest.approx(0.1)
    bench.nudge_object(np.zeros(3), np.array([0.001, 0, 0]), "object moved")
    moved = transform(bench.label.T_camera_object, centre) - transform(before, centre)
    np.testing.assert_allclose(moved, [[0.001, 0, 0]], atol=1e-12)


def test_a_typed_rotation_turns_about_the_object(bench: Workbench) -> None:
    centre = bench.tools.obj.centre[None]
    before = transform(bench.label.T_camera_object, centre)
    rotation = rotation_of(np.array([30.0, -40.0, 50.0]))
    bench.turn_object(rotation)
    T = bench.label.T_camera_object
    np.testing.assert_allclose(T[:3, :3], rotation, atol=1e-12)
    np.testing.assert_allclose(transform(T, centre), before, atol=1e-12)
    bench.undo()
    np.testing.assert_allclose(transform(bench.label.T_camera_object, centre), before, atol=1e-12)
    assert (bench.label.T_camera_object != T).any()


@pytest.mark.parametrize("nudge", NUDGES, ids=lambda nudge: nudge.meaning)
def test_nudges_do_what_they_say(bench: Workbench, nudge: Nudge) -> None:
    """Followed on the point of the object's surface that faces the camera."""
    before, centre = bench.label.T_camera_object, bench.tools.obj.centre[None]
    front = transform(before, centre) - [[0, 0, 0.01]]
    if "clock" in nudge.meaning:
        front = transform(before, centre) - [[0, 0.01, 0]]  # twelve o'clock
    in_object = transform(inverse(before), front)
    nudge.act(bench, 1.0, 1.0)
    moved = (transform(bench.label.T_camera_object, in_object) - front)[0]
    ways = {"left": -X, "right": X, "up": -Y, "down": Y, "nearer": -Z, "farther": Z}
    ways |= {"turn it with the clock": X, "turn it against the clock": -X}
    way = next(way for word, way in ways.items() if nudge.meaning.endswith(word))
    length = 0.01 * np.radians(1) if nudge.turns else 0.001
    assert moved @ way == pytest.approx(length, rel=1e-3)
    assert np.linalg.norm(moved) == pytest.approx(length, rel=1e-3)


def test_a_control_at_rest_begins_another_step(tmp_path: Path, scenes: list[Scene]) -> None:
    now = [0.0]
    bench = workbench(tmp_path, scenes[:1], clock=lambda: now[0])
    joint = bench.hand.model.joint_names[0]
    for i in range(10):
        now[0] += 2.0 if i == 5 else 0.1
        bench.bend(joint, 0.1 + 0.01 * i)
    assert len(bench.session.past) == 2
    bench.undo()
    assert bench.label.joint_positions[joint] == pytest.approx(0.14)


def test_another_object_takes_the_place_of_the_one_before(bench: Workbench) -> None:
    before = transform(bench.label.T_camera_object, bench.tools.obj.centre[None])
    bench.take_object("can")
    after = transform(bench.label.T_camera_object, bench.tools.obj.centre[None])
    assert bench.label.object_name == bench.tools.obj.name == "can"
    np.testing.assert_allclose(after, before, atol=1e-12)


def test_every_change_is_saved_at_once(
    bench: Workbench, tmp_path: Path, scenes: list[Scene]
) -> None:
    joint = bench.hand.model.joint_names[0]
    steps: list[Any] = [
        lambda: bench.bend(joint, 0.7),
        lambda: bench.nudge_object(np.zeros(3), np.full(3, 0.01), "object moved"),
        bench.snap_hand,
        bench.undo,
        bench.redo,
        lambda: bench.mark("skipped"),
        lambda: bench.go(1),
        bench.undo,
        bench.go_to_next_open,
        lambda: bench.place_hand(np.eye(4)),
    ]
    for step in steps:
        step()
        assert saved(bench) == bench.session
    again = workbench(tmp_path, [scenes[i] for i in SCENES])
    assert again.session == bench.session
    assert again.remark == ""


def test_a_full_disk_keeps_the_label_until_it_can_be_saved(
    bench: Workbench, monkeypatch: pytest.MonkeyPatch
) -> None:
    joint = bench.hand.model.joint_names[0]
    bench.bend(joint, 0.5)
    before = saved(bench)

    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    bench.bend(joint, 0.8)
    bench.go(1)
    assert "No space left on device" in bench.save_problem
    assert bench.session.labels["a"].joint_positions[joint] == 0.8
    assert saved(bench) == before
    monkeypatch.undo()
    bench.save()
    assert bench.save_problem == ""
    assert saved(bench) == bench.session != before


def test_no_answer_changes_nothing(bench: Workbench) -> None:
    away = bench.label.T_camera_hand.copy()
    away[0, 3] += 2.0
    bench.place_hand(away)
    session = bench.session
    for action in (bench.propose, bench.snap, bench.snap_hand, bench.snap_object):
        with pytest.raises(NoAnswer):
            action()
        assert bench.session is session


def test_a_broken_image_can_be_passed(bench: Workbench, tmp_path: Path) -> None:
    (tmp_path / "images" / "depth" / "b.png").write_bytes(b"")
    bench.go(1)
    for look in (lambda: bench.raw, lambda: bench.label, bench.snap):
        with pytest.raises(InputError, match=r"b\.png"):
            look()
    bench.go(1)
    assert bench.raw.depth.any()


def test_a_folder_with_something_else_is_not_touched(tmp_path: Path, scenes: list[Scene]) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("")
    with pytest.raises(InputError, match=r"is not empty and holds no annotation\.json"):
        workbench(tmp_path, scenes[:1])


def test_a_folder_that_cannot_be_written_is_said_at_once(
    tmp_path: Path, scenes: list[Scene], monkeypatch: pytest.MonkeyPatch
) -> None:
    def denied(*_: Any, **__: Any) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(os, "replace", denied)
    with pytest.raises(InputError, match=r"cannot write .*annotation\.json: Permission denied"):
        workbench(tmp_path, scenes[:1])


def test_labels_of_another_hand_or_object_are_an_error(
    bench: Workbench, tmp_path: Path, scenes: list[Scene]
) -> None:
    joint = bench.hand.model.joint_names[0]
    bench.bend(joint, 0.5)
    files = find_images(tmp_path / "images")
    hand = hand_files(tmp_path / "hand")
    with pytest.raises(InputError, match='"industrial_part", which is not among can'):
        Workbench(files, hand, objects_of([scenes[CAN]]), bench.folder)
    other = replace(hand, model=replace(hand.model, joint_names=("other",) * 4))
    with pytest.raises(InputError, match="are of another hand"):
        Workbench(files, other, objects_of(scenes), bench.folder)


def test_a_broken_file_is_kept_and_said(
    bench: Workbench, tmp_path: Path, scenes: list[Scene]
) -> None:
    (bench.folder / SESSION_FILE).write_text("{")
    again = workbench(tmp_path, [scenes[i] for i in SCENES])
    assert "annotation.broken-1.json" in again.remark
    assert again.session == Session(("a", "b", "c"))
    assert saved(again) == again.session
