"""What made a result: the command, the commit, the machine and the versions."""

import os
import platform
import shlex
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import warp as wp

import inhand

_LIBRARIES = (
    *("numpy", "scipy", "warp-lang"),
    *("open3d", "opencv-contrib-python-headless", "kiss_matcher"),
)


def origin(device: str) -> dict[str, str]:
    """Where the results of this process come from, in words by what they tell.

    Args:
        device: Warp device that the kernels run on.
    """
    return {
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "commit": commit() or "not in a repository",
        "processor": processor(),
        **({"gpu": str(wp.get_device(device).name)} if device.startswith("cuda") else {}),
        "memory": memory(),
        "system": f"{platform.system()} {platform.machine()}",
        "versions": ", ".join(
            [f"inhand {inhand.__version__}", f"Python {platform.python_version()}", *_versions()]
        ),
    }


def commit() -> str | None:
    """Hash of the source's commit, with a remark when files differ from it; None without one."""
    folder = Path(inhand.__file__).parent
    # The package may be installed inside of someone else's repository.
    if _git(folder, "ls-files", "--error-unmatch", "__init__.py") is None:
        return None
    head = _git(folder, "rev-parse", "--short=12", "HEAD")
    changed = _git(folder, "status", "--porcelain", "--untracked-files=no", ".")
    return f"{head} with changes" if head and changed else head


def _git(folder: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *arguments], capture_output=True, text=True, timeout=10
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def processor() -> str:
    """Model of the processor and how many cores this process may use."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{_processor_model()}, {cores} cores"


def _processor_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def memory() -> str:
    """Size of the machine's memory."""
    try:
        size = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return "unknown"
    return f"{size / 2**30:.0f} GiB"


def _versions() -> list[str]:
    found = []
    for library in _LIBRARIES:
        try:
            found.append(f"{library} {version(library)}")
        except PackageNotFoundError:
            continue
    return found
