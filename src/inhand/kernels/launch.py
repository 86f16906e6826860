"""The one seam between kernels and devices: how a launch is spread over CPU cores or a GPU."""

import importlib
import itertools
import os
import pkgutil
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import warp as wp

import inhand.kernels
from inhand.errors import InputError

wp.config.log_level = wp.LOG_ERROR
wp.config.enable_backward = False

# Handing a slice to a pool thread costs about 0.15 ms, so only long launches are sliced.
SLICED_FROM_OPERATIONS = 60_000


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=cpu_count() - 1, thread_name_prefix="inhand")


@cache
def cpu_count() -> int:
    """Number of CPU cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def launch(
    kernel: Any, dim: int, inputs: Sequence[Any], device: str, *, work_per_item: int = 1
) -> None:
    """Run `kernel` for the work items 0..dim-1.

    Every kernel takes a last parameter `first: int`, the index of its first work item, which is
    appended here. Warp's CPU backend runs a launch on the calling thread and releases the GIL, so
    a long launch is cut into slices over a small thread pool. Slices write to disjoint outputs:
    results do not depend on the number of threads.

    Args:
        kernel: a Warp kernel whose last parameter is `first: int`.
        dim: number of work items.
        inputs: the kernel's arguments without `first`.
        device: Warp device name, "cpu" or "cuda:0".
        work_per_item: rough number of inner-loop operations of one item, to decide on slicing.
    """
    if dim <= 0:
        return
    slices = 1
    if device == "cpu" and dim * work_per_item >= SLICED_FROM_OPERATIONS:
        slices = min(dim, 2 * cpu_count()) if cpu_count() > 1 else 1
    if slices == 1:
        wp.launch(kernel, dim=dim, inputs=[*inputs, 0], device=device)
        return
    # Two threads that meet an unloaded module would both compile it.
    kernel.module.load(wp.get_device(device), block_dim=1)
    spans = list(itertools.pairwise(dim * i // slices for i in range(slices + 1)))
    jobs = [
        _pool().submit(wp.launch, kernel, dim=b - a, inputs=[*inputs, a], device=device)
        for a, b in spans
    ]
    # Rather than sleep, this thread does what no other has begun.
    for job, (a, b) in reversed(list(zip(jobs, spans, strict=True))):
        if job.cancel():
            wp.launch(kernel, dim=b - a, inputs=[*inputs, a], device=device)
    for job in jobs:
        if not job.cancelled():
            job.result()


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
            block = 1 if device == "cpu" else 256
            wp.get_module(module.__name__).load(wp.get_device(device), block_dim=block)
