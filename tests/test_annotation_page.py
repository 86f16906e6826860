"""The labelling page in a headless Chromium: labelling, keys, faults; nothing is lost."""

import errno
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import ViserPage, chromium
from labelling_data import hand_files, true_label, workbench, write_folder, write_mesh
from rich.console import Console
from scipy.spatial.transform import Rotation

from inhand.annotation.angles import angles_of, rotation_of
from inhand.annotation.page import LabellingPage
from inhand.annotation.session import Label, Session
from inhand.annotation.storage import SESSION_FILE, load_session, save_session
from inhand.annotation.workbench import Workbench
from inhand.cli import main
from inhand.cli.annotate import save_at_last
from inhand.datasets.frames import find_frames, read_frame
from inhand.errors import InputError
from inhand.evaluation.hand_errors import wrist_error
from inhand.evaluation.metrics import ObjectMetric
from inhand.evaluation.symmetric_poses import nearest_symmetric
from inhand.geometry.se3 import exp, transform
from inhand.synth.scene import Scene
from inhand.viewer.server import address, serving

PART, CAN = 3, 5
NAMES = ("a", "b")
SAVED = "All changes are saved."


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def server() -> Iterator[Any]:
    with serving("inhand annotate", port=0) as running:
        yield running


@pytest.fixture(scope="module")
def tab(server: Any, browser: Any) -> Iterator[ViserPage]:
    """One tab for all tests: to load a page is what takes long."""
    page = ViserPage(browser, address(server), (1300, 700))
    yield page
    page.close()


@pytest.fixture
def bench(tmp_path: Path, scenes: list[Scene]) -> Workbench:
    return workbench(tmp_path, [scenes[PART], scenes[CAN]])


@pytest.fixture
def page(bench: Workbench, server: Any, tab: ViserPage, tmp_path: Path) -> Iterator[ViserPage]:
    """The page of the workbench."""
    server.gui.reset()
    server.scene.reset()
    server.gui.add_markdown(f"before {tmp_path.name}")
    tab.wait_for_text(f"before {tmp_path.name}")  # or new things take over what old ones had
    labelling = LabellingPage(server, bench)
    server.gui.add_markdown(f"{tmp_path.name} begins")
    tab.wait_for_text(f"{tmp_path.name} begins")
    tab.wait_for_text(SAVED)
    yield tab
    assert tab.errors == []
    labelling.stop()


def centre_of(label: Label, scene: Scene) -> np.ndarray:
    """The object's centre [mm] in the camera."""
    return np.asarray(1000 * transform(label.T_camera_object, scene.obj.centre[None])[0])


def type_centre(page: ViserPage, centre: np.ndarray) -> None:
    """Type the object's centre [mm] into its three fields."""
    type_three(page, "Centre [mm]", centre)


def type_three(page: ViserPage, label: str, values: np.ndarray) -> None:
    """Type numbers into the three fields with a label."""
    fields = page._row(label).locator("input:visible")
    for i, value in enumerate(values):
        fields.nth(i).fill(f"{value:.1f}")
        fields.nth(i).press("Enter")
    leave_field(page)


def shown_three(page: ViserPage, label: str) -> list[float]:
    """What the three fields with a label show."""
    return [float(field.input_value()) for field in page._row(label).locator("input:visible").all()]


def leave_field(page: ViserPage) -> None:
    """Take the focus out of a field, as a click into the 3D view does: then keys are heard."""
    page.tab.evaluate("document.activeElement.blur()")


def disk_full(*_: Any) -> None:
    """Instead of what writes."""
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def joint_field(joint: str) -> str:
    return f"{joint} [°]"


