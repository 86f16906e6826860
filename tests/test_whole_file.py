"""Files are there completely or as they were, whatever goes wrong while they are written."""

import os
from pathlib import Path

import pytest
from full_disk import largest_file
from PIL import Image

from inhand.errors import InputError
from inhand.estimate import PoseEstimate
from inhand.evaluation.results import FrameResult, Ledger, read_results
from inhand.io import read_result, write_picture, write_result
from inhand.whole_file import whole_file, write_whole

ESTIMATE = PoseEstimate(False, "hidden, " * 1000, None, {}, None, 0.0)


@pytest.mark.parametrize("durable", [False, True])
def test_a_file_and_its_folder_are_made(tmp_path: Path, durable: bool) -> None:
    path = tmp_path / "new" / "file.txt"
    for text in ("first", "größer"):
        write_whole(path, text, durable=durable)
        assert path.read_text(encoding="utf-8") == text
        assert os.listdir(path.parent) == ["file.txt"]


def test_until_the_end_the_file_is_what_it_was(tmp_path: Path) -> None:
    path = tmp_path / "file.png"
    path.write_text("before")
    with whole_file(path) as unfinished:
        assert unfinished.suffix == ".png"
        unfinished.write_text("after")
        assert path.read_text() == "before"
    assert path.read_text() == "after"


@pytest.mark.parametrize("kind", [KeyboardInterrupt, ValueError, OSError])
def test_whatever_goes_wrong_leaves_what_was_there(
    tmp_path: Path, kind: type[BaseException]
) -> None:
    path = tmp_path / "file"
    path.write_text("before")
    expected = InputError if kind is OSError else kind

    def write(unfinished: Path) -> None:
        unfinished.write_text("half")
        raise kind

    with pytest.raises(expected), whole_file(path) as unfinished:
        write(unfinished)
    assert os.listdir(tmp_path) == ["file"]
    assert path.read_text() == "before"


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "disk" / "file")
    write_whole(link, "text")
    assert link.is_symlink()
    assert (tmp_path / "disk" / "file").read_text() == "text"


def test_a_pipe_stays_a_pipe(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_whole(pipe, "text")
    assert os.read(reader, 100) == b"text"
    os.close(reader)
    assert pipe.is_fifo()


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"cannot write {tmp_path}: Is a directory"):
        write_whole(tmp_path, "text")


def test_a_full_disk_leaves_the_last_result(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    with largest_file(1000), pytest.raises(InputError, match=r"cannot write .*result\.json"):
        write_result(path, ESTIMATE)
    assert os.listdir(tmp_path) == []
    write_result(path, ESTIMATE)
    with largest_file(1000), pytest.raises(InputError, match=r"cannot write .*result\.json"):
        write_result(path, ESTIMATE)
    assert os.listdir(tmp_path) == ["result.json"]
    assert read_result(path).reason == ESTIMATE.reason


def test_a_full_disk_leaves_the_last_picture(tmp_path: Path) -> None:
    path = tmp_path / "picture.png"
    noise = Image.effect_noise((64, 64), 50)
    write_picture(path, noise)
    with largest_file(1000), pytest.raises(InputError, match=r"cannot write .*picture\.png"):
        write_picture(path, noise)
    assert os.listdir(tmp_path) == ["picture.png"]
    with Image.open(path) as picture:
        assert picture.tobytes() == noise.tobytes()


def test_a_full_disk_leaves_the_results_of_a_benchmark(tmp_path: Path) -> None:
    """Those that were written are read back, and the next run goes on after them."""
    path, settings = tmp_path / "results.jsonl", {"seed": 0}
    ledger = Ledger(path, settings)
    with (
        largest_file(10_000),
        pytest.raises(InputError, match=r"cannot write the results to .*results\.jsonl.*goes on"),
    ):
        list(ledger.record(FrameResult(str(i), "", "no answer") for i in range(100)))
    whole = len(ledger.results)
    assert 3 < whole < 20
    assert len(read_results(path).results) == whole
    cut = path.read_bytes()
    assert not cut.endswith(b"\n")
    with largest_file(1000), pytest.raises(InputError, match="cannot write"):
        Ledger(path, settings)  # it takes the last line away that was cut
    assert path.read_bytes() == cut
    assert len(Ledger(path, settings).results) == whole
    assert path.read_bytes().endswith(b"\n")
