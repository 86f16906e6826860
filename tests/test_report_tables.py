"""Tables of made-up results, whose numbers are known."""

import pytest
from made_up_results import cell, study_of_everything, summaries

from inhand.evaluation import comparison_tables, tables
from inhand.evaluation.study import Study
from inhand.evaluation.summary import summarise
from inhand.evaluation.tables import Best, Table


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    return study_of_everything(tmp_path_factory.mktemp("run"))


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
