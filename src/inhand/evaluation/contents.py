"""What stands in a report: its sections, with their tables and figures."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from math import degrees

from inhand.evaluation import figures, report
from inhand.evaluation.diagnosis import POSE_STAGES
from inhand.evaluation.figures import Figures
from inhand.evaluation.study import ABLATION, UPPER_BOUND, Study
from inhand.evaluation.summary import Results, Summary, summarise
from inhand.evaluation.sweep_tables import sweep_table
from inhand.evaluation.sweeps import by_level
from inhand.evaluation.tables import Table

EVERYWHERE = "all data sets"
"""Stands before the title of a table that is not about a single one."""
LISTED_FAILURES = 50
"""Frames that could not be read or that a method failed on, at most this many are named."""


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


Panels = Mapping[str, Mapping[str, Summary]]
"""Summaries by data set and method."""


class Contents:
    """Makes the sections of a report.

    Args:
        study: the results.
        reference: the method that the others are compared with.
    """

    def __init__(self, study: Study, reference: str) -> None:
        self._study = study
        self._reference = reference
        plain = [m for m in study.by_method if not m.startswith(ABLATION)]
        self._figures = Figures(list(dict.fromkeys([*plain, *study.perturbed, *study.swept])))

    @cached_property
    def _every_summary(self) -> Panels:
        return self._summarised(self._study.results)

    @cached_property
    def _summaries(self) -> Panels:
        """Of the methods that had a frame that could be read."""
        return _where(self._every_summary, lambda s: s["recall"]["all"]["5 mm"]["frames"])

    @cached_property
    def _pooled(self) -> dict[str, Summary]:
        """Summaries by method, of all data sets together."""
        return {
            method: summarise(results)
            for method, results in self._study.by_method.items()
            if not method.startswith(ABLATION)
        }

    def _summarised(self, results: Callable[[str], Results]) -> Panels:
        found = {
            name: {method: summarise(of) for method, of in results(name).items()}
            for name in self._study.data_sets
        }
        return {name: summaries for name, summaries in found.items() if summaries}

    def sections(self) -> list[Section]:
        """The sections that have something to show."""
        found = (
            self._overview(),
            self._objects(),
            self._visible(),
            self._ablation(),
            self._perturbations(),
            self._sweeps(),
            self._times(),
            self._hand(),
            self._confidence(),
            self._measures(),
            self._stages(),
            self._frames(),
        )
        return [section for section in found if section.items]

    def _overview(self) -> Section:
        panels = {
            name: {method: self._study.results(name)[method] for method in summaries}
            for name, summaries in self._summaries.items()
        }
        items = self._per_set("overview", self._summaries, report.overview_table)
        if panels:
            caption = "Recall over the ADI threshold. The grey line is the paper's threshold, 5 mm."
            svg = self._figures.recall_curves(panels)
            items.append(self._figure("recall-curves", caption, svg, self._pooled))
        if any(len(summaries) > 1 for summaries in self._summaries.values()):
            caption = "Recall over the median time of a frame: up and left is better."
            svg = self._figures.recall_against_time(self._summaries)
            items.append(self._figure("recall-against-time", caption, svg, self._pooled))
        for name, results in panels.items():
            if self._reference in results and len(results) > 1:
                table = report.difference_table(results, self._reference)
                items.append(self._table(f"difference-{name}", name, table, results))
        text = (
            f"The names of methods that are given the object's true pixels end with {UPPER_BOUND}: "
            "an upper bound, which does not stand out in the tables."
        )
        bounded = any(m.endswith(UPPER_BOUND) for m in self._pooled)
        return Section("Methods", text if bounded else "", tuple(items))

    def _objects(self) -> Section:
        items = self._per_set("objects", self._summaries, report.object_table)
        return Section("Objects", "", tuple(items))

    def _visible(self) -> Section:
        seen = _where(self._summaries, lambda s: s["recall"]["visible share"])
        items = []
        if seen:
            caption = (
                "Recall by how much of the object's silhouette is visible, with 95 % intervals."
            )
            svg = self._figures.visible_recall(seen)
            items.append(self._figure("visible-share", caption, svg, self._pooled))
        items += self._per_set("visible", seen, report.visible_table)
        return Section("Occlusion", "", tuple(items))

    def _measures(self) -> Section:
        items = self._per_set("measures", self._summaries, report.measure_table)
        text = (
            "ADI is the paper's: the mean distance from the points of the model at the estimated "
            "pose to the nearest point of the model at the true pose. The BOP toolkit goes the "
            "other way, from the true pose's points to the estimate's; both are given. ADD is "
            "taken to the pose that looks like the truth and is turned least from the estimate. "
            "VSD, MSSD and MSPD, their thresholds and their average recall (AR) are BOP's, over "
            "the symmetries of the object's model."
        )
        return Section("Other measures", text, tuple(items))

    def _ablation(self) -> Section:
        panels = self._summarised(lambda name: self._study.results(name, ablation=True))
        panels = {
            name: {method.removeprefix(ABLATION): s for method, s in steps.items()}
            for name, steps in panels.items()
        }
        if not panels:
            return Section("Ablation", "", ())
        steps = [method for method in self._study.by_method if method.startswith(ABLATION)]
        caption = "Recall as one part after the other is added, with 95 % intervals."
        figure = self._figure("ablation", caption, figures.ablation_bars(panels), steps)
        items = self._per_set("ablation", panels, report.ablation_table, steps)
        text = "Every step keeps those before it."
        return Section("Ablation", text, (figure, *items))

    def _perturbations(self) -> Section:
        items = []
        for name in self._study.data_sets:
            of = self._study.perturbed_results(name)
            if not of:
                continue
            level = {m: r for m, r in self._study.results(name).items() if m == self._reference}
            caption = (
                f"{name}: recall of methods that start from the perturbed true pose, with 95 % "
                "intervals. The level line is a method that does without."
            )
            svg = self._figures.perturbation_curves(of, level)
            items.append(self._figure(f"perturbation-{name}", caption, svg, [*of, *level], name))
            table = report.perturbation_table(of)
            items.append(self._table(f"perturbation-table-{name}", name, table, of))
        return Section("Perturbed starts", "", tuple(items))

    def _sweeps(self) -> Section:
        items = []
        for name in self._study.data_sets:
            swept = self._study.swept_results(name)
            if not swept:
                continue
            every = {m: [*self._study.results(name).get(m, []), *of] for m, of in swept.items()}
            caption = (
                f"{name}: recall, with 95 % intervals, and mean confidence (dotted) by what is "
                "wrong with the frames. Both should fall together."
            )
            svg = self._figures.sweep_curves(every)
            items.append(self._figure(f"sweeps-{name}", caption, svg, every))
            for method, results in every.items():
                for sweep in by_level(results):
                    table = sweep_table(method, sweep, results)
                    items.append(self._table(f"sweep-{sweep}-{name}", name, table, [method]))
        text = "Frames made harder, step by step; see `inhand bench --sweep`."
        return Section("Robustness", text, tuple(items))

    def _times(self) -> Section:
        timed = {m: s for m, s in self._pooled.items() if s["time"]["whole estimate"]["count"]}
        if not timed:
            return Section("Time", "", ())
        caption = "Mean time of every stage. Rest: what no stage accounts for."
        staged = {m: s for m, s in timed.items() if _is_pipeline(s)}
        items = (
            self._figure("time", caption, figures.time_bars(timed), timed),
            self._table("time-table", EVERYWHERE, report.time_table(timed), timed),
            self._table("time-stages", EVERYWHERE, report.stage_time_table(staged), staged),
        )
        text = (
            "Wall clock of one estimate. The first frame of every object is run once more before "
            "it is timed, so that nothing is compiled or loaded in it."
        )
        return Section("Time", text, items)

    def _hand(self) -> Section:
        panels = _where(self._summaries, lambda s: s["finger_error"]["all"]["count"])
        items = []
        for name, summaries in panels.items():
            results = {m: self._study.results(name)[m] for m in summaries}
            svg = self._figures.error_curves(_hand_errors(results))
            caption = f"{name}: share of joints, and of frames, whose error is below a limit."
            items.append(self._figure(f"hand-{name}", caption, svg, results, name))
        items += self._per_set("hand-table", panels, report.hand_table)
        return Section("Hand", "", tuple(items))

    def _confidence(self) -> Section:
        sure = _where(self._summaries, lambda s: len(s["confidence"]["reliability"]) > 1)
        if not sure:
            return Section("Confidence", "", ())
        caption = (
            "Reliability: how often answers of a confidence are right (ADI < 5 mm), with 95 % "
            "intervals. On the grey line the confidence says just that."
        )
        # What other methods give is a score, which promises nothing.
        drawn = _where(sure, _is_pipeline) or sure
        methods = {method for summaries in drawn.values() for method in summaries}
        svg = self._figures.reliability_curves(drawn)
        figure = self._figure("reliability", caption, svg, methods)
        items = self._per_set("confidence", sure, report.confidence_table)
        return Section("Confidence", "", (figure, *items))

    def _stages(self) -> Section:
        staged = {
            name: {m: s for m, s in of.items() if self._has_stages(name, m)}
            for name, of in self._summaries.items()
        }
        staged = {name: summaries for name, summaries in staged.items() if summaries}
        items = self._per_set("alive", staged, report.alive_table)
        items += self._per_set("lost", staged, report.lost_table)
        text = (
            "A frame is lost at the stage after the last one that handed on a good pose (ADI below "
            "10 mm before refinement, 5 mm from there on)."
        )
        return Section("Where frames are lost", text, tuple(items))

    def _has_stages(self, name: str, method: str) -> bool:
        """Whether the method is a variant of the pipeline."""
        return any(r.best_adi for r in self._study.results(name)[method])

    def _frames(self) -> Section:
        items = self._per_set("frames", self._every_summary, report.outcome_table)
        failures = [
            (method, f["frame"], f["outcome"], f["reason"])
            for method, summary in self._pooled.items()
            for f in summary["failures"]
            if f["outcome"] in ("error", "unreadable")
        ]
        if failures:
            note = (
                f"The first {LISTED_FAILURES} of {len(failures)}."
                if failures[LISTED_FAILURES:]
                else ""
            )
            columns = ("method", "frame", "outcome", "reason")
            table = Table("Bad frames", columns, tuple(failures[:LISTED_FAILURES]), note)
            items.append(self._table("bad-frames", EVERYWHERE, table, self._pooled))
        return Section("Frames", "", tuple(items))

    def _per_set(
        self,
        key: str,
        panels: Panels,
        make: Callable[[Mapping[str, Summary]], Table],
        methods: Iterable[str] | None = None,
    ) -> list[Item]:
        """One table a data set."""
        made = {name: make(summaries) for name, summaries in panels.items()}
        return [
            self._table(f"{key}-{name}", name, table, methods or panels[name])
            for name, table in made.items()
            if len(table.columns) > 1
        ]

    def _table(self, key: str, of: str, table: Table, methods: Iterable[str]) -> Item:
        name = None if of == EVERYWHERE else of
        return Item(key, f"{of}: {table.title}", table, self._study.runs(methods, name))

    def _figure(
        self, key: str, caption: str, svg: str, methods: Iterable[str], of: str | None = None
    ) -> Item:
        return Item(key, caption, svg, self._study.runs(methods, of))


def _is_pipeline(summary: Summary) -> bool:
    """Whether the method is a variant of this project's pipeline, by the stages it timed."""
    return any(map(summary["time"].get, POSE_STAGES))


