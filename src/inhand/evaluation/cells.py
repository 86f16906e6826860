"""Numbers as cells of a table."""

import math
from collections.abc import Mapping
from typing import Any

from inhand.evaluation.statistics import Estimate

NOTHING = "-"
"""Stands where there is no number."""
IN_PERCENT = "In %, with the 95 % interval in brackets."
"""Note below a table of shares."""
DEGREE = math.degrees(1)
"""Of a radian."""


def percent(share: Mapping[str, Any] | None, decimals: int = 1) -> str:
    """A share with its interval as a cell, in percent."""
    if share is None:
        return NOTHING
    estimate = Estimate(share["share"], share["low"], share["high"])
    return interval(estimate, decimals=decimals)


def interval(estimate: Estimate, decimals: int = 1) -> str:
    """A share in percent with its interval."""
    if estimate.value is None or estimate.low is None:
        return NOTHING
    value = number(estimate.value, 100, decimals)
    low, high = (number(x, 100, 0) for x in estimate[1:])
    return f"{value} ({low} to {high})" if estimate.low < 0 else f"{value} ({low}-{high})"


def number(value: float | None, scale: float, decimals: int, unit: str = "") -> str:
    """A number as a cell."""
    return NOTHING if value is None else f"{value * scale:.{decimals}f}{unit}"
