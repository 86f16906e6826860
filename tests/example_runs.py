"""Runs the examples, each once in a session."""

import io
import os
import runpy
import sys
from contextlib import chdir, redirect_stdout
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple
from unittest.mock import patch

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


class ExampleRun(NamedTuple):
    """What an example left."""

    names: dict[str, Any]
    """Its global names."""
    printed: str
    files: list[str]
    """Files it wrote, by name."""


@cache
def run_example(name: str, *arguments: str) -> ExampleRun:
    """Run examples/`name`.py in an empty folder."""
    path = ROOT / "examples" / f"{name}.py"
    printed = io.StringIO()
    with (
        TemporaryDirectory() as folder,
        chdir(folder),
        redirect_stdout(printed),
        patch.object(sys, "argv", [str(path), *arguments]),
    ):
        names = runpy.run_path(str(path), run_name="__main__")
        return ExampleRun(names, printed.getvalue(), sorted(os.listdir(folder)))
