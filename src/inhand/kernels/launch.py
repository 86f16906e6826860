"""The one seam between kernels and devices: how a launch is spread over CPU cores or a GPU."""

import ctypes
import importlib
import itertools
import math
import os
import pkgutil
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

Item = TypeVar("Item")
Result = TypeVar("Result")

# What it takes to hand slices to another thread, in inner-loop operations of a kernel.
HANDOVER_OPERATIONS = 8_000

# Slices a thread takes on average: cores are not equally fast, nor is the work spread evenly.
SLICES_PER_THREAD = 4

# Threads that have an item each: more of them wait for Python's interpreter lock, and take longer.
MOST_ITEM_THREADS = 8

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
    whole = _command(kernel, (dim, *block), [*inputs, 0], device)
    assert kernel.adj.kernel_dim == 1 + shared, f"{kernel.key}: `shared` does not fit its wp.tid()"
    # Commands hold the addresses of the arrays in `inputs`, which must live as long.
    if threads == 1:
        return partial(_run, [whole], 1, inputs)
    slices = min(dim, SLICES_PER_THREAD * threads)
    spans = itertools.pairwise(dim * i // slices for i in range(slices + 1))
    return partial(_run, [whole.part(a, (b - a, *block)) for a, b in spans], threads, inputs)


_first_commands: dict[Any, Any] = {}
_loading = threading.Lock()


def _command(kernel: Any, dims: tuple[int, ...], inputs: Sequence[Any], device: str) -> Any:
    """As `wp.launch` records it; in a third of the time where it has seen arguments of these kinds.

    A launch of a kernel takes Warp 37 us, most of it for finding out how to pass what is passed.
    """
    block = block_size(device)
    key = kernel, device, block, *map(_kind, inputs)
    first = _first_commands.get(key)
    if first is None:
        with _loading:  # two threads that load a module at once are left with one that is gone
            first = _first_commands[key] = _checked_command(kernel, dims, inputs, device)
    values = map(_packed, inputs, first.params[1:])
    if device == "cpu" and block == 1:
        return _HostCommand(first.hooks.forward, type(first.bounds)(dims), first.arguments(*values))
    command = copy(first)
    command.params = [first.bounds, *values]
    if command.params_addr is not None:
        command.params_addr = type(first.params_addr)(*map(ctypes.addressof, command.params))
    command.set_dim(dims)
    return command


def _checked_command(kernel: Any, dims: tuple[int, ...], inputs: Sequence[Any], device: str) -> Any:
    """The launch as Warp records it, with the type of a structure of its arguments."""
    block = block_size(device)
    command = wp.launch(kernel, dims, inputs, device=device, record_cmd=True, block_dim=block)
    command.fwd_args = None  # these arrays need not live on
    packed = command.params[1:]
    for value, wanted in zip(packed, kernel.adj.args, strict=True):
        # Of arrays that are NumPy's, Warp does not check this.
        same = getattr(value, "ndim", 0) == getattr(wanted.type, "ndim", 0)
        assert same, f"{kernel.key}: {wanted.label} has other dimensions"
    fields = [(f"a{i}", type(value)) for i, value in enumerate(packed)]
    command.arguments = type("Arguments", (ctypes.Structure,), {"_fields_": fields})
    return command


def _kind(value: Any) -> Any:
    """What decides how an argument is packed."""
    if isinstance(value, np.ndarray):
        return value.dtype, value.shape[1:], value.strides
    return (value.dtype, value.ndim) if isinstance(value, wp.array) else type(value)


def _packed(value: Any, like: Any) -> Any:
    """An argument as a kernel takes it, of the type of one that was packed before."""
    if isinstance(value, np.ndarray):
        packed = type(like).from_buffer_copy(like)
        packed.data = value.__array_interface__["data"][0]
        packed.shape[0] = len(value)
        return packed
    if hasattr(value, "__ctype__"):
        return value.__ctype__()
    return value if isinstance(value, type(like)) else type(like)(value)


@dataclass(slots=True)
class _HostCommand:
    """A launch on the CPU: what Warp calls in the end, without what it looks up before each."""

    function: Callable[[Any, Any], None]
    bounds: Any
    arguments: Any

    def launch(self) -> None:
        self.function(ctypes.byref(self.bounds), ctypes.byref(self.arguments))

    def part(self, first: int, dims: tuple[int, ...]) -> "_HostCommand":
        """As many of the work items from `first` on; packing them anew takes longer."""
        arguments = type(self.arguments).from_buffer_copy(self.arguments)
        setattr(arguments, arguments._fields_[-1][0], first)
        return _HostCommand(self.function, type(self.bounds)(dims), arguments)


@dataclass(slots=True)
class _Helper:
    """What another thread runs of a launch, if it finds the time before all is begun."""

    left: deque[Any]
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


def _run(commands: Sequence[Any], threads: int, inputs: Sequence[Any]) -> None:
    """Run commands that may run at the same time, on this thread and others."""
    left = deque(commands)
    helpers = [_Helper(left, inputs) for _ in range(threads - 1)]
    for helper in helpers:
        _idle_threads().put(helper)
    try:
        _drain(left)
    finally:  # when this is interrupted, too, nothing may use the arrays any more
        left.clear()
        for helper in helpers:
            helper.join()


def _drain(left: deque[Any]) -> None:
    """Run the commands that no thread has begun."""
    with suppress(IndexError):  # none is left
        while True:
            left.pop().launch()


def empty(shape: tuple[int, ...], dtype: Any, device: str) -> Any:
    """An array of values of a Warp type for kernels to fill; NumPy's on a CPU, which is made ten
    times faster."""
    if not _takes_numpy(device):
        return wp.empty(shape, dtype=dtype, device=device)
    scalar, of_value = _layout(dtype)
    return np.empty(shape + of_value, scalar)


def on_device(values: Any, dtype: Any, device: str) -> Any:
    """A NumPy array, (n, *shape of a `dtype`), for a launch; on a CPU it sees the array's own
    memory, and writes there what it writes."""
    if not _takes_numpy(device):
        return wp.array(values, dtype=dtype, device=device)
    return np.ascontiguousarray(values, _layout(dtype)[0])


def in_struct(values: Any, dtype: Any, device: str) -> Any:
    """As `on_device`, for a member of a Warp struct."""
    return wp.array(values, dtype=dtype, device=device, copy=False)


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
            value = wp.array(value, dtype=kind.dtype, device=device)
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
