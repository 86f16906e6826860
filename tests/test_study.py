"""Results of several runs as one study."""

from pathlib import Path

import pytest
from made_up_results import SETTINGS, pipeline, result, write

from inhand.errors import InputError
from inhand.evaluation.make_report import make_report
from inhand.evaluation.page import describe_run
from inhand.evaluation.results import Ledger, read_results
from inhand.evaluation.study import Study, by_quantity, load_study


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
