"""The report of made-up results, whose numbers are known."""

import base64
import json
import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from PIL import Image

from inhand.cli import report as command
from inhand.errors import InputError
from inhand.evaluation import comparison_tables, figures, tables
from inhand.evaluation.contact_sheet import hardest_solved
from inhand.evaluation.machine import origin
from inhand.evaluation.make_report import make_report
from inhand.evaluation.page import describe_run, write_report
from inhand.evaluation.results import FrameResult, Ledger, read_results
from inhand.evaluation.study import Study, by_quantity, load_study
from inhand.evaluation.summary import summarise
from inhand.evaluation.sweep_tables import sweep_table, sweep_tables
from inhand.evaluation.sweeps import curve
from inhand.evaluation.tables import Best, Table

SETTINGS = {"version": "1", "hand": "/nowhere/hand.urdf", "objects": "/nowhere/objects"}
STAGES = ("hypotheses", "clustering", "refinement", "pruning", "selection")


def result(i: int, method: str = "inhand", adi: float | None = 0.001, **more: Any) -> FrameResult:
    """A result on frame `i`: objects in turn, a third of them hardly visible."""
    errors = {} if adi is None else {"adi_from_truth": adi, "add": 2 * adi, "mssd": 3 * adi}
    share = 0.0 if adi is None else 0.5
    return FrameResult(
        frame=f"{more.pop('data_set', 'clean')}/{i:03d}",
        file=f"/nowhere/{i}.npz",
        outcome="answer" if adi is not None else "no answer",
        object_name=("can", "box")[i % 2],
        visible_share=(0.05, 0.5, 0.9)[i % 3],
        method=method,
        adi=adi,
        **{"mssd_share": share, "mspd_share": share, "vsd_share": share / 2, **errors, **more},
    )


def pipeline(i: int, adi: float | None = 0.001, **more: Any) -> FrameResult:
    """A result with everything that a variant of the pipeline tells."""
    return result(
        i,
        adi=adi,
        confidence=0.9 if adi is not None and adi < 0.005 else 0.2,
        candidates_adi=[adi or 1.0],
        best_adi=dict.fromkeys(STAGES, 0.001),
        joint_errors={"finger": 0.02},
        joint_pixels={"finger": 900},
        wrist_errors={"given": [0.004, 0.02], "answer": [0.001, 0.01]},
        timings={"observation": 0.01, "hypotheses": 0.02},
        seconds=0.04,
        peak_memory=2**30,
        lost_at=None if adi is not None and adi < 0.005 else "selection",
        **more,
    )


def everything() -> list[FrameResult]:
    """Results of several methods, with an ablation and perturbed starts."""
    found = [pipeline(i, adi) for i, adi in enumerate([0.001, 0.003, 0.007, None, 0.001, 0.030])]
    found += [pipeline(i, 0.001, data_set="noisy") for i in range(3)]
    found += [result(i, "fpfh+hs", 0.004 + 0.004 * (i % 2), seconds=0.1) for i in range(6)]
    found += [result(i, "fpfh+mask", 0.0005, seconds=0.1) for i in range(6)]
    found += [result(i, "ablation-baseline", 0.02 if i else 0.001) for i in range(4)]
    found += [result(i, "ablation-pairs", 0.001) for i in range(4)]
    for amount in (0.0, 0.01, 0.02):
        found += [
            result(i, "icp", 0.002 + amount / 4, perturbation={"translation": amount})
            for i in range(4)
        ]
    found += [
        pipeline(i, 0.003 * k, perturbation={"noise": 1.0 * k}) for i in range(4) for k in (1, 2)
    ]
    found.append(replace(result(6, "fpfh+hs", None), outcome="error", reason="a | <b> & c"))
    found.append(replace(result(7, "fpfh+hs", None), outcome="unreadable", reason="cut short"))
    return found


def write(folder: Path, results: Iterable[FrameResult], **settings: Any) -> Path:
    ledger = Ledger(folder / "results.jsonl", {**SETTINGS, **settings}, origin("cpu"))
    for r in results:
        ledger.append(r)
    return folder


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    return load_study([write(tmp_path_factory.mktemp("run") / "bench", everything())])


