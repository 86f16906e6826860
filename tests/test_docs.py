"""What README and pages show can be run, prints what they say, and is complete."""

import ast
import json
import re
import runpy
import shlex
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from textwrap import dedent
from typing import Any, NamedTuple

import numpy as np
import pytest
import trimesh
import tyro
from example_runs import EXAMPLES, ROOT, run_example
from PIL import Image

import inhand
from inhand import cli, config
from inhand.builtin.hand import write_hand
from inhand.synth.dataset import finish, missing_images, start
from inhand.synth.demo import demo_scene
from inhand.synth.plan import Plan
from inhand.synth.workers import make_here

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
FENCE = re.compile(r"^( *)```([^\n]*)\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)


class Block(NamedTuple):
    """A fenced block of a page."""

    language: str
    """What stands behind the fence."""
    text: str


def blocks(page: Path, *languages: str) -> list[Block]:
    found = [Block(head.strip(), dedent(text)) for _, head, text in FENCE.findall(page.read_text())]
    return [block for block in found if block.language in languages]


def pages_with(*languages: str) -> list[Any]:
    return [pytest.param(p, id=p.name) for p in PAGES if blocks(p, *languages)]


# What the examples print


def shown_output() -> Iterator[Any]:
    """Every block of output, with the example that stands before it in its page."""
    for page in PAGES:
        example = None
        for block in blocks(
            page, *(f"{{literalinclude}} ../examples/{p.name}" for p in EXAMPLES), "text"
        ):
            if block.language != "text":
                example = Path(block.language.split()[-1]).stem
            elif example is not None:
                yield pytest.param(example, block.text, id=f"{page.stem}-{example}")


@pytest.mark.parametrize(("example", "shown"), list(shown_output()))
def test_shown_output_is_printed(example: str, shown: str) -> None:
    printed = [without_numbers(line) for line in run_example(example).printed.splitlines()]
    for line in shown.splitlines():
        assert without_numbers(line) in printed, line


def without_numbers(line: str) -> str:
    """The line with every number, and the spaces that align it, replaced."""
    return re.sub(r"\s*-?\d+\.?\d*", " #", line)


def test_every_example_is_shown() -> None:
    text = "".join(page.read_text() for page in PAGES)
    for path in EXAMPLES:
        assert f"{{literalinclude}} ../examples/{path.name}" in text, path.name


# Python


@pytest.fixture(scope="session")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files that the pages name, of the demo's scene."""
    folder = tmp_path_factory.mktemp("docs")
    scene = demo_scene()
    write_hand(folder).rename(folder / "hand.urdf")
    for name in ("object.ply", "mustard.ply"):
        trimesh.Trimesh(scene.obj.mesh.vertices, scene.obj.mesh.faces).export(folder / name)
    counts = np.rint(scene.depth / scene.camera.depth_unit).astype(np.uint16)
    Image.fromarray(counts).save(folder / "depth.png")
    numbers = {n: getattr(scene.camera, n) for n in ("fx", "fy", "cx", "cy", "width", "height")}
    (folder / "camera.json").write_text(json.dumps(numbers | {"depth_unit_m": 0.001}))
    pose = {"T_camera_hand": scene.T_camera_hand_given.tolist()}
    (folder / "hand_pose.json").write_text(json.dumps(pose))
    small = folder / "out" / "small"
    plan = Plan(objects=("cuboid",), colours=("white",), number=4)
    start(small, plan)
    for _ in make_here(small, plan, missing_images(small, plan), "cpu"):
        pass
    finish(small, plan)
    return folder


@pytest.fixture
def names() -> dict[str, Any]:
    """Names that the pages' code blocks take for granted."""
    scene = demo_scene()
    estimator = inhand.PoseEstimator(scene.hand, scene.obj)
    estimate = estimator.estimate(scene.depth, scene.camera, scene.T_camera_hand_given)
    eye = np.eye(4)
    return {
        "K": scene.camera.matrix,
        "T_base_camera": eye,
        "T_base_flange": eye,
        "T_camera_hand": scene.T_camera_hand_given,
        "T_flange_hand": eye,
        "camera": scene.camera,
        "counts": np.rint(1000 * scene.depth).astype(np.uint16),
        "depth": scene.depth,
        "estimate": estimate,
        "estimator": estimator,
        "hand": scene.hand,
        "inhand": inhand,
        "obj": scene.obj,
        "ranges": scene.depth,
        "stream": [(scene.depth, scene.T_camera_hand_given)],
    }


@pytest.mark.parametrize("page", pages_with("python"))
def test_python_of_a_page_runs(
    page: Path, names: dict[str, Any], workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(workplace)
    for block in blocks(page, "python"):
        exec(compile(block.text, page.name, "exec"), names)


def test_depth_from_ranges_is_z(names: dict[str, Any]) -> None:
    (block,) = (
        b for b in blocks(ROOT / "docs/frames-and-units.md", "python") if "ranges" in b.text
    )
    camera = inhand.Camera(fx=100, fy=120, cx=10, cy=20, width=40, height=30)
    plane = np.full((30, 40), 0.5)  # z of a wall across the optical axis
    v, u = np.indices(plane.shape)
    points = np.stack([(u - 10) / 100 * plane, (v - 20) / 120 * plane, plane], axis=-1)
    names = {"np": np, "camera": camera, "ranges": np.linalg.norm(points, axis=-1)}
    exec(block.text, names)
    assert names["depth"] == pytest.approx(plane)


# The command line


def commands(page: Path) -> list[list[str]]:
    """The command lines of a page's shell blocks, as words."""
    text = "".join(block.text for block in blocks(page, "sh"))
    lines = text.replace("\\\n", " ").splitlines()
    return [words for line in lines if (words := shlex.split(line, comments=True))]


@pytest.mark.parametrize("page", pages_with("sh"))
def test_commands_of_a_page_exist(page: Path) -> None:
    for words in commands(page):
        program, *arguments = words
        if program == "inhand":
            tyro.cli(cli._Command, args=arguments)
        scripts = [word for word in words if word.startswith("benchmarks/")]
        assert all((ROOT / script).is_file() for script in scripts), words


@pytest.mark.parametrize("page", ["README.md", "docs/getting-started.md"])
def test_estimate_command_of_a_page_runs(
    page: str, workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(workplace)
    (command,) = (words for words in commands(ROOT / page) if words[:2] == ["inhand", "estimate"])
    assert cli.main(command[1:]) == cli.FOUND
    result = json.loads((workplace / "result.json").read_text())
    truth = demo_scene().T_camera_object
    assert np.array(result["T_camera_object"])[:3, 3] == pytest.approx(truth[:3, 3], abs=0.002)
    assert (workplace / "result.png").is_file()


# Pictures


def test_pictures_of_the_stages_can_be_drawn_anew(tmp_path: Path) -> None:
    script = runpy.run_path(str(ROOT / "benchmarks" / "stage_pictures.py"))
    script["main"](tmp_path)
    shown = re.findall(r"\(stages/(.+\.webp)\)", (ROOT / "docs/how-it-works.md").read_text())
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(shown)
    for name in shown:
        drawn, committed = (Image.open(f / name) for f in (tmp_path, ROOT / "docs" / "stages"))
        assert drawn.size == committed.size
        assert (tmp_path / name).stat().st_size < 100_000


# Links and completeness


def test_links_of_the_readme_lead_somewhere() -> None:
    for target in re.findall(r"\]\(([^)]+)\)", (ROOT / "README.md").read_text()):
        if "://" in target:
            continue
        name, _, anchor = target.partition("#")
        assert (ROOT / name).exists(), target
        assert not anchor or anchor in map(slug, headings(ROOT / name)), target


def headings(page: Path) -> list[str]:
    return re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)


def slug(heading: str) -> str:
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def test_every_public_name_is_in_the_reference() -> None:
    reference = "".join((ROOT / "docs" / f"{p}.md").read_text() for p in ("api", "configuration"))
    for name in inhand.__all__:
        assert re.search(rf":: inhand\.{name}$", reference, re.MULTILINE), name
    for section in fields(inhand.EstimatorConfig):
        if section.name != "seed":
            kind = type(getattr(inhand.EstimatorConfig(), section.name)).__name__
            assert f":: inhand.config.{kind}\n" in reference, kind


def test_every_parameter_is_described() -> None:
    tree = ast.parse(Path(config.__file__).read_text())
    for section in (node for node in tree.body if isinstance(node, ast.ClassDef)):
        for field, text in zip(section.body, section.body[1:], strict=False):
            if isinstance(field, ast.AnnAssign) and section.name != "EstimatorConfig":
                described = isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant)
                assert described, f"{section.name}: {ast.unparse(field.target)}"