def test_a_frame_is_labelled_from_a_bad_start(
    bench: Workbench, page: ViserPage, scenes: list[Scene]
) -> None:
    """As a user would: fingers by sliders, object by field and keys, until it looks about right."""
    scene, truth = scenes[PART], true_label(scenes[PART])
    start = bench.label
    metric = ObjectMetric(scene.obj)
    error = metric.pose_error(start.T_camera_object, scene.T_camera_object)
    assert error.translation > 0.01
    assert np.degrees(error.rotation) > 45
    for sign, (joint, position) in zip((1, -1, 1, -1), truth.joint_positions.items(), strict=True):
        page.enter(joint_field(joint), f"{np.degrees(position) + 6 * sign:.1f}")
    type_centre(page, centre_of(truth, scene) + [6.0, -4.0, 6.0])
    page.enter("Step [°]", 15)
    leave_field(page)
    turn_by_keys(page, bench, scene)
    rough = metric.pose_error(bench.label.T_camera_object, scene.T_camera_object)
    assert rough.translation > 0.005
    assert np.degrees(rough.rotation) > 5
    page.click("Both")
    page.wait_until(lambda: "snapped" in bench.session.past[-1].what, "the snap")
    page.wait_until(lambda: min(shares_in_agreement(page)) >= 99, "hand and object to agree")
    page.click("Labelled")
    page.wait_for_text("1 of 2 labelled")
    page.click("Write the data set")
    page.wait_for_text("Images written to")
    (path,) = find_frames([bench.folder])
    written = read_frame(path).truth
    found = metric.pose_error(written.T_camera_object, scene.T_camera_object)
    assert found.translation < 0.001
    assert np.degrees(found.rotation) < 1
    wrist = wrist_error(written.T_camera_hand, scene.T_camera_hand)
    assert wrist.translation < 0.001
    assert np.degrees(wrist.rotation) < 1
    for joint, position in truth.joint_positions.items():
        assert written.joint_positions[joint] == pytest.approx(position, abs=np.radians(1)), joint


def shares_in_agreement(page: ViserPage) -> list[int]:
    """How much of hand and object lies within 3 mm of its readings, as the page says [%]."""
    shares = re.findall(r"(\d+)% of \d+ px within 3 mm", page.tab.inner_text("body"))
    return [int(share) for share in shares] if len(shares) == 2 else [0]


def turn_by_keys(page: ViserPage, bench: Workbench, scene: Scene) -> None:
    """Turn the object by keys until it is nearly right."""
    keys = [("Shift+K", "Shift+I"), ("Shift+J", "Shift+L"), ("Shift+O", "Shift+U")]
    while True:
        T = bench.label.T_camera_object
        nearest = nearest_symmetric(scene.obj.symmetry, T, scene.T_camera_object)
        way = np.degrees(Rotation.from_matrix(nearest[:3, :3] @ T[:3, :3].T).as_rotvec())
        axis = int(np.abs(way).argmax())
        if abs(way[axis]) < 12:
            return
        before = len(bench.session.past), bench.label
        page.tab.keyboard.press(keys[axis][0 if way[axis] > 0 else 1])
        page.wait_until(lambda: bench.label != before[1], "the object to turn")  # noqa: B023


def test_position_and_rotation_are_typed(
    bench: Workbench, page: ViserPage, scenes: list[Scene]
) -> None:
    """To a tenth of a millimetre and of a degree, without a drag; the fields follow the object."""
    truth = true_label(scenes[PART])
    centre, angles = centre_of(truth, scenes[PART]), angles_of(truth.T_camera_object[:3, :3])
    type_centre(page, centre)
    type_three(page, "Turn [°]", angles)

    def is_there() -> bool:
        error = bench.tools.difference(bench.label, truth)
        return error.translation < 1.5e-4 and np.degrees(error.rotation) < 0.15

    page.wait_until(is_there, "the object where it was typed")
    page.tab.keyboard.press("Shift+O")
    turned = lambda: rotation_of(np.array(shown_three(page, "Turn [°]")))  # noqa: E731
    page.wait_until(
        lambda: (
            np.allclose(turned(), bench.label.T_camera_object[:3, :3], atol=1e-4) and not is_there()
        ),
        "the fields to follow the key",
    )
    # Angles beyond those that are shown for a rotation stay as they were typed.
    type_three(page, "Turn [°]", np.array([10.0, 120.0, 20.0]))
    expected = rotation_of(np.array([10.0, 120.0, 20.0]))
    page.wait_until(
        lambda: np.allclose(bench.label.T_camera_object[:3, :3], expected, atol=1e-9),
        "the object turned as typed",
    )
    pictures = page.pictures()
    page.enter(joint_field(bench.hand.model.joint_names[0]), 40)
    page.wait_until(lambda: page.pictures() != pictures, "the page to be drawn anew")
    assert shown_three(page, "Turn [°]") == [10, 120, 20]