def _where(panels: Panels, holds: Callable[[Summary], object]) -> Panels:
    """The summaries for which something holds, of the data sets that have any."""
    found = {
        name: {method: s for method, s in summaries.items() if holds(s)}
        for name, summaries in panels.items()
    }
    return {name: summaries for name, summaries in found.items() if summaries}


def _hand_errors(results: Results) -> dict[str, dict[str, list[float]]]:
    """Errors of the hand's state by quantity and method, the given wrist among the methods."""
    joints, lengths, angles = {}, {}, {}
    for method, of in results.items():
        joints[method] = [degrees(e) for r in of for e in r.visible_joint_errors.values()]
        found = [r.wrist_errors["answer"] for r in of if "answer" in r.wrist_errors]
        lengths[method] = [1000 * e[0] for e in found]
        angles[method] = [degrees(e[1]) for e in found]
    of = next(iter(results.values()))
    given = [r.wrist_errors["given"] for r in of if "given" in r.wrist_errors]
    lengths["as given"] = [1000 * e[0] for e in given]
    angles["as given"] = [degrees(e[1]) for e in given]
    quantities = {
        "joint angle error [deg]": joints,
        "wrist position error [mm]": lengths,
        "wrist rotation error [deg]": angles,
    }
    return {
        quantity: {method: errors for method, errors in of_methods.items() if errors}
        for quantity, of_methods in quantities.items()
    }
