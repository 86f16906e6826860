"""What a report is made of: sections with tables and figures."""

from dataclasses import dataclass

from inhand.evaluation.tables import Table


@dataclass(frozen=True)
class Item:
    """A table or a figure."""

    name: str
    """Name for files and links."""
    caption: str
    """What it shows."""
    content: Table | str
    """The table, or the figure as SVG."""
    runs: frozenset[int]
    """Which of the study's records it was made from."""


@dataclass(frozen=True)
class Section:
    """Tables and figures on one question."""

    title: str
    """The question."""
    text: str
    """What to know before reading them."""
    items: tuple[Item, ...]
    """The tables and figures."""
