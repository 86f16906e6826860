"""The house plan, enforced: imports point one way, the core stays small, the start stays fast."""

import ast
import io
import re
import subprocess
import sys
import tokenize
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "inhand"
SOURCES = {
    ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sorted(PACKAGE.rglob("*.py"))
}

# Lower layers know nothing of higher ones. A module that is not listed is in the top layer, but
# the packages of the top layer keep an order of their own where one is built on another.
LAYERS = [
    ["errors", "camera", "geometry", "kernels", "cache"],
    ["config", "kinematics", "urdf", "reach", "packed", "hand", "object_symmetry", "object_model"],
    ["stages", "estimate"],
    ["estimator"],
    ["io", "picture", "builtin"],
    ["synth", "datasets"],
    ["evaluation", "baselines"],
    ["cli", "viewer"],
]
# In the order of the pipeline; other modules in stages/ are shared parts.
STAGES = [
    "observation",
    "wrist",
    "hand_state",
    "segmentation",
    "hypotheses",
    "clustering",
    "refinement",
    "pruning",
    "selection",
]
CORE_LAYERS = 5
CORE_LINES = 4000
HEAVY = {"warp", "trimesh", "yourdfpy", "scipy", "numpy", "PIL", "OpenEXR", "lxml"}


def layer(module: str) -> int:
    part = module.split(".")[1]
    found = [number for number, parts in enumerate(LAYERS) if part in parts]
    assert found, f"{module}: add it to a layer in {Path(__file__).name}"
    return found[0]


def imports(path: Path) -> set[str]:
    """Full names of the modules that a file imports anywhere, also inside functions."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}:{node.lineno}: relative import"
            assert node.module is not None
            names.update(
                full if (full := f"{node.module}.{alias.name}") in SOURCES else node.module
                for alias in node.names
            )
    return names


@pytest.mark.parametrize("module", [m for m in SOURCES if m != "inhand"])
def test_imports_point_one_way(module: str) -> None:
    own = [m for m in imports(SOURCES[module]) if m.startswith("inhand.")]
    upwards = [m for m in own if layer(m) > layer(module)]
    assert not upwards, f"{module} imports from a higher layer: {upwards}"


def test_stages_import_only_from_earlier_stages() -> None:
    for number, name in enumerate(STAGES):
        if module := SOURCES.get(f"inhand.stages.{name}"):
            later = [s for s in STAGES[number + 1 :] if f"inhand.stages.{s}" in imports(module)]
            assert not later, f"{name} imports from later stages: {later}"


def test_no_cycle_among_modules() -> None:
    edges = {m: {i for i in imports(p) if i in SOURCES and i != m} for m, p in SOURCES.items()}
    edges["inhand"] = set()  # its imports are lazy
    while leaves := {m for m, below in edges.items() if not below}:
        edges = {m: below - leaves for m, below in edges.items() if m not in leaves}
    assert not edges, f"modules that import each other in a circle: {edges}"


def test_core_stays_small() -> None:
    lines = {
        module: code_lines(path)
        for module, path in SOURCES.items()
        if module != "inhand" and layer(module) < CORE_LAYERS and "builtin" not in module
    }
    assert sum(lines.values()) < CORE_LINES, lines


def code_lines(path: Path) -> int:
    """Lines that hold code: no blank lines, comments or docstrings."""
    text = path.read_text()
    documentation = {
        line
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    skipped = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}
    skipped |= {tokenize.ENDMARKER}
    code: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in skipped:
            code.update(range(token.start[0], token.end[0] + 1))
    return len(code - documentation)


def test_every_imported_library_is_a_declared_dependency() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    requirements = [*project["dependencies"], *project["optional-dependencies"]["bench"]]
    requirements += project["optional-dependencies"]["viewer"]
    declared = {normal(re.split(r"[<>=\[; ]", r)[0]) for r in requirements}
    providers = packages_distributions()
    used = {name.split(".")[0] for path in SOURCES.values() for name in imports(path)}
    for name in used - sys.stdlib_module_names - {"inhand"}:
        assert declared & {normal(p) for p in providers.get(name, [name])}, name


def normal(distribution: str) -> str:
    return re.sub(r"[-_.]+", "-", distribution).lower()


def test_help_loads_no_heavy_library() -> None:
    code = (
        "import sys, inhand.cli\n"
        "try:\n"
        "    inhand.cli.main(['--help'])\n"
        "except SystemExit as stop:\n"
        "    assert not stop.code, stop.code\n"
        f"print('loaded:', sorted({HEAVY} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "estimate" in done.stdout
    assert done.stdout.rstrip().endswith("loaded: []")
