"""A table of words, and how it looks on the terminal, in Markdown and on a page."""

from dataclasses import dataclass
from html import escape

from rich.markup import escape as escape_markup
from rich.table import Table as RichTable


class Best(str):
    """A cell that stands out."""


@dataclass(frozen=True)
class Table:
    """A table of words; the first column names the rows."""

    title: str
    """What the table shows."""
    columns: tuple[str, ...]
    """Heads of the columns."""
    rows: tuple[tuple[str, ...], ...]
    """The cells."""
    note: str = ""
    """A remark for below the table."""
    section_ends: frozenset[int] = frozenset()
    """Rows that a line is drawn below, on the terminal."""


def terminal(table: Table) -> RichTable:
    """The table for the terminal."""
    rich = RichTable(*map(escape_markup, table.columns), title=table.title, caption=table.note)
    for i, row in enumerate(table.rows):
        cells = (
            f"[bold]{escape_markup(cell)}[/bold]" if isinstance(cell, Best) else escape_markup(cell)
            for cell in row
        )
        rich.add_row(*cells, end_section=i in table.section_ends)
    return rich


def markdown(table: Table, title: str) -> str:
    """The table in Markdown, with a title above and its note below."""

    def line(cells: tuple[str, ...]) -> str:
        return f"| {' | '.join(map(cell, cells))} |"

    def cell(text: str) -> str:
        safe = text.replace("|", "\\|").replace("<", "&lt;")
        return f"**{safe}**" if isinstance(text, Best) else safe

    rule = f"|---{'|---:' * (len(table.columns) - 1)}|"
    lines = [f"### {title}", "", line(table.columns), rule, *map(line, table.rows)]
    return "\n".join([*lines, "", table.note]).rstrip() + "\n"


def html(table: Table) -> str:
    """The table for a page, without its title."""

    def cell(text: str, tag: str = "td") -> str:
        inside = escape(text).replace("_", "_<wbr>")
        if isinstance(text, Best):
            inside = f"<b>{inside}</b>"
        return f"<{tag}>{inside}</{tag}>"

    head = "".join(cell(column, "th") for column in table.columns)
    body = "\n".join(f"<tr>{''.join(map(cell, row))}</tr>" for row in table.rows)
    note = f"<p class=note>{escape(table.note)}</p>" if table.note else ""
    return f"<div class=wide><table>\n<tr>{head}</tr>\n{body}\n</table></div>{note}"
