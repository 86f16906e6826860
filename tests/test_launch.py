import ctypes
import gc
import os
import re
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from probe_kernels import write_index

import inhand.kernels
from inhand.errors import InputError
from inhand.kernels import launch as seam
from inhand.kernels.launch import (
    cpu_count,
    empty,
    launch,
    load_all_kernels,
    on_all_cores,
    on_device,
    on_host,
    prepare,
    resolve_device,
)

LONG = 10**6
"""Operations of a work item that are worth slices."""


def indices(dim: int, size: int, work_per_item: int) -> np.ndarray:
    """What a launch over 0..dim-1 leaves in an array of `size` zeros."""
    out = wp.zeros(size, dtype=int, device="cpu")
    launch(write_index, dim, [out], "cpu", work_per_item=work_per_item)
    return out.numpy()


@given(st.integers(0, 40) | st.integers(0, 3000), st.sampled_from([1, LONG]))
@settings(max_examples=50, deadline=None)
def test_every_item_runs_exactly_once(dim: int, work_per_item: int) -> None:
    expected = np.where(np.arange(dim + 5) < dim, np.arange(dim + 5) + 1, 0)
    np.testing.assert_array_equal(indices(dim, dim + 5, work_per_item), expected)


@pytest.fixture
def launches(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Sizes of the slices of launches that are run, on a machine of three cores."""
    sizes: list[int] = []
    slices = seam._HostLaunch.slices

    def run(size: int, part: seam.Slice) -> None:
        sizes.append(size)
        part()

    def recorded(known: Any, ends: list[int], *how: Any) -> list[seam.Slice]:
        parts = zip(np.diff(ends).tolist(), slices(known, ends, *how), strict=True)
        return [partial(run, size, part) for size, part in parts]

    monkeypatch.setattr(seam._HostLaunch, "slices", recorded)
    monkeypatch.setattr(seam, "cpu_count", lambda: 3)
    return sizes


def run_in_slices(part: seam.Slice, monkeypatch: pytest.MonkeyPatch) -> None:
    """Launches run `part` in place of every slice from now on."""
    monkeypatch.setattr(
        seam._HostLaunch, "slices", lambda _known, ends, *_how: [part] * (len(ends) - 1)
    )


@pytest.mark.parametrize("dim", [1, 2, 11, 12, 13, 1000])
def test_long_launches_are_cut_into_even_slices(launches: list[int], dim: int) -> None:
    np.testing.assert_array_equal(indices(dim, dim, LONG), np.arange(dim) + 1)
    assert sum(launches) == dim
    assert len(launches) == min(dim, 3 * seam.SLICES_PER_THREAD)
    assert max(launches) - min(launches) <= 1


def test_short_launches_are_not_cut(launches: list[int]) -> None:
    indices(100, 100, 1)
    assert launches == [100]


@pytest.mark.parametrize(("handovers", "threads"), [(3, 1), (4, 2), (9, 3), (17, 4), (900, 16)])
def test_threads_are_as_many_as_end_a_launch_soonest(
    launches: list[int], monkeypatch: pytest.MonkeyPatch, handovers: int, threads: int
) -> None:
    monkeypatch.setattr(seam, "cpu_count", lambda: 16)
    indices(640, 640, handovers * seam.HANDOVER_OPERATIONS // 640 + 1)
    assert len(launches) == (1 if threads == 1 else threads * seam.SLICES_PER_THREAD)


@pytest.mark.parametrize("work_per_item", [1, LONG])
def test_a_prepared_launch_can_be_repeated(work_per_item: int) -> None:
    out = wp.zeros(100, dtype=int, device="cpu")
    run = prepare(write_index, 100, [out], "cpu", work_per_item=work_per_item)
    np.testing.assert_array_equal(out.numpy(), 0)
    for _ in range(2):
        out.zero_()
        run()
        np.testing.assert_array_equal(out.numpy(), np.arange(100) + 1)


def test_items_on_all_cores_keep_their_launches_whole(launches: list[int]) -> None:
    found = on_all_cores(lambda dim: indices(dim, dim, LONG).sum(), [3, 4, 5, 6], "cpu")
    assert found == [6, 10, 15, 21]
    assert sorted(launches) == [3, 4, 5, 6]


FORKED = """
import multiprocessing
import threading

import numpy as np
from probe_kernels import write_index

from inhand.kernels import launch as seam

seam.cpu_count = lambda: 3

def helpers(_):
    out = np.zeros(100, np.int32)
    seam.launch(write_index, 100, [out], "cpu", work_per_item=10**6)
    assert (out == np.arange(1, 101)).all()
    return [t.name for t in threading.enumerate() if t.name.startswith("inhand")]

assert helpers(0)
with multiprocessing.get_context("fork").Pool(1) as pool:
    assert pool.apply(helpers, [0])
"""


def test_no_slice_runs_on_when_a_launch_is_interrupted(
    launches: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    caller, another_began = threading.current_thread(), threading.Event()
    ended: list[float] = []

    def slow() -> None:
        if threading.current_thread() is caller:
            assert another_began.wait(60)
            raise KeyboardInterrupt
        another_began.set()
        time.sleep(0.05)
        ended.append(time.monotonic())

    run_in_slices(slow, monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        indices(1000, 1000, LONG)
    interrupted = time.monotonic()
    time.sleep(0.2)
    assert 0 < len(ended) < 3 * seam.SLICES_PER_THREAD - 1
    assert max(ended) <= interrupted, "it would use arrays that may be gone"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
def test_a_forked_process_has_threads_of_its_own() -> None:
    script = [sys.executable, "-W", "ignore", "-c", FORKED]
    assert subprocess.run(script, cwd=Path(__file__).parent).returncode == 0


UNLOADED = """
import gc

import numpy as np
from probe_kernels import write_index

from inhand.kernels.launch import launch

for _ in range(2):
    out = np.zeros(9, np.int32)
    launch(write_index, 9, [out], "cpu")
    assert (out == np.arange(1, 10)).all()
    write_index.module.unload()
    gc.collect()
"""


def test_kernels_run_after_warp_has_unloaded_their_module() -> None:
    script = [sys.executable, "-W", "ignore", "-c", UNLOADED]
    assert subprocess.run(script, cwd=Path(__file__).parent).returncode == 0


def test_nothing_to_do_is_no_launch(launches: list[int]) -> None:
    for dim in (0, -1):
        np.testing.assert_array_equal(indices(dim, 3, LONG), 0)
    assert launches == []


@pytest.mark.parametrize("work_per_item", [1, LONG])
def test_errors_reach_the_caller(work_per_item: int) -> None:
    with pytest.raises(RuntimeError, match="write_index"):
        launch(write_index, 10, [], "cpu", work_per_item=work_per_item)


def test_errors_in_another_thread_reach_the_caller_each_time(
    launches: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    caller, failed = threading.current_thread(), threading.Event()

    def fail() -> None:
        if threading.current_thread() is caller:
            assert failed.wait(60)
        else:
            failed.set()
            raise OSError("no such slice")

    run_in_slices(fail, monkeypatch)
    for _ in range(seam.cpu_count() + 1):
        failed.clear()
        with pytest.raises(OSError, match="no such slice"):
            indices(1000, 1000, LONG)


@pytest.mark.parametrize("wrong", [{"dtype": float}, {"dtype": int, "ndim": 2}])
def test_arguments_are_checked_also_after_right_ones(wrong: dict[str, Any]) -> None:
    np.testing.assert_array_equal(indices(3, 3, 1), [1, 2, 3])
    size = (3,) * wrong.pop("ndim", 1)
    with pytest.raises(RuntimeError, match="expects an array"):
        launch(write_index, 3, [wp.zeros(size, device="cpu", **wrong)], "cpu")


@pytest.mark.parametrize(
    "zeros",
    [lambda n: wp.zeros(n, dtype=int, device="cpu"), lambda n: np.zeros(n, dtype=np.int32)],
    ids=["warp", "numpy"],
)
def test_a_later_launch_has_arguments_and_size_of_its_own(zeros: Callable[[int], Any]) -> None:
    arrays = [zeros(n) for n in (4, 7)]
    runs = [prepare(write_index, len(a), [a], "cpu") for a in arrays]
    for run in reversed(runs):
        run()
    for array in arrays:
        np.testing.assert_array_equal(on_host(array), np.arange(len(array)) + 1)


def test_every_second_number_of_a_numpy_array_is_told_from_a_whole_one() -> None:
    whole = np.zeros(8, np.int32)
    for array in (np.zeros(4, np.int32), whole[::2]):
        launch(write_index, 4, [array], "cpu")
    np.testing.assert_array_equal(whole, [1, 0, 2, 0, 3, 0, 4, 0])


@pytest.mark.parametrize("wrong", [np.zeros(3, np.float32), np.zeros((3, 3), np.int32)])
def test_numpy_arrays_are_checked_also_after_right_ones(wrong: np.ndarray) -> None:
    launch(write_index, 3, [np.zeros(3, np.int32)], "cpu")
    with pytest.raises((RuntimeError, AssertionError), match=r"array|other dimensions"):
        launch(write_index, 3, [wrong], "cpu")
    assert not wrong.any()


@given(
    st.sampled_from([(wp.vec3, (3,)), (wp.mat44, (4, 4)), (int, ()), (wp.float64, ())]),
    st.integers(0, 5),
    st.booleans(),
)
def test_arrays_for_kernels_hold_what_they_are_given(
    kind: tuple[Any, tuple[int, ...]], count: int, other_order: bool
) -> None:
    dtype, of_value = kind
    values = np.random.default_rng(count).integers(0, 9, (count, *of_value)).astype(np.float64)
    if other_order:
        values = np.asfortranarray(values)
    given = on_device(values, dtype, "cpu")
    assert given.flags.c_contiguous
    np.testing.assert_array_equal(given, values)
    filled = empty((count,), dtype, "cpu")
    assert (filled.shape, filled.dtype) == (given.shape, given.dtype)
    np.testing.assert_array_equal(wp.array(given, dtype=dtype, device="cpu").numpy(), values)


def test_arguments_live_no_longer_than_the_launch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(seam, "_known", {})  # so that this launch is the first
    out = wp.zeros(3, dtype=int, device="cpu")
    alive = weakref.ref(out)
    run = prepare(write_index, 3, [out], "cpu")
    del out
    assert alive() is not None
    run()
    del run
    gc.collect()
    assert alive() is None


def test_launches_as_a_gpu_has_them(monkeypatch: pytest.MonkeyPatch) -> None:
    def with_addresses(first: Any, _inputs: Any) -> seam._DeviceLaunch:
        first.params_addr = (ctypes.c_void_p * len(first.params))()
        return seam._DeviceLaunch(first)

    monkeypatch.setattr(seam, "_known", {})
    monkeypatch.setattr(seam, "_HostLaunch", with_addresses)
    for dim in (3, 7):
        np.testing.assert_array_equal(indices(dim, 9, 1), [*range(1, dim + 1), *[0] * (9 - dim)])
    (known,) = seam._known.values()
    out = wp.zeros(5, dtype=int, device="cpu")
    (run,) = known.slices([0, 5], (), [out])
    command = run.__self__  # type: ignore[attr-defined]
    assert list(command.params_addr) == [ctypes.addressof(p) for p in command.params]


def test_all_kernel_modules_are_loaded() -> None:
    assert inhand.kernels.__file__ is not None
    sources = Path(inhand.kernels.__file__).parent.glob("*.py")
    expected = sorted(
        path.stem for path in sources if re.search("^@wp.kernel", path.read_text(), re.MULTILINE)
    )
    names: list[str] = []
    load_all_kernels("cpu", names.append)
    assert names == expected
    assert len(names) > 5


def test_there_is_a_core() -> None:
    assert cpu_count() >= 1


def test_the_best_device_is_the_default() -> None:
    assert resolve_device("cpu") == "cpu"
    assert resolve_device(None) == ("cuda:0" if wp.is_cuda_available() else "cpu")


@pytest.mark.parametrize("device", ["cuda:99", "toaster", ""])
def test_unknown_devices_are_refused(device: str) -> None:
    with pytest.raises(InputError, match=f'no device "{device}" here; available: .*cpu'):
        resolve_device(device)
