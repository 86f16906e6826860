"""The one seam between kernels and devices: how a launch is spread over CPU cores or a GPU."""

import ctypes
import importlib
import itertools
import math
import os
import pkgutil
import struct
import threading
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, field
from functools import cache, partial
from queue import SimpleQueue
from typing import Any, TypeVar, get_type_hints

import numpy as np
import warp as wp
from numpy.typing import NDArray

import inhand.kernels
from inhand.errors import InputError

Slice = Callable[[], None]
"""A part of a launch that is ready to run."""

Item = TypeVar("Item")
Result = TypeVar("Result")

# What it takes to hand slices to another thread, in inner-loop operations of a kernel.
HANDOVER_OPERATIONS = 8_000

# Slices a thread takes on average: cores are not equally fast, nor is the work spread evenly.
SLICES_PER_THREAD = 4

# Threads that have an item each: more of them wait for Python's interpreter lock, and take longer.
MOST_ITEM_THREADS = 8

# To pack what Warp calls with: the first work item, and the bounds of a launch, see `_HostLaunch`.
INT, BOUNDS, BOUNDS_OF_BLOCKS = (struct.Struct(members).pack for members in ("i", "INN", "2INN"))

# Threads of a block.
CPU_BLOCK, GPU_BLOCK = 1, 128


@cache
def _idle_threads() -> "SimpleQueue[_Helper]":
    """Where this process's threads wait to be helpers; a pool's futures take longer to hand over
    than many a slice does to run."""
    wanted: SimpleQueue[_Helper] = SimpleQueue()
    for i in range(cpu_count() - 1):
        threading.Thread(target=_help, args=(wanted,), name=f"inhand-{i}", daemon=True).start()
    return wanted


if hasattr(os, "register_at_fork"):  # a forked process has no threads, and needs its own
    os.register_at_fork(after_in_child=_idle_threads.cache_clear)


@cache
def cpu_count() -> int:
    """Number of CPU cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def block_size(device: str) -> int:
    """Number of threads that run together on a device, and may share a work item."""
    return CPU_BLOCK if device == "cpu" else GPU_BLOCK


_thread = threading.local()


def on_all_cores(
    function: Callable[[Item], Result], items: Iterable[Item], device: str
) -> list[Result]:
    """`function` of every item, in order; on a CPU several cores have an item each.

    Launches by `function` are not sliced then: every core has its own.
    """
    if device != "cpu":
        return [function(item) for item in items]
    threads = min(cpu_count(), MOST_ITEM_THREADS)
    with ThreadPoolExecutor(threads, "inhand-items", keep_launches_whole) as pool:
        return list(pool.map(function, items))


def keep_launches_whole() -> None:
    """Leave the other cores to others: this thread's launches are not sliced from now on."""
    _thread.has_one_core = True


def launch(kernel: Any, dim: int, inputs: Sequence[Any], device: str, **how: Any) -> None:
    """`prepare` a launch and run it."""
    prepare(kernel, dim, inputs, device, **how)()


def computed(
    kernel: Any, shape: tuple[int, ...], dtype: Any, inputs: Sequence[Any], device: str, **how: Any
) -> NDArray[Any]:
    """What `launch` makes of a kernel that finds one value a work item.

    Args (beyond those of `prepare`):
        kernel: its last parameter before `first` is the flat array for the values.
        shape: of the work items and the values.
        dtype: Warp type of the values.
    """
    out = empty((math.prod(shape),), dtype, device)
    launch(kernel, len(out), [*inputs, out], device, **how)
    values = on_host(out)
    return values.reshape(*shape, *values.shape[1:])