def test_buttons_and_keys_do_the_same(bench: Workbench, page: ViserPage) -> None:
    page.click("Propose")
    page.wait_for_text("estimator (confidence")
    proposed = bench.label
    page.tab.keyboard.press("u")
    page.wait_until(lambda: bench.label != proposed, "the object to come nearer")
    page.tab.keyboard.press("Control+z")
    page.wait_until(lambda: bench.label == proposed, "undo by the key")
    page.tab.keyboard.press("Shift+Z")
    page.wait_until(lambda: bench.label != proposed, "redo by the key")
    page.click("Undo")
    page.wait_until(lambda: bench.label == proposed, "undo by the button")
    page.tab.keyboard.press("n")
    page.wait_for_text("b: open")
    page.tab.keyboard.press("x")
    page.wait_for_text("1 skipped")
    page.wait_for_text("a: open")
    page.enter("Image (of 2)", 2)
    page.wait_for_text("b: skipped")
    # A letter that is typed into a field is no key.
    field = page._row("Step [mm]").locator("input:visible").last
    field.press("x")
    page.tab.wait_for_timeout(500)
    assert bench.session.count("skipped") == 1


def test_pictures_follow_the_label(bench: Workbench, page: ViserPage) -> None:
    page.wait_for_text("px within")
    view, pictures = page.wait_until_still(), page.pictures()
    page.enter(joint_field(bench.hand.model.joint_names[0]), 10)
    page.wait_until(lambda: page.pictures() != pictures, "other pictures")
    assert (page.wait_until_still() != view).any()
    name = bench.hand.model.joint_names[0]
    assert bench.label.joint_positions[name] == pytest.approx(np.radians(10))


def test_the_object_in_the_hand_is_chosen(
    bench: Workbench, page: ViserPage, scenes: list[Scene]
) -> None:
    page.click("Next")
    page.wait_for_text("b: open")
    page.choose("In the hand", "can")
    page.wait_until(lambda: bench.label.object_name == "can", "the can")
    page.click("Propose")
    page.wait_for_text("estimator (confidence")
    error = bench.tools.difference(bench.label, true_label(scenes[CAN]))
    assert error.translation < 0.002
    assert np.degrees(error.rotation) < 2


def test_what_is_seen_can_be_chosen(page: ViserPage) -> None:
    page.wait_for_text("px within")
    view = page.wait_until_still()
    for layer in ("Hand", "Object"):
        page.tick(layer)
        view = page.wait_for_change(view)
    page.tick("Hand")
    page.wait_for_change(view)


def test_the_handle_moves_the_object(
    bench: Workbench, server: Any, page: ViserPage, scenes: list[Scene]
) -> None:
    before = centre_of(bench.label, scenes[PART])
    for _ in range(2):  # the second time, undo has put the handle back
        drag_arrow(server, page, bench)
        way = centre_of(bench.label, scenes[PART]) - before
        assert way[0] == pytest.approx(-40, abs=8)
        assert np.abs(way[1:]).max() < 1e-3
        assert [change.what for change in bench.session.past] == ["object dragged"]
        page.click("Undo")
        page.wait_until(lambda: bench.session.label is None, "the object to be put back")


def drag_arrow(server: Any, page: ViserPage, bench: Workbench) -> None:
    """Drag the handle by its arrow; a slow browser may not feel the pointer before the button."""
    for _ in range(3):
        page.wait_until_still()
        drag(page, *arrow_on_screen(server, page, bench))
        page.wait_until_still()
        if bench.session.label is not None:
            return


def drag(page: ViserPage, start: np.ndarray, end: np.ndarray) -> None:
    """Drag the pointer between two pixels."""
    mouse = page.tab.mouse
    mouse.move(*start)
    page.tab.wait_for_timeout(500)
    mouse.down()
    for share in np.linspace(0, 1, 8):
        mouse.move(*(start + share * (end - start)))
        page.tab.wait_for_timeout(60)
    mouse.up()


