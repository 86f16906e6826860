"""`inhand warmup`: compile all kernels ahead of the first estimate."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Warmup:
    """Compile all kernels now, so that the first image does not wait for it."""

    device: str | None = None
    """What to compile for, such as cpu or cuda:0. Default: the best there is."""


def run(args: Warmup) -> None:
    """Compile the kernels and say so."""
    import warp as wp
    from rich.console import Console

    from inhand.cli.common import load_kernels, waiting
    from inhand.kernels.launch import block_size, resolve_device
    from inhand.tracking import kernels as of_tracker

    console = Console()
    device = resolve_device(args.device)
    load_kernels(device, console)
    with waiting(console, "Loading the tracker's kernels"):
        wp.load_module(of_tracker, device=device, block_dim=block_size(device))
    console.print(f"Kernels for {device} are ready")
