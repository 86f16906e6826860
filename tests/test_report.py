"""The report of made-up results: its figures and its page."""

import base64
import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
from made_up_results import result, study_of_everything, write
from PIL import Image

from inhand.cli import report as command
from inhand.errors import InputError
from inhand.evaluation import figures
from inhand.evaluation.contact_sheet import hardest_solved
from inhand.evaluation.machine import origin
from inhand.evaluation.make_report import make_report
from inhand.evaluation.page import write_report
from inhand.evaluation.results import FrameResult
from inhand.evaluation.study import Study, load_study
from inhand.evaluation.tables import Table


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    return study_of_everything(tmp_path_factory.mktemp("run"))


@pytest.fixture(scope="module")
def folder(study: Study, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a report."""
    folder = tmp_path_factory.mktemp("report")
    write_report(make_report(study, "A <title>"), folder)
    return folder


def test_figures_are_the_same_every_time(study: Study) -> None:
    draw = figures.Figures(list(study.by_method))
    panels = {"clean": study.results("clean")}
    first, second = (draw.recall_curves(panels) for _ in range(2))
    assert first == second
    assert ElementTree.fromstring(first).tag.endswith("svg")


def test_page_holds_every_section_and_needs_nothing_beside_it(folder: Path) -> None:
    page = (folder / "report.html").read_text()
    assert "A &lt;title&gt;" in page
    sections = ["Methods", "Objects", "Occlusion", "Ablation", "Perturbed starts"]
    sections += [
        "Robustness",
        "Time",
        "Hand",
        "Confidence",
        "Other measures",
        "Where frames are lost",
        "Frames",
        "Runs",
    ]
    assert re.findall(r"<h2 id=[^>]+>([^<]+)</h2>", page) == sections
    links = re.findall(r'(?:src|href)="([^"]+)"', page)
    assert all(link.startswith(("data:image/", "#")) for link in links)
    anchors = {f"#{a}" for a in re.findall(r'id="([^"]+)"', page)}
    assert {link for link in links if link.startswith("#")} <= anchors
    images = [link for link in links if link.startswith("data:")]
    assert len(images) == len(list((folder / "figures").iterdir())) == 10
    for image in images:
        svg = base64.b64decode(image.partition(",")[2]).decode()
        assert ElementTree.fromstring(svg).tag.endswith("svg")
    assert "a | &lt;b&gt; &amp; c" in page, "the frame that a method failed on"
    assert "cut short" in page
    assert "goes the other way" in page, "the direction of ADI"


def test_every_table_and_figure_says_what_made_it(folder: Path) -> None:
    text = (folder / "tables.md").read_text()
    blocks = text.count("\n### ") - 1 + text.count("![")
    assert text.count("Made from run 1.") == blocks
    made = origin("cpu")
    for words in (made["commit"], made["processor"], made["memory"], "version: 1"):
        assert words in text
    assert "/nowhere" not in text, "paths of a machine are of no use elsewhere"
    figure = ElementTree.parse(folder / "figures" / "recall-curves.svg")
    assert made["commit"] in "".join(figure.getroot().itertext())
    for name in re.findall(r"\]\((figures/[^)]+)\)", text):
        assert (folder / name).exists()


def test_gallery_shows_successes_and_failures(
    study: Study, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Sheet:
        def tile(self, result: FrameResult) -> Image.Image:
            if result.frame == "clean/004":
                raise InputError("the frame is gone")
            return Image.new("RGB", (4, 4))

    monkeypatch.setattr("inhand.evaluation.make_report._contact_sheet", lambda _: Sheet())
    made = make_report(study, "title", pictures=3)
    shown = {pictures.title: len(pictures.pngs) for pictures in made.gallery}
    assert shown == {
        "clean, inhand: solved with the least of the object visible": 2,
        "clean, inhand: failures": 3,
        "noisy, inhand: solved with the least of the object visible": 3,
    }
    assert "no picture of clean/004: the frame is gone" in made.remarks


def test_hardest_solved_takes_the_objects_in_turn() -> None:
    results = [result(i, adi=0.02 if i == 3 else 0.001) for i in range(8)]
    # Visible: 5 % of 0, 6 (cans) and 3 (a box, not solved), 50 % of 1, 7 (boxes) and 4.
    assert [r.frame[-1] for r in hardest_solved(results, 4)] == ["0", "1", "6", "7"]


def test_what_cannot_be_drawn_is_remarked(study: Study) -> None:
    made = make_report(study, "title", pictures=2)
    assert not made.gallery
    assert any("no pictures of frames" in remark for remark in made.remarks)


def test_the_reference_comes_first_and_must_exist(study: Study) -> None:
    made = make_report(study, "title", "fpfh+hs")
    first = made.sections[0].items[0].content
    assert isinstance(first, Table)
    assert [row[0] for row in first.rows] == ["fpfh+hs", "inhand", "fpfh+mask"]
    with pytest.raises(InputError, match=r'no method "none".*inhand, fpfh'):
        make_report(study, "title", "none")


def test_a_report_of_unreadable_frames_alone(tmp_path: Path) -> None:
    bad = FrameResult("clean/1", "1.npz", "unreadable", "cut short")
    study = load_study([write(tmp_path / "run", [bad])])
    made = make_report(study, "title")
    assert [s.title for s in made.sections] == ["Frames"]


def test_command_line(study: Study, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = study.records[0].path.parent
    arguments = command.Report((folder,), out=tmp_path / "out", pictures=0)
    assert command.run(arguments) == 0
    assert (tmp_path / "out" / "report.html").exists()
    assert "tables.md and 10 figures" in " ".join(capsys.readouterr().out.split())


def test_origin_tells_command_commit_and_machine() -> None:
    made = origin("cpu")
    assert json.loads(json.dumps(made)) == made
    assert re.search(r"\d+ cores", made["processor"])
    assert "numpy" in made["versions"]
