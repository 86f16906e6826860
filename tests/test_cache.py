from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from inhand import cache


class Builder:
    """Counts how often it builds."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self) -> dict[str, NDArray[Any]]:
        self.calls += 1
        return {"values": np.arange(6.0).reshape(2, 3), "index": np.array([1, 2], dtype=np.int32)}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("INHAND_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


def assert_built(arrays: dict[str, NDArray[Any]]) -> None:
    assert set(arrays) == {"values", "index"}
    np.testing.assert_array_equal(arrays["values"], np.arange(6.0).reshape(2, 3))
    assert arrays["index"].dtype == np.int32


def test_second_call_reads_what_the_first_built(folder: Path) -> None:
    build = Builder()
    assert_built(cache.cached(["thing", 1, 0.5, b"raw"], build))
    assert_built(cache.cached(["thing", 1, 0.5, b"raw"], build))
    assert build.calls == 1
    assert [p.suffix for p in folder.iterdir()] == [".npz"]


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (["a", "b"], ["ab"]),
        (["a", "b"], ["b", "a"]),
        ([1], [1.0]),
        (["a"], [b"a"]),
        ([0.1], [0.1 + 1e-12]),
    ],
)
def test_different_keys_do_not_meet(one: list[Any], other: list[Any]) -> None:
    build = Builder()
    cache.cached(one, build)
    cache.cached(other, build)
    assert build.calls == 2


def test_new_format_version_builds_again(monkeypatch: pytest.MonkeyPatch) -> None:
    build = Builder()
    cache.cached(["k"], build)
    monkeypatch.setattr(cache, "FORMAT_VERSION", cache.FORMAT_VERSION + 1)
    cache.cached(["k"], build)
    assert build.calls == 2


@pytest.mark.parametrize("damage", [b"", b"no zip at all", None])
def test_corrupt_file_is_rebuilt(folder: Path, damage: bytes | None) -> None:
    build = Builder()
    cache.cached(["k"], build)
    (path,) = folder.iterdir()
    path.write_bytes(path.read_bytes()[:100] if damage is None else damage)
    assert_built(cache.cached(["k"], build))
    assert_built(cache.cached(["k"], build))
    assert build.calls == 2


def test_unwritable_cache_only_costs_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("INHAND_CACHE_DIR", str(tmp_path / "file" / "cache"))
    build = Builder()
    assert_built(cache.cached(["k"], build))
    assert_built(cache.cached(["k"], build))
    assert build.calls == 2


def test_failed_write_leaves_nothing_behind(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full_disk(*_args: Any, **_kwargs: Any) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(np, "savez", full_disk)
    assert_built(cache.cached(["k"], Builder()))
    assert list(folder.iterdir()) == []


def test_default_folder_is_in_the_home_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("INHAND_CACHE_DIR")
    assert cache.cache_folder().parts[-2:] == (".cache", "inhand")


@dataclass
class Whole:
    values: NDArray[Any]
    size: float
    axis: NDArray[Any] | None


@pytest.mark.parametrize("axis", [None, np.array([0.0, 0.0, 1.0])])
def test_what_is_taken_apart_is_put_together_again(axis: NDArray[Any] | None) -> None:
    one, other = Whole(np.arange(3), 0.5, axis), Whole(np.zeros((2, 0)), 2.0, None)
    arrays = cache.cached(["wholes"], lambda: cache.taken_apart(one=one, other=other))
    arrays = cache.cached(["wholes"], dict)
    for name, whole in (("one", one), ("other", other)):
        found = cache.put_together(Whole, name, arrays)
        np.testing.assert_array_equal(found.values, whole.values)
        assert type(found.size) is float
        assert found.size == whole.size
        np.testing.assert_array_equal(found.axis, whole.axis)