def arrow_on_screen(
    server: Any, page: ViserPage, bench: Workbench
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels where the handle's arrow along x is drawn, and 40 mm farther to the left.

    By the pinhole of the browser's own view, as it reports it.
    """
    boxes = [canvas.bounding_box() for canvas in page.tab.locator("canvas").all()]
    box = max((b for b in boxes if b), key=lambda b: b["width"] * b["height"])
    (client,) = server.get_clients().values()
    eye = client.camera
    depth_camera = np.array(server.scene.get_handle_by_name("/camera").position)
    at = np.array([[0.055, 0, 0], [0.015, 0, 0]]) + depth_camera
    at += bench.tools.centred(bench.label.T_camera_object)[:3, 3]
    in_view = (at - eye.position) @ Rotation.from_quat(np.roll(eye.wxyz, -1)).as_matrix()
    focal = box["height"] / 2 / np.tan(eye.fov / 2)
    pixels = focal * in_view[:, :2] / in_view[:, 2:]
    start, end = pixels + [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]
    return start, end


def test_a_tab_that_is_closed_in_the_middle_loses_nothing(
    bench: Workbench, server: Any, page: ViserPage, browser: Any
) -> None:
    """Not even what was typed last; another tab sees it, and so does one that comes back."""
    joint = joint_field(bench.hand.model.joint_names[1])
    other = ViserPage(browser, address(server))
    other.enter(joint, 33)
    other.close()
    page.wait_until(lambda: page.value(joint) == "33", "the finger where it is")
    assert saved(bench.folder).past == bench.session.past
    back = ViserPage(browser, address(server))
    back.wait_until(lambda: back.value(joint) == "33", "the finger where it is")
    back.close()


def test_a_full_disk_is_said_and_the_label_kept(
    bench: Workbench, page: ViserPage, monkeypatch: pytest.MonkeyPatch
) -> None:
    joint = bench.hand.model.joint_names[0]
    with monkeypatch.context() as disk:
        disk.setattr(os, "fsync", disk_full)
        page.enter(joint_field(joint), 44)
        page.wait_for_text("NOT SAVED")
        assert "No space left on device" in page.text()
        assert "kept in memory" in page.text()
        assert SAVED not in page.text()
    assert saved(bench.folder).label is None
    page.click("Save again")
    page.wait_for_text(SAVED)
    label = saved(bench.folder).label
    assert label is not None
    assert label.joint_positions[joint] == pytest.approx(np.radians(44))


def test_problems_are_said_and_the_page_goes_on(
    bench: Workbench, page: ViserPage, tmp_path: Path
) -> None:
    (tmp_path / "images" / "depth" / "b.png").write_bytes(b"no picture")
    page.click("Write the data set")
    page.wait_for_text("no image is labelled yet")
    page.enter("Step [mm]", 100)
    leave_field(page)
    for _ in range(3):
        page.tab.keyboard.press("l")
    page.click("Object")
    page.wait_for_text("the image does not show the object where it is")
    page.click("Next")
    page.wait_for_text("cannot read the image")
    page.click("Previous")
    page.wait_for_text("px within")


def saved(folder: Path) -> Session:
    return load_session(folder / SESSION_FILE, NAMES)[0]


# The command


@pytest.fixture
def command(tmp_path: Path, scenes: list[Scene]) -> list[str]:
    """`inhand annotate` with a folder of two images, and a port that is free."""
    write_folder(tmp_path / "images", [scenes[PART]] * 2, rgb=False)
    write_mesh(tmp_path / "part.ply", scenes[PART].obj.mesh)
    urdf = hand_files(tmp_path / "hand").urdf
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    return [
        *("annotate", str(tmp_path / "images"), "--out", str(tmp_path / "out")),
        *("--hand", str(urdf), "--objects", str(tmp_path / "part.ply")),
        *("--port", str(port), "--device", "cpu"),
    ]


@contextmanager
def running(command: list[str]) -> Iterator[tuple[subprocess.Popen[str], str, str]]:
    """The command in a process of its own, the page's address, and what it said before that."""
    program = [sys.executable, "-c", "from inhand.cli import main; raise SystemExit(main())"]
    process = subprocess.Popen(
        [*program, *command],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "COLUMNS": "500", "PYTHONUNBUFFERED": "1"},
    )
    assert process.stdout is not None
    said = ""
    try:
        while not (found := re.search(r"http://\S+", said)):
            line = process.stdout.readline()
            assert line, said
            said += line
        yield process, found.group(), said
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def test_a_killed_server_loses_nothing(
    command: list[str],
    browser: Any,
    tmp_path: Path,
    scenes: list[Scene],
    capsys: pytest.CaptureFixture[str],
    interruptible: None,
) -> None:
    joint = joint_field(scenes[PART].hand.joint_names[0])
    with running(command) as (process, where, _):
        assert "another process is labelling into" in said_by(capsys, command)
        page = ViserPage(browser, where)
        page.wait_for_text(SAVED)
        page.click("Labelled")
        page.wait_for_text("1 of 2 labelled")
        page.enter(joint, 55)
        page.enter("Step [mm]", 5)
        leave_field(page)
        page.tab.keyboard.press("o")
        wait = lambda: len(saved(tmp_path / "out").past) == 3  # noqa: E731
        page.wait_until(wait, "three changes to be saved")
        process.send_signal(signal.SIGKILL)
        process.wait()
        before = saved(tmp_path / "out")
        page.close()
    with running(command) as (process, where, said):
        assert "1 of 2 images are labelled" in said
        page = ViserPage(browser, where)
        page.wait_for_text("b: open")
        page.wait_until(lambda: page.value(joint) == "55", "the finger where it was")
        assert saved(tmp_path / "out") == before
        page.click("Undo")
        page.wait_until(lambda: len(saved(tmp_path / "out").past) == 2, "undo after the resume")
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=30) == 130
        page.close()


