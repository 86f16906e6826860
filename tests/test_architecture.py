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

# From low to high: a module imports from its own layer and from those listed before it only.
LAYERS = [
    ["errors", "checks", "camera", "geometry", "kernels", "cache", "processes"],
    ["config", "kinematics", "urdf", "reach", "hand", "packed"]
    + ["object_symmetry", "pair_table", "object_model"],
    ["stages", "estimate"],
    ["estimator"],
    ["whole_file", "io", "overlay", "picture", "builtin", "cluster"],
    ["synth", "datasets"],
    ["evaluation", "baselines", "tracking", "streams"],
    ["cli", "viewer", "annotation"],
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
CORE_LAYERS = 4  # up to the estimator
CORE_LINES = 5185
PAPER_LINES = 1220
# What only `EstimatorConfig.paper()` and the metrics need: a reference to measure against, counted
# apart.
PAPER_MODULES = {
    "inhand.object_symmetry",
    *(
        f"inhand.stages.{name}"
        for name in (
            "wrist_icp",
            "particle_swarm",
            "congruent_sets",
            "lcp",
            "se3_clustering",
            "point_to_plane",
            "physics_pruning",
            "render_selection",
        )
    ),
    *(
        f"inhand.kernels.{name}"
        for name in (
            "alignment",
            "clustering",
            "congruent_sets",
            "discrepancy",
            "lcp",
            "point_to_plane",
        )
    ),
}
HEAVY = {"warp", "trimesh", "yourdfpy", "scipy", "numpy", "PIL", "OpenEXR", "lxml"}


def layer(module: str) -> int:
    part = module.split(".")[1]
    found = [number for number, parts in enumerate(LAYERS) if part in parts]
    assert found, f"{module}: add it to a layer in {Path(__file__).name}"
    return found[0]


def imports(path: Path, *, on_load_only: bool = False) -> set[str]:
    """Full names of the modules that a file imports, also inside functions or only on loading."""
    names: set[str] = set()
    tree = ast.parse(path.read_text())
    for node in tree.body if on_load_only else ast.walk(tree):
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


def test_no_module_needs_itself_to_load() -> None:
    edges = {m: imports(p, on_load_only=True) & SOURCES.keys() - {m} for m, p in SOURCES.items()}
    while leaves := {m for m, below in edges.items() if not below}:
        edges = {m: below - leaves for m, below in edges.items() if m not in leaves}
    assert not edges, f"modules that import each other in a circle, or a circle: {edges}"


def test_core_stays_small() -> None:
    lines = {
        module: code_lines(path)
        for module, path in SOURCES.items()
        if module != "inhand" and layer(module) < CORE_LAYERS
    }
    paper = sum(lines[module] for module in PAPER_MODULES)
    assert paper < PAPER_LINES, paper
    assert sum(lines.values()) - paper < CORE_LINES, lines


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


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def declared(*extras: str) -> set[str]:
    """Names of the distributions that the project and these extras of it need."""
    requirements = list(PROJECT["dependencies"])
    for extra in extras:
        requirements += PROJECT["optional-dependencies"][extra]
    return {normal(re.split(r"[<>=\[; ]", r)[0]) for r in requirements}


def test_every_imported_library_is_a_declared_dependency() -> None:
    known = declared("viewer", "bench", "kiss", "ray", "streams", "realsense")
    providers = packages_distributions()
    used = {name.split(".")[0] for path in SOURCES.values() for name in imports(path)}
    for name in used - sys.stdlib_module_names - {"inhand"}:
        assert known & {normal(p) for p in providers.get(name, [name])}, name


def test_constraints_pin_every_dependency() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    assert all(re.fullmatch(r"[\w.-]+==[\w.]+", pin) for pin in pins), "only NAME==VERSION"
    assert declared("bench", "streams", "docs", "dev") <= {
        normal(pin.split("==")[0]) for pin in pins
    }


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
