"""URDF texts for the tests: the smallest that show one thing each."""

from pathlib import Path

BOX = '<box size="0.02 0.01 0.04"/>'
LIMIT = '<limit lower="-1" upper="2" effort="1" velocity="1"/>'


def link(name: str, geometry: str | None = BOX, origin: str = "", tag: str = "visual") -> str:
    """A link with one shape; `geometry` None: without shape."""
    if geometry is None:
        return f'<link name="{name}"/>'
    return f'<link name="{name}"><{tag}>{origin}<geometry>{geometry}</geometry></{tag}></link>'


def joint(
    name: str,
    parent: str,
    child: str,
    kind: str = "revolute",
    inside: str = LIMIT,
    xyz: str = "0 0 0.05",
    rpy: str = "0 0 0",
    axis: str = "1 0 0",
) -> str:
    """A joint; `inside`: its limits and mimic rule."""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{inside}</joint>'
    )


def mimic(source: str, rule: str = "") -> str:
    """A mimic rule with limits, as a joint's `inside`."""
    return f'{LIMIT}<mimic joint="{source}" {rule}/>'


def write(folder: Path, *elements: str, name: str = "hand.urdf") -> Path:
    """A URDF file of these elements."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f'<?xml version="1.0"?>\n<robot name="tiny">{"".join(elements)}</robot>')
    return path
