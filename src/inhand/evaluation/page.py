"""A report as one page that needs nothing beside it, and its tables in Markdown."""

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import groupby
from pathlib import Path
from typing import Any

from inhand.evaluation import tables
from inhand.evaluation.results import Record
from inhand.evaluation.sections import Item, Section
from inhand.evaluation.tables import Table
from inhand.whole_file import write_whole

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1b1f24; max-width: 72rem; margin: 2rem auto;
  padding: 0 1.2rem; }
h1 { font-size: 1.7rem; margin-bottom: .2rem; }
h2 { font-size: 1.25rem; margin: 2.6rem 0 .6rem; padding-top: .6rem;
  border-top: 1px solid #d7dbe0; }
h3 { font-size: 1rem; margin: 1.6rem 0 .4rem; }
nav { columns: 3 14rem; margin: 1rem 0; }
nav a { display: block; }
a { color: #0b5cad; text-decoration: none; }
.wide { overflow-x: auto; }
.tables { display: flex; flex-wrap: wrap; column-gap: 3rem; }
.tables > div { max-width: 100%; }
.tables .note { max-width: 46rem; }
table { border-collapse: collapse; font-size: .87rem; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .55rem; text-align: right; border-bottom: 1px solid #e6e9ed; }
th { font-weight: 600; vertical-align: bottom; border-bottom: 1px solid #98a1ab; }
th:first-child, td:first-child { text-align: left; padding-left: 0; }
td { white-space: nowrap; }
figure { margin: 1.2rem 0; }
figure img { max-width: 100%; height: auto; }
figcaption, .note, .made { font-size: .82rem; color: #57606a; margin: .3rem 0 0; }
.remark { background: #fff6dd; border-left: 4px solid #e3a008; padding: .5rem .9rem; }
.gallery { display: grid; grid-template-columns: repeat(auto-fill, minmax(260px, 1fr)); gap: 8px; }
.gallery img { width: 100%; display: block; }
dl.run { display: grid; grid-template-columns: max-content 1fr; gap: .1rem 1rem;
  font-size: .85rem; }
dl.run dt { color: #57606a; }
dl.run dd { margin: 0; overflow-wrap: anywhere; }
code { font-size: .95em; }
@media print { body { max-width: none; margin: 0; } h2 { break-after: avoid; }
  figure, table { break-inside: avoid; } }
"""


@dataclass(frozen=True)
class Pictures:
    """Pictures of frames."""

    title: str
    """What they show."""
    caption: str
    """How to read them."""
    pngs: tuple[bytes, ...]
    """The pictures, as PNG files."""
    runs: frozenset[int]
    """Which records they were made from."""


@dataclass(frozen=True)
class Report:
    """Everything on the page."""

    title: str
    """Title of the page."""
    facts: tuple[str, ...]
    """What the report is about, a sentence each."""
    remarks: tuple[str, ...]
    """What a reader must know before comparing."""
    sections: tuple[Section, ...]
    """Tables and figures."""
    gallery: tuple[Pictures, ...]
    """Pictures of frames."""
    records: tuple[Record, ...]
    """What the results came from."""
    made_by: Mapping[str, str]
    """What made the report."""


def write_report(report: Report, folder: Path) -> list[Path]:
    """Write `report.html`, `tables.md` and `figures/*.svg`, and return their paths.

    Raises:
        InputError: a file cannot be written.
    """
    files: dict[Path, str] = {
        folder / "report.html": _page(report),
        folder / "tables.md": _markdown(report),
    }
    for item in _items(report):
        if isinstance(item.content, str):
            files[folder / "figures" / f"{item.name}.svg"] = _described(item, report.records)
    for path, text in files.items():
        write_whole(path, text)
    return list(files)


def _described(item: Item, records: Sequence[Record]) -> str:
    """A figure for a file of its own, which says inside what it shows and what made it."""
    lines = [item.caption]
    for i in sorted(item.runs):
        lines.append(f"Run {i + 1}:")
        lines += [f"  {name}: {value}" for name, value in describe_run(records[i])]
    description = escape("\n".join(lines))
    return str(item.content).replace("<metadata>", f"<desc>{description}</desc>\n <metadata>", 1)


def _items(report: Report) -> Iterable[Item]:
    return (item for section in report.sections for item in section.items)


def _page(report: Report) -> str:
    parts = [_section(section) for section in report.sections]
    parts += [_gallery(report.gallery)] if report.gallery else []
    parts += [_runs(report)]
    titles = [s.title for s in report.sections]
    titles += ["Gallery"] * bool(report.gallery) + ["Runs"]
    links = "\n".join(f'<a href="#{_anchor(t)}">{escape(t)}</a>' for t in titles)
    facts = "".join(f"<p>{escape(fact)}</p>" for fact in report.facts)
    remarks = "".join(f"<p class=remark>{escape(remark)}</p>" for remark in report.remarks)
    return "\n".join(
        [
            '<!DOCTYPE html>\n<html lang="en">\n<meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(report.title)}</title>\n<style>{_STYLE}</style>",
            f"<h1>{escape(report.title)}</h1>\n{facts}{remarks}\n<nav>{links}</nav>",
            *parts,
            "</html>\n",
        ]
    )


def _section(section: Section) -> str:
    text = f"<p>{escape(section.text)}</p>" if section.text else ""
    parts = []
    # Tables that follow each other stand side by side where there is room.
    for is_table, items in groupby(section.items, lambda item: isinstance(item.content, Table)):
        blocks = "\n".join(map(_item, items))
        parts.append(f"<div class=tables>{blocks}</div>" if is_table else blocks)
    return "\n".join([_heading(section.title), text, *parts])


def _heading(title: str) -> str:
    return f'<h2 id="{_anchor(title)}">{escape(title)}</h2>'


def _anchor(title: str) -> str:
    return title.lower().replace(" ", "-")


def _item(item: Item) -> str:
    made = _made_by(item.runs)
    if isinstance(item.content, Table):
        return f"<div><h3>{escape(item.caption)}</h3>\n{tables.html(item.content)}{made}</div>"
    image = _image(item.content.encode(), "svg+xml", item.caption)
    return f"<figure>{image}<figcaption>{escape(item.caption)}</figcaption>{made}</figure>"


def _image(data: bytes, kind: str, text: str) -> str:
    encoded = base64.b64encode(data).decode()
    return f'<img src="data:image/{kind};base64,{encoded}" alt="{escape(text)}">'


def _made_by(runs: Iterable[int]) -> str:
    links = ", ".join(f'<a href="#run-{i + 1}">{i + 1}</a>' for i in sorted(runs))
    return f"<p class=made>Made from run {links}.</p>"


def _gallery(pictures: Sequence[Pictures]) -> str:
    parts = [_heading("Gallery")]
    for group in pictures:
        images = "\n".join(_image(png, "png", group.title) for png in group.pngs)
        parts.append(
            f"<h3>{escape(group.title)}</h3>\n<p class=note>{escape(group.caption)}</p>\n"
            f"<div class=gallery>{images}</div>{_made_by(group.runs)}"
        )
    return "\n".join(parts)


def _runs(report: Report) -> str:
    parts = [_heading("Runs")]
    for i, record in enumerate(report.records):
        rows = "\n".join(
            f"<dt>{escape(name)}</dt><dd>{_as_code(name, value)}</dd>"
            for name, value in describe_run(record)
        )
        parts.append(f'<h3 id="run-{i + 1}">Run {i + 1}</h3>\n<dl class=run>{rows}</dl>')
    made = ", ".join(f"{name} {value}" for name, value in report.made_by.items())
    parts.append(f"<p class=made>This report: {escape(made)}.</p>")
    return "\n".join(parts)


def _as_code(name: str, value: str) -> str:
    return f"<code>{escape(value)}</code>" if name == "command" else escape(value)


def describe_run(record: Record) -> list[tuple[str, str]]:
    """What made the results of a record: names and words; of a session, what is new in it."""
    rows = [("results", f"{len(record.results)} in {_short(str(record.path))}")]
    told: Mapping[str, str] = {}
    for origin in record.origins or ({"command": "not recorded"},):
        rows += [(name, words) for name, words in origin.items() if told.get(name) != words]
        told = origin
    rows += [(name, _short(value)) for name, value in record.settings.items()]
    return rows


def _short(value: Any) -> str:
    """A setting in words; of a path, which is of no use elsewhere, the end."""
    if isinstance(value, str) and value.startswith("/"):
        return "/".join(Path(value).parts[-2:])
    if isinstance(value, Mapping):
        return ", ".join(f"{k}={_short(v)}" for k, v in value.items())
    return str(value)


def _markdown(report: Report) -> str:
    parts = [f"# {report.title}\n", *(f"{fact}\n" for fact in (*report.facts, *report.remarks))]
    for section in report.sections:
        parts.append(f"## {section.title}\n")
        parts += [f"{section.text}\n"] * bool(section.text)
        for item in section.items:
            if isinstance(item.content, Table):
                parts.append(tables.markdown(item.content, item.caption))
            else:
                parts.append(f"![{item.caption}](figures/{item.name}.svg)\n\n{item.caption}\n")
            parts.append(f"Made from run {', '.join(str(i + 1) for i in sorted(item.runs))}.\n")
    parts.append("## Runs\n")
    for i, record in enumerate(report.records):
        lines = [
            f"- {name}: `{value}`" if name == "command" else f"- {name}: {value}"
            for name, value in describe_run(record)
        ]
        parts.append("\n".join([f"### Run {i + 1}\n", *lines]) + "\n")
    return "\n".join(parts)
