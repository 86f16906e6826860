"""Several methods beside each other: a table with one row a method, made of columns."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from inhand.evaluation.cells import interval, number, percent
from inhand.evaluation.statistics import Estimate
from inhand.evaluation.study import UPPER_BOUND
from inhand.evaluation.summary import (
    Summary,
)
from inhand.evaluation.tables import Best, Table

Summaries = Mapping[str, Summary]
"""Summaries by method."""


@dataclass(frozen=True)
class Column:
    """A column of a comparison: what it shows of a method."""

    head: str
    cell: Callable[[Summary], str]
    rank: Callable[[Summary], float | None] = lambda _: None
    """The method with the highest number stands out."""


def compare(title: str, summaries: Summaries, columns: Sequence[Column], note: str = "") -> Table:
    """One row a method; the best cell of a column stands out, upper bounds left aside."""
    rows = [[name, *(c.cell(s) for c in columns)] for name, s in summaries.items()]
    for i, column in enumerate(columns, start=1):
        ranks = [
            None if name.endswith(UPPER_BOUND) else column.rank(s) for name, s in summaries.items()
        ]
        known = [r for r in ranks if r is not None]
        for row, rank in zip(rows, ranks, strict=True):
            if len(known) > 1 and rank == max(known) > min(known):
                row[i] = Best(row[i])
    heads = ("method", *(c.head for c in columns))
    return Table(title, heads, tuple(map(tuple, rows)), note)


def at(*keys: str) -> Callable[[Summary], Any]:
    """What a summary holds under these keys, one in the other; None where there is nothing."""

    def find(summary: Summary) -> Any:
        value: Any = summary
        for key in keys:
            value = None if value is None else value.get(key)
        return value

    return find


def share_column(head: str, *keys: str) -> Column:
    """A share and its interval."""
    find = at(*keys)
    return Column(head, lambda s: percent(find(s)), at(*keys, "share"))


def mean_column(head: str, *keys: str) -> Column:
    """A mean of shares, or a statistic that is one, and its interval."""
    find = at(*keys)
    return Column(head, lambda s: interval(Estimate(**find(s))), at(*keys, "value"))


def error_column(head: str, *keys: str, scale: float = 1, decimals: int = 1) -> Column:
    """A number of which the smallest is the best."""
    find = at(*keys)
    return Column(
        head,
        lambda s: number(find(s), scale, decimals),
        lambda s: None if find(s) is None else -find(s),
    )


def count_column(head: str, *keys: str) -> Column:
    """A number of frames; none is 0."""
    find = at(*keys)
    return Column(head, lambda s: str(find(s) or 0))
