"""`inhand warmup`: compile all kernels ahead of the first estimate."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Warmup:
    """Compile all kernels now, so that the first estimate does not wait for it."""

    device: str | None = None
    """What to compile for, such as cpu or cuda:0. Default: the best there is."""


def run(args: Warmup) -> None:
    """Compile the kernels and say so."""
    from rich.console import Console

    from inhand.cli.common import load_kernels
    from inhand.kernels.launch import resolve_device

    console = Console()
    device = resolve_device(args.device)
    load_kernels(device, console)
    console.print(f"Kernels for {device} are ready")
