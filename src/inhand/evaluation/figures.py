"""The figures of a report, as SVG."""

import io
import math
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter, PercentFormatter

from inhand.evaluation.diagnosis import SOLVED
from inhand.evaluation.statistics import ReliabilityBin
from inhand.evaluation.study import UNITS, by_quantity
from inhand.evaluation.summary import AREA_LIMIT, VISIBLE_BINS, Results, Summary, solved_share
from inhand.evaluation.sweeps import SWEEPS, curve

# Colours that also the colour-blind tell apart (Okabe and Ito, "Color universal design", 2008),
# and some more.
_COLOURS = (
    *("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"),
    *("#7f7f7f", "#8c564b", "#bcbd22", "#17202a"),
)
_DASHES = ("-", "--", ":", "-.")
_STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e3e3e3",
    "grid.linewidth": 0.6,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "lines.markersize": 4.0,
    "svg.hashsalt": "inhand",  # the same figure, the same file
}
_PANEL = (3.9, 3.0)
_MOST_COLUMNS = 3
_LEGEND = 1.6
_SHARE = PercentFormatter(1.0, decimals=0)

Panels = Mapping[str, Any]


class Figures:
    """Draws figures in which a method looks the same everywhere.

    Methods of one family, whose names are alike up to a "+", share a colour.

    Args:
        methods: all methods that will be shown, in order.
    """

    def __init__(self, methods: Sequence[str]) -> None:
        families: dict[str, list[str]] = {}
        for method in methods:
            families.setdefault(method.split("+")[0], []).append(method)
        self._look: dict[str, dict[str, Any]] = {
            method: {
                "color": _COLOURS[i % len(_COLOURS)],
                "linestyle": _DASHES[(k + i // len(_COLOURS)) % len(_DASHES)],
            }
            for i, family in enumerate(families.values())
            for k, method in enumerate(family)
        }

    def recall_curves(self, panels: Mapping[str, Results]) -> str:
        """Recall over the ADI threshold; a panel a data set."""
        with _Sheet(panels, "ADI threshold [mm]", "recall") as sheet:
            for axes, results in sheet:
                for method, of in results.items():
                    read = [r for r in of if r.outcome != "unreadable"]
                    errors = np.sort([math.inf if r.adi is None else r.adi for r in read])
                    x = np.linspace(0, AREA_LIMIT, 201)
                    share = np.searchsorted(errors, x, side="left") / len(errors)
                    axes.plot(x * 1000, share, label=method, **self._look[method])
                axes.axvline(SOLVED * 1000, color="#999", linewidth=0.8)
                axes.set(xlim=(0, AREA_LIMIT * 1000))
            return sheet.svg()

    def visible_recall(self, panels: Mapping[str, Mapping[str, Summary]]) -> str:
        """Recall by the object's visible share; a panel a data set."""
        with _Sheet(panels, "visible share of the object", "recall (ADI < 5 mm)") as sheet:
            for axes, summaries in sheet:
                for k, (method, summary) in enumerate(summaries.items()):
                    found = summary["recall"]["visible share"]
                    at = [i for i, name in enumerate(VISIBLE_BINS) if name in found]
                    shares = [found[name]["5 mm"] for name in VISIBLE_BINS if name in found]
                    aside = 0.3 * ((k + 0.5) / len(summaries) - 0.5)
                    self._with_intervals(axes, np.array(at) + aside, shares, method)
                axes.set_xticks(range(len(VISIBLE_BINS)), list(VISIBLE_BINS))
            return sheet.svg()

    def perturbation_curves(self, perturbed: Results, plain: Results) -> str:
        """Recall over what a method was handicapped by; a panel a quantity.

        Methods that were not are drawn as level lines.
        """
        panels = by_quantity(perturbed)
        with _Sheet(panels, "", "recall (ADI < 5 mm)") as sheet:
            for (axes, methods), quantity in zip(sheet, panels, strict=True):
                unit, scale = UNITS.get(quantity, ("", 1.0))
                for method, amounts in methods.items():
                    x = np.array(list(amounts)) * scale
                    self._with_intervals(axes, x, list(map(solved_share, amounts.values())), method)
                for method, of in plain.items():
                    level = solved_share(of)["share"]
                    axes.axhline(level, label=method, linewidth=1, **self._look[method])
                axes.set(title="", xlabel=f"{quantity} [{unit}]" if unit else quantity)
                axes.set_xlim(left=0)
            return sheet.svg()

    def sweep_curves(self, results: Results) -> str:
        """Recall, and mean confidence, over the level of a sweep; a panel a sweep.

        Args:
            results: results by method, on frames as they are and at the levels of sweeps.
        """
        panels = {
            name: found
            for name in SWEEPS
            if (found := {m: c for m, of in results.items() if (c := curve(name, of))})
        }
        with _Sheet(panels, "", "recall (ADI < 5 mm), confidence") as sheet:
            for (axes, methods), name in zip(sheet, panels, strict=True):
                sweep = SWEEPS[name]
                for method, levels in methods.items():
                    x = np.array(list(levels)) * sweep.scale
                    self._with_intervals(axes, x, list(map(solved_share, levels.values())), method)
                    sure = [np.mean([r.confidence for r in of]) for of in levels.values()]
                    axes.plot(x, sure, **{**self._look[method], "linestyle": ":"})
                axes.set(title=name, xlabel=f"{sweep.title} [{sweep.unit}]")
            return sheet.svg()

    def recall_against_time(self, panels: Mapping[str, Mapping[str, Summary]]) -> str:
        """Recall over the median time; a panel a data set."""
        with _Sheet(panels, "median time [ms]", "recall (ADI < 5 mm)") as sheet:
            for axes, summaries in sheet:
                for method, summary in summaries.items():
                    median = summary["time"]["whole estimate"]["median"]
                    share = summary["recall"]["all"]["5 mm"]
                    if median is not None:
                        self._with_intervals(axes, [1000 * median], [share], method)
                axes.set(xscale="log")
                axes.xaxis.set_major_formatter("{x:g}")
                axes.xaxis.set_minor_formatter(LogFormatter())
            return sheet.svg()

    def reliability_curves(self, panels: Mapping[str, Mapping[str, Summary]]) -> str:
        """Share of right answers over the confidence; a panel a data set."""
        with _Sheet(panels, "confidence", "share of right answers") as sheet:
            for axes, summaries in sheet:
                axes.plot([0, 1], [0, 1], color="#999", linewidth=0.8)
                for method, summary in summaries.items():
                    curve = [ReliabilityBin(**b) for b in summary["confidence"]["reliability"]]
                    shares = [b._asdict() for b in curve]
                    self._with_intervals(axes, [b.confidence for b in curve], shares, method)
                axes.set(xlim=(-0.02, 1.02))
            return sheet.svg()

    def error_curves(self, panels: Mapping[str, Mapping[str, Sequence[float]]]) -> str:
        """Share of errors below a limit; a panel a quantity, whose name is the axis's."""
        with _Sheet(panels, "", "share below") as sheet:
            for (axes, methods), quantity in zip(sheet, panels, strict=True):
                for method, errors in methods.items():
                    x = np.sort([0.0, *errors])
                    y = np.arange(len(x)) / len(errors)
                    look = self._look.get(method, {"color": "#999", "linestyle": "-"})
                    axes.step(x, y, where="post", label=method, **look)
                largest = max(float(np.percentile(e, 95)) for e in methods.values())
                axes.set(title="", xlabel=quantity, xlim=(0, 1.3 * largest))
            return sheet.svg()

    def _with_intervals(
        self, axes: Any, x: Any, shares: Sequence[Mapping[str, float]], method: str
    ) -> None:
        """A curve of shares with their intervals as bars."""
        share, low, high = (np.array([s[k] for s in shares]) for k in ("share", "low", "high"))
        bars = np.clip([share - low, high - share], 0, None)
        axes.errorbar(
            x, share, bars, label=method, marker="o", elinewidth=0.8, capsize=1.5,
            **self._look[method],
        )  # fmt: skip


def time_bars(summaries: Mapping[str, Summary]) -> str:
    """Mean time of every stage, one bar a method."""
    parts = {
        method: {s: v["mean"] for s, v in summary["time"].items() if v["count"]}
        for method, summary in summaries.items()
    }
    stages = list(dict.fromkeys(s for of in parts.values() for s in of if s != "whole estimate"))
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(7.4, 1.2 + 0.28 * len(parts)), layout="constrained")
        axes = figure.subplots()
        colours = matplotlib.colormaps["tab20"].colors  # type: ignore[attr-defined]
        left = np.zeros(len(parts))
        for i, stage in enumerate(stages):
            width = np.array([1000 * of.get(stage, 0.0) for of in parts.values()])
            axes.barh(list(parts), width, 0.7, left, color=colours[i % 20], label=stage)
            left += width
        whole = np.array([1000 * of.get("whole estimate", 0.0) for of in parts.values()])
        axes.barh(list(parts), np.maximum(whole - left, 0), 0.7, left, color="#ddd", label="rest")
        axes.set(xlabel="mean time [ms]")
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")
        figure.legend(loc="outside right upper")
        return _svg(figure)


def ablation_bars(panels: Mapping[str, Mapping[str, Summary]]) -> str:
    """Recall of every step of the ablation; a panel a data set."""
    rows = max(map(len, panels.values()))
    with _Sheet(panels, "recall (ADI < 5 mm)", "", (3.6, 0.9 + 0.27 * rows)) as sheet:
        for axes, steps in sheet:
            shares = [s["recall"]["all"]["5 mm"] for s in steps.values()]
            share, low, high = (np.array([s[k] for s in shares]) for k in ("share", "low", "high"))
            bars = np.clip([share - low, high - share], 0, None)
            axes.barh(list(steps), share, 0.7, xerr=bars, color=_COLOURS[0], ecolor="#444")
            axes.invert_yaxis()
            axes.grid(visible=False, axis="y")
            axes.set(xlim=(0, 1), ylim=None)
            axes.xaxis.set_major_formatter(_SHARE)
        return sheet.svg()


class _Sheet:
    """A row of panels with one legend; a context in which the style holds."""

    def __init__(self, panels: Panels, x: str, y: str, size: tuple[float, float] = _PANEL) -> None:
        self._style = matplotlib.rc_context(_STYLE)
        self._panels, self._x, self._y, self._size = panels, x, y, size

    def __enter__(self) -> "_Sheet":
        self._style.__enter__()
        width, height = self._size
        count = len(self._panels)
        rows = -(-count // _MOST_COLUMNS)
        columns = -(-count // rows)
        size = (columns * width + _LEGEND, rows * height)
        self._figure = Figure(figsize=size, layout="constrained")
        self._axes = self._figure.subplots(rows, columns, squeeze=False).ravel()
        for axes in self._axes[count:]:
            axes.set_visible(False)
        return self

    def __exit__(self, *error: Any) -> None:
        self._style.__exit__(*error)

    def __iter__(self) -> Any:
        """The axes of every panel with what it shows."""
        for axes, (title, content) in zip(self._axes, self._panels.items(), strict=False):
            axes.set(title=title, xlabel=self._x, ylabel=self._y)
            yield axes, content
            if self._y:  # every measured quantity is a share
                axes.set(ylim=(-0.02, 1.02))
                axes.yaxis.set_major_formatter(_SHARE)

    def svg(self) -> str:
        """The figure, with a legend of everything that any panel shows."""
        handles: dict[str, Any] = {}
        for axes in self._axes:
            for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
                handles.setdefault(label, handle)
        if handles:
            self._figure.legend(handles=handles.values(), loc="outside right upper")
        return _svg(self._figure)


def _svg(figure: Figure) -> str:
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()