@pytest.fixture(scope="module")
def folder(study: Study, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a report."""
    folder = tmp_path_factory.mktemp("report")
    write_report(make_report(study, "A <title>"), folder)
    return folder


def cell(table: Table, row: str, column: str) -> str:
    found = [r for r in table.rows if r[0] == row]
    assert len(found) == 1, (row, table.rows)
    return found[0][table.columns.index(column)]


def summaries(study: Study, name: str = "clean") -> dict[str, Any]:
    return {method: summarise(results) for method, results in study.results(name).items()}


# --- summary


def test_measures_of_a_summary_by_hand() -> None:
    results = [result(i, adi=adi) for i, adi in enumerate([0.001, 0.004, 0.010, None])]
    measures = {k: v["frames"]["value"] for k, v in summarise(results)["measures"].items()}
    assert measures["recall"] == 0.5
    assert measures["area"] == pytest.approx((0.95 + 0.8 + 0.5 + 0) / 4)
    assert measures["recall from truth"] == 0.5
    assert measures["recall ADD"] == 0.25
    assert measures["MSSD"] == measures["MSPD"] == pytest.approx(0.5 * 3 / 4)
    assert measures["VSD"] == pytest.approx(0.25 * 3 / 4)
    assert measures["BOP"] == pytest.approx((0.375 + 0.375 + 0.1875) / 3)


def test_area_is_that_under_the_recall_curve() -> None:
    errors = [0.0005 * k for k in range(60)]
    results = [result(i, adi=adi) for i, adi in enumerate(errors)]
    limits = [0.020 * (k + 0.5) / 4000 for k in range(4000)]
    recall = [sum(e < limit for e in errors) / len(errors) for limit in limits]
    area = summarise(results)["measures"]["area"]["frames"]["value"]
    assert area == pytest.approx(sum(recall) / len(recall), abs=1e-3)


def test_mean_of_objects_weighs_them_alike() -> None:
    results = [result(0, adi=0.001), *(result(i, adi=0.02) for i in (1, 3, 5))]
    recall = summarise(results)["measures"]["recall"]
    assert recall["frames"]["value"] == 0.25
    assert recall["objects"]["value"] == 0.5


def test_times_have_all_quantiles() -> None:
    results = [result(i, seconds=(i + 1) / 100) for i in range(100)]
    time = summarise(results)["time"]["whole estimate"]
    assert time["mean"] == pytest.approx(0.505)
    assert time["median"] == pytest.approx(0.505)
    assert (time["p95"], time["p99"]) == pytest.approx((0.9505, 0.9901))
    assert time["deviation"] == pytest.approx(0.288661, rel=1e-4)


def test_a_frame_of_unknown_visibility_is_in_no_bin() -> None:
    summary = summarise([replace(result(0), visible_share=None), result(1)])
    assert list(summary["recall"]["visible share"]) == ["30-60 %"]


# --- study


def test_shards_and_sessions_are_one_run(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    for shard, frames in ((1, (0, 2)), (2, (1, 3))):
        ledger = Ledger(folder / f"results-{shard}of2.jsonl", SETTINGS, {"machine": str(shard)})
        for i in frames:
            ledger.append(result(i))
    study = load_study([folder])
    assert list(study.by_method) == ["inhand"]
    assert len(study.by_method["inhand"]) == 4
    assert study.runs(["inhand"]) == {0, 1}
    assert [r.origins for r in study.records] == [({"machine": "1"},), ({"machine": "2"},)]


def test_a_table_names_only_the_runs_of_its_data_set(tmp_path: Path) -> None:
    folders = [
        write(tmp_path / name, [pipeline(i, data_set=name) for i in range(3)])
        for name in ("clean", "noisy")
    ]
    study = load_study(folders)
    items = [item for s in make_report(study, "").sections for item in s.items]
    runs = {item.name: item.runs for item in items}
    assert runs["overview-clean"] == runs["hand-clean"] == {0}
    assert runs["overview-noisy"] == runs["hand-noisy"] == {1}
    assert runs["recall-curves"] == runs["time-table"] == {0, 1}


def test_what_two_sessions_at_once_wrote_twice_counts_once(tmp_path: Path) -> None:
    folder = write(tmp_path, [result(0), result(1)])
    Ledger(folder / "results.jsonl", SETTINGS).append(result(1))
    assert len(load_study([folder]).by_method["inhand"]) == 2


def test_sessions_that_differ_are_all_told(tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    for i, machine in enumerate(("a", "a", "b")):
        Ledger(path, {}, {"machine": machine}).append(result(i))
    Ledger(path, {}, {"machine": "idle"})
    record = read_results(path)
    assert record.origins == ({"machine": "a"}, {"machine": "b"})
    assert [r.frame for r in record.results] == ["clean/000", "clean/001", "clean/002"]


def test_of_a_session_only_what_is_new_is_told(tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    for i, words in enumerate(("one", "two")):
        Ledger(path, {}, {"command": words, "machine": "a"}).append(result(i))
    told = describe_run(read_results(path))[1:]
    assert told == [("command", "one"), ("machine", "a"), ("command", "two")]


def test_a_method_with_other_settings_is_another_method(tmp_path: Path) -> None:
    old = write(tmp_path / "old", [result(0, adi=0.02)], version="1")
    new = write(tmp_path / "new", [result(0)], version="2")
    other = write(tmp_path / "other", [result(0, data_set="noisy")], version="3")
    assert list(load_study([old, new]).by_method) == ["inhand (old)", "inhand (new)"]
    assert list(load_study([old, other]).by_method) == ["inhand"], "no data set in common"


def test_one_result_in_two_files_is_refused(tmp_path: Path) -> None:
    one, two = (write(tmp_path / name, [result(0)]) for name in ("one", "two"))
    with pytest.raises(InputError, match=r"two.*one.* both hold the result of inhand on clean/000"):
        load_study([one, two])
    assert len(load_study([one, one, one / "results.jsonl"]).by_method["inhand"]) == 1


def test_methods_on_different_frames_are_remarked() -> None:
    results = {"a": [result(0), result(1)], "b": [result(0)]}
    uneven = Study((), results, {}, {}, {})
    assert uneven.remarks() == ["clean: not every method ran on all 2 frames: b on 1"]
    assert Study((), {"a": [result(0)], "b": [result(0)]}, {}, {}, {}).remarks() == []


def test_perturbations_by_quantity() -> None:
    amounts: list[dict[str, float]] = [{"translation": 0.02}, {"translation": 0.01}]
    amounts += [{"translation": 0.0, "rotation": 0.1}, {"translation": 0.0, "rotation": 0.0}]
    results = [result(i, perturbation=p) for i, p in enumerate(amounts)]
    table = by_quantity({"icp": results})
    assert list(table["translation"]["icp"]) == [0.0, 0.01, 0.02]
    assert list(table["rotation"]["icp"]) == [0.0, 0.1]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "does not exist"),
        ("", "is not a results file"),
        ("hello\n", "is not a results file"),
        ('{"settings": {}}\n{"frame": 1}\n', "is not a results file"),
        ('{"settings": {}}\n', "there is no result in"),
    ],
)
def test_broken_results_are_named(text: str | None, words: str, tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        load_study([path])
    assert str(path) in str(caught.value)


def test_a_folder_without_results_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"holds no results\*.jsonl"):
        load_study([tmp_path])


# --- tables


def test_recall_by_object(study: Study) -> None:
    table = comparison_tables.object_table(summaries(study))
    assert cell(table, "inhand", "can") == "66.7 (21-94)"
    assert cell(table, "inhand", "mean of frames").startswith("50.0 ")
    assert cell(table, "fpfh+hs", "can").startswith("75.0 "), "the frame it failed on is a miss"
    assert isinstance(cell(table, "fpfh+hs", "mean of objects"), str)


def test_the_best_stands_out_but_no_upper_bound(study: Study) -> None:
    table = comparison_tables.overview_table(summaries(study))
    assert isinstance(cell(table, "inhand", "ADI < 2 mm"), Best)
    assert not isinstance(cell(table, "fpfh+mask", "ADI < 2 mm"), Best)
    assert cell(table, "fpfh+mask", "ADI < 2 mm").startswith("100.0")
    assert isinstance(cell(table, "inhand", "median time [ms]"), Best)


def test_difference_counts_frames_in_common(study: Study) -> None:
    table = comparison_tables.difference_table(study.results("clean"), "inhand")
    assert [row[0] for row in table.rows] == ["fpfh+hs", "fpfh+mask"]
    # inhand solves frames 0, 1, 4; fpfh+hs 0, 2, 4.
    assert cell(table, "fpfh+hs", "frames") == "6"
    assert cell(table, "fpfh+hs", "only inhand right") == "1"
    assert cell(table, "fpfh+hs", "only this one right") == "1"
    assert cell(table, "fpfh+hs", "difference").startswith("0.0 (-")
    assert cell(table, "fpfh+mask", "difference").startswith("50.0 (")


def test_ablation_tells_the_gain_of_every_step(study: Study) -> None:
    steps = {m: summarise(r) for m, r in study.results("clean", ablation=True).items()}
    rows = comparison_tables.ablation_table(steps).rows
    assert [row[0] for row in rows] == ["ablation-baseline", "+ ablation-pairs"]
    assert rows[1][2] == "+75.0"


def test_perturbation_table_has_units(study: Study) -> None:
    table = comparison_tables.perturbation_table(study.perturbed)
    assert [row[1] for row in table.rows] == [f"translation {x} mm" for x in (0, 10, 20)]
    assert [row[3].split()[0] for row in table.rows] == ["100.0", "100.0", "0.0"]


def test_hand_and_time_tables(study: Study) -> None:
    pooled = {"inhand": summaries(study)["inhand"]}
    assert cell(comparison_tables.hand_table(pooled), "inhand", "joint angles [deg]") == "1.1 / 1.1"
    assert cell(comparison_tables.hand_table(pooled), "inhand", "as given [mm]") == "4.0 / 4.0"
    assert cell(comparison_tables.time_table(pooled), "inhand", "95 %") == "40.0"
    assert (
        cell(comparison_tables.stage_time_table(pooled), "hypotheses", "inhand")
        == "20.0 / 20.0 / 20.0"
    )
    assert cell(comparison_tables.lost_table(pooled), "inhand", "selection") == "3"
    assert cell(comparison_tables.alive_table(pooled), "inhand", "selection").startswith("100.0")
    assert cell(comparison_tables.confidence_table(pooled), "inhand", "AUROC").startswith("100.0")


def test_tables_in_markdown_and_html_escape_what_they_hold() -> None:
    table = Table("title", ("", "a|b"), (("x < y", Best("<b> & | c")),), "a note")
    text = tables.markdown(table, "A title")
    assert text.splitlines() == [
        "### A title",
        "",
        "|  | a\\|b |",
        "|---|---:|",
        "| x &lt; y | **&lt;b> & \\| c** |",
        "",
        "a note",
    ]
    page = tables.html(table)
    assert "<td><b>&lt;b&gt; &amp; | c</b></td>" in page
    assert "x &lt; y" in page


# --- sweeps


def swept() -> list[FrameResult]:
    """Six frames as they are; with noise, a third of them is right, and a third has no answer."""
    found = [pipeline(i, 0.001) for i in range(6)]
    for i, (adi, confidence) in enumerate([(0.001, 0.9), (0.02, 0.7), (0.02, 0.3)]):
        made = pipeline(i, adi, perturbation={"noise": 3.0})
        found.append(replace(made, confidence=confidence, seconds=0.1 * (i + 1)))
    found.append(replace(result(3), perturbation={"noise": 3.0}, outcome="unreadable", adi=None))
    found += [pipeline(i, None, perturbation={"noise": 1.0}) for i in range(2)]
    return found + [pipeline(i, 0.001, perturbation={"wall": 0.1}) for i in range(2)]


def test_a_sweep_as_a_table() -> None:
    table = sweep_table("set, method", "noise", swept())
    assert [row[0] for row in table.rows] == ["as it is", "1 x", "3 x"], "the levels in order"
    shown = dict(zip(table.columns[1:], table.rows[2][1:], strict=True))
    assert shown == {
        "frames": "3",
        "recall [%]": "33.3 (6-79)",
        "found [%]": "100",
        "median confidence": "0.70",
        "AUROC": "1.00",
        "sure but wrong [%]": "33",
        "median time [ms]": "200",
        "lost at": "selection 2",
    }
    nothing_found = dict(zip(table.columns[1:], table.rows[1][1:], strict=True))
    assert nothing_found["found [%]"] == "0"
    assert nothing_found["AUROC"] == "-"


def test_a_table_for_every_data_set_and_sweep() -> None:
    found = sweep_tables([*swept(), replace(result(0, data_set="b"), perturbation={"crop": 0.2})])
    assert [t.title for t in found] == [
        "b, inhand: crop",
        "clean, inhand: noise",
        "clean, inhand: wall",
    ]
    assert len(found[0].rows) == 1


def test_a_curve_starts_from_frames_as_they_are_where_they_have_a_place_on_it() -> None:
    noise, wall = curve("noise", swept()), curve("wall", swept())
    assert list(noise) == [0.0, 1.0, 3.0]
    assert [r.frame[-1] for r in noise[0.0]] == ["0", "1", "2", "3"], "the frames of the sweep"
    assert list(wall) == [0.1]
    assert curve("crop", swept()) == {}


def test_sweeps_are_apart_from_perturbed_starts(study: Study) -> None:
    assert list(study.swept) == ["inhand"]
    assert list(study.perturbed) == ["icp"]
    assert all(not r.perturbation for r in study.by_method["inhand"])


# --- figures and the page


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