def prepare(
    kernel: Any,
    dim: int,
    inputs: Sequence[Any],
    device: str,
    *,
    work_per_item: int = 1,
    shared: bool = False,
) -> Callable[[], None]:
    """A launch of `kernel` for the work items 0..dim-1, to be run as often as one likes.

    Packing the arguments takes longer than a short launch, so what is repeated is prepared once.

    Every kernel takes a last parameter `first: int`, the index of its first work item, which is
    appended here. Warp's CPU backend runs a launch on the calling thread and releases the GIL, so
    a long launch is cut into slices, which it and idle threads take as they come. Slices write to
    disjoint outputs: results do not depend on the number of threads.

    Args:
        kernel: a Warp kernel whose last parameter is `first: int`.
        dim: number of work items.
        inputs: the kernel's arguments without `first`.
        device: Warp device name, "cpu" or "cuda:0".
        work_per_item: rough number of inner-loop operations of one item, to decide on slicing.
        shared: whether the threads of a block share a work item, see `kernels.block`.
    """
    if dim <= 0:
        return lambda: None
    threads = 1
    if device == "cpu" and not getattr(_thread, "has_one_core", False):
        # n threads take work / n + n handovers, which is least at:
        best = math.isqrt(dim * work_per_item // HANDOVER_OPERATIONS)
        threads = max(1, min(dim, cpu_count(), best))
    block = (block_size(device),) if shared else ()
    known = _known_launch(kernel, (dim, *block), [*inputs, 0], device)
    assert kernel.adj.kernel_dim == 1 + shared, f"{kernel.key}: `shared` does not fit its wp.tid()"
    slices = min(dim, SLICES_PER_THREAD * threads) if threads > 1 else 1
    ends = [dim * i // slices for i in range(slices + 1)]
    # What runs holds the addresses of the arrays in `inputs`, which must live as long.
    return partial(_run, known.slices(ends, block, inputs), threads, inputs)


_known: dict[Any, "_HostLaunch | _DeviceLaunch"] = {}
_loading = threading.Lock()


def _known_launch(
    kernel: Any, dims: tuple[int, ...], inputs: Sequence[Any], device: str
) -> "_HostLaunch | _DeviceLaunch":
    """How a kernel is launched with arguments of the kinds of these.

    To prepare a launch takes Warp 37 us, most of it for finding out how to pass what is passed, so
    this is kept of the first.
    """
    key = kernel, device, block_size(device), *map(_kind, inputs)
    known = _known.get(key)
    if known is None:
        with _loading:  # two threads that load a module at once are left with one that is gone
            first = _recorded(kernel, dims, inputs, device)
        known = _HostLaunch(first, inputs) if device == "cpu" else _DeviceLaunch(first)
        _known[key] = known
    return known


def _recorded(kernel: Any, dims: tuple[int, ...], inputs: Sequence[Any], device: str) -> Any:
    """A launch as Warp records it, its arguments checked."""
    block = block_size(device)
    command = wp.launch(kernel, dims, inputs, device=device, record_cmd=True, block_dim=block)
    command.fwd_args = None  # these arrays need not live on
    for packed, wanted in zip(command.params[1:], kernel.adj.args, strict=True):
        # Of arrays that are NumPy's, Warp does not check this.
        same = getattr(packed, "ndim", 0) == getattr(wanted.type, "ndim", 0)
        assert same, f"{kernel.key}: {wanted.label} has other dimensions"
    return command


def _kind(value: Any) -> Any:
    """What decides how an argument is packed."""
    if isinstance(value, np.ndarray):
        return value.dtype, value.shape[1:], value.strides
    return (value.dtype, value.ndim) if isinstance(value, wp.array) else type(value)


class _DeviceLaunch:
    """How a kernel is launched on a GPU with arguments of certain kinds."""

    def __init__(self, first: Any) -> None:
        self._first = first

    def slices(self, ends: list[int], block: tuple[int, ...], inputs: Sequence[Any]) -> list[Slice]:
        """The one slice that there is."""
        command = copy(self._first)
        values = map(_as_c, [*inputs, 0], map(type, self._first.params[1:]))
        command.params = [self._first.bounds, *values]
        addresses = map(ctypes.addressof, command.params)
        command.params_addr = type(self._first.params_addr)(*addresses)
        command.set_dim((ends[-1], *block))
        return [command.launch]


class _HostLaunch:
    """How a kernel is launched on the CPU with arguments of certain kinds.

    What Warp calls takes the addresses of the launch's bounds and of one structure of all
    arguments. To fill these by `struct` takes a fraction of what it takes by `ctypes`.
    """

    def __init__(self, first: Any, inputs: Sequence[Any]) -> None:
        takes_bytes = ctypes.CFUNCTYPE(None, ctypes.c_char_p, ctypes.c_char_p)
        self._function = ctypes.cast(first.hooks.forward, takes_bytes)
        self._module = first.module_exec  # what is loaded lives as long as this
        *layouts, _first = map(_layout_in_memory, inputs, first.params[1:])
        formats, self._values = zip(*layouts, strict=True)
        self._pack = struct.Struct("".join(formats) + "0i").pack

    def slices(self, ends: list[int], block: tuple[int, ...], inputs: Sequence[Any]) -> list[Slice]:
        """Launches of the work items between each two of `ends`; `block`: its threads, if any."""
        pairs = zip(self._values, inputs, strict=True)
        packed = self._pack(*[value for values, given in pairs for value in values(given)])
        # Warp's `launch_bounds_t`: sizes, number of items, and of threads that share coordinates.
        bounds, threads = (BOUNDS_OF_BLOCKS if block else BOUNDS), math.prod(block)
        return [
            partial(
                self._function,
                bounds(end - first, *block, (end - first) * threads, 1),
                packed + INT(first),
            )
            for first, end in itertools.pairwise(ends)
        ]


def _layout_in_memory(given: Any, packed: Any) -> tuple[str, Callable[[Any], tuple[Any, ...]]]:
    """For arguments of the kind of one that Warp has packed: format and values for `struct`."""
    kind, size = type(packed), ctypes.sizeof(packed)
    if isinstance(packed, ctypes._SimpleCData):
        return kind._type_, lambda number: (number,)
    aligned = {1: "0b", 2: "0h", 4: "0i", 8: "0q"}[ctypes.alignment(kind)]
    if not isinstance(given, np.ndarray):
        return f"{aligned}{size}s", lambda value: (bytes(_as_c(value, kind)),)
    # Arrays of a kind differ in their address, which comes first, and in their length.
    before, length = bytes(packed)[8 : kind.shape.offset], kind.shape.offset
    after = bytes(packed)[length + 4 :]
    return (
        f"{aligned}Q{len(before)}si{len(after)}s",
        lambda array: (array.ctypes.data, before, len(array), after),
    )


def _as_c(value: Any, kind: Any) -> Any:
    """An argument that is no NumPy array as the `ctypes` object that a kernel takes."""
    if hasattr(value, "__ctype__"):
        return value.__ctype__()
    return value if isinstance(value, kind) else kind(value)


@dataclass(slots=True)
class _Helper:
    """What another thread runs of a launch, if it finds the time before all is begun."""

    left: deque[Slice]
    inputs: Sequence[Any]  # live as long as this
    working: threading.Lock = field(default_factory=threading.Lock)
    error: Exception | None = None

    def run(self) -> None:
        with self.working:
            try:
                _drain(self.left)
            except Exception as error:
                self.error = error

    def join(self) -> None:
        """Wait for what has begun; nothing is left for what has not."""
        with self.working:
            if self.error:
                raise self.error


def _help(wanted: "SimpleQueue[_Helper]") -> None:
    while True:
        wanted.get().run()


def _run(slices: list[Slice], threads: int, inputs: Sequence[Any]) -> None:
    """Run slices, which may run at the same time, on this thread and others."""
    left = deque(slices)
    helpers = [_Helper(left, inputs) for _ in range(threads - 1)]
    for helper in helpers:
        _idle_threads().put(helper)
    try:
        _drain(left)
    finally:  # when this is interrupted, too, nothing may use the arrays any more
        left.clear()
        for helper in helpers:
            helper.join()


def _drain(left: deque[Slice]) -> None:
    """Run the slices that no thread has begun."""
    with suppress(IndexError):  # none is left
        while True:
            left.pop()()


def empty(shape: tuple[int, ...], dtype: Any, device: str) -> Any:
    """An array of values of a Warp type for kernels to fill; NumPy's on a CPU, which is made ten
    times faster."""
    if not _takes_numpy(device):
        return wp.empty(shape, dtype=dtype, device=device)
    scalar, of_value = _layout(dtype)
    return np.empty(shape + of_value, scalar)


def filled(shape: tuple[int, ...], value: Any, dtype: Any, device: str) -> Any:
    """As `empty`, with a value everywhere."""
    array = empty(shape, dtype, device)
    fill = array.fill if isinstance(array, np.ndarray) else array.fill_
    fill(value)
    return array


def copied(array: Any) -> Any:
    """A copy of an array that is on a device."""
    return array.copy() if isinstance(array, np.ndarray) else wp.clone(array)


def on_device(values: Any, dtype: Any, device: str) -> Any:
    """A NumPy array, (n, *shape of a `dtype`), for a launch; on a CPU it sees the array's own
    memory, and writes there what it writes."""
    if not _takes_numpy(device):
        return wp.array(values, dtype=dtype, device=device)
    return np.ascontiguousarray(values, _layout(dtype)[0])


def in_struct(values: Any, dtype: Any, device: str) -> Any:
    """As `on_device`, for a member of a Warp struct."""
    is_there = isinstance(values, wp.array)
    return values if is_there else wp.array(values, dtype=dtype, device=device, copy=False)


def assign(array: Any, values: NDArray[Any]) -> None:
    """Write over the values of an array that is on a device."""
    if isinstance(array, np.ndarray):
        array[...] = values
    else:
        array.assign(values)


def on_host(values: Any) -> NDArray[Any]:
    """What kernels have written, as a NumPy array."""
    return values if isinstance(values, np.ndarray) else values.numpy()


def _takes_numpy(device: str) -> bool:
    """Whether launches take NumPy arrays as they are."""
    return device == "cpu"


@cache
def _layout(dtype: Any) -> tuple[Any, tuple[int, ...]]:
    """NumPy type and shape of a value of a Warp type."""
    value = wp.empty(1, dtype=dtype, device="cpu").numpy()
    return value.dtype, value.shape[1:]


def pack(struct: Any, device: str, **values: Any) -> Any:
    """A Warp struct on a device; values that it has no member for are left out."""
    filled = struct()
    for name, kind in get_type_hints(struct.cls).items():
        value = values[name]
        if isinstance(kind, wp.array):
            value = in_struct(value, kind.dtype, device)
        setattr(filled, name, value)
    return filled


def resolve_device(device: str | None) -> str:
    """The Warp device for `device`; None picks a CUDA GPU when there is one, else the CPU.

    Raises:
        InputError: the device does not exist on this machine.
    """
    wp.init()
    if device is None:
        return "cuda:0" if wp.is_cuda_available() else "cpu"
    try:
        return str(wp.get_device(device).alias)
    except Exception as error:
        known = ", ".join(str(d) for d in wp.get_devices())
        raise InputError(f'there is no device "{device}" here; available: {known}') from error


def load_all_kernels(device: str, progress: Callable[[str], None] = lambda name: None) -> None:
    """Compile or load every kernel for `device`, so that no later call has to.

    Args:
        device: Warp device name.
        progress: called with the name of every kernel module before it is compiled.
    """
    modules = sorted(m.name for m in pkgutil.iter_modules(inhand.kernels.__path__))
    for name in modules:
        module = importlib.import_module(f"inhand.kernels.{name}")
        if any(isinstance(value, wp.Kernel) for value in vars(module).values()):
            progress(name)
            kernels = wp.get_module(module.__name__)
            with _loading:
                kernels.load(wp.get_device(device), block_dim=block_size(device))