def said_by(capsys: pytest.CaptureFixture[str], command: list[str]) -> str:
    assert main(command) == 2
    return capsys.readouterr().err


def test_a_port_that_is_taken(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    port = int(command[command.index("--port") + 1])
    with socket.socket() as other:
        other.bind(("127.0.0.1", port))
        other.listen()
        assert f"port {port} is taken" in said_by(capsys, command)


class Waiting:
    """Instead of the event that is waited for until Ctrl-C: there is room again then, or not."""

    def __init__(self, make_room: Callable[[], None]) -> None:
        self._make_room = make_room

    def wait(self) -> None:
        self._make_room()
        raise KeyboardInterrupt


@pytest.mark.parametrize("room", [False, True])
def test_labels_that_could_not_be_saved_are_saved_at_the_end(
    bench: Workbench,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    room: bool,
) -> None:
    console, joint = Console(), bench.hand.model.joint_names[0]
    save_at_last(bench, console)
    assert not capsys.readouterr().out
    with monkeypatch.context() as disk:
        disk.setattr(os, "fsync", disk_full)
        bench.bend(joint, 0.5)
        waiting = Waiting(disk.undo if room else lambda: None)
        monkeypatch.setattr("inhand.cli.annotate.Event", lambda: waiting)
        if room:
            save_at_last(bench, console)
        else:
            with pytest.raises(InputError, match="the last changes are lost: cannot write"):
                save_at_last(bench, console)
    assert "NOT SAVED" in capsys.readouterr().out
    assert (saved(bench.folder).label == bench.label) == room


def test_a_broken_autosave_is_set_aside(command: list[str], tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / SESSION_FILE).write_text('{"format": "inhand annot')
    with running(command) as (_, _, said):
        assert "is kept as annotation.broken-1.json" in said
        assert "0 of 2 images are labelled" in said
    assert (tmp_path / "out" / "annotation.broken-1.json").is_file()


def test_bad_input_is_said(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    without_hand = [c for c in command if c != "--hand" and not c.endswith(".urdf")]
    assert "name its URDF with --hand" in said_by(capsys, without_hand)
    without_objects = [c for c in command if c != "--objects" and not c.endswith(".ply")]
    assert "name its mesh with --objects" in said_by(capsys, without_objects)
    (tmp_path / "images" / "camera.json").unlink()
    assert "holds no depth images to label" in said_by(capsys, command)


def test_the_data_set_is_written_without_a_page(
    command: list[str], tmp_path: Path, scenes: list[Scene], capsys: pytest.CaptureFixture[str]
) -> None:
    assert "no image is labelled" in said_by(capsys, [*command, "--write"])
    label = replace(true_label(scenes[PART]), object_name="part", status="labelled")
    turn = exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    label = replace(label, T_camera_object=turn @ label.T_camera_object)
    save_session(tmp_path / "out" / SESSION_FILE, Session(NAMES).go_to(1).change(label, "labelled"))
    assert main([*command, "--write"]) == 0
    assert f"Images written to {tmp_path / 'out'}: 1" in capsys.readouterr().out.replace("\n", "")
    (path,) = find_frames([tmp_path / "out"])
    frame = read_frame(path)
    assert frame.object_name == "part"
    assert frame.name.endswith("000001_000000")
