"""What stands in a report: its sections, with their tables and figures."""

from collections.abc import Callable, Iterable, Mapping

from inhand.evaluation import comparison_tables, figures
from inhand.evaluation.figures import Figures
from inhand.evaluation.panels import Panels, StudyPanels, hand_errors, is_pipeline, where
from inhand.evaluation.sections import Item, Section
from inhand.evaluation.study import ABLATION, UPPER_BOUND, Study
from inhand.evaluation.summary import Summary
from inhand.evaluation.sweep_tables import sweep_table
from inhand.evaluation.sweeps import by_level
from inhand.evaluation.tables import Table

EVERYWHERE = "all data sets"
"""Stands before the title of a table that is not about a single one."""
LISTED_FAILURES = 50
"""Frames that could not be read or that a method failed on, at most this many are named."""


class Contents:
    """Makes the sections of a report.

    Args:
        study: the results.
        reference: the method that the others are compared with.
    """

    def __init__(self, study: Study, reference: str) -> None:
        self._study = study
        self._panels = StudyPanels(study)
        self._reference = reference
        plain = [m for m in study.by_method if not m.startswith(ABLATION)]
        self._figures = Figures(list(dict.fromkeys([*plain, *study.perturbed, *study.swept])))

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
            for name, summaries in self._panels.readable.items()
        }
        items = self._per_set("overview", self._panels.readable, comparison_tables.overview_table)
        if panels:
            caption = "Recall over the ADI threshold. The grey line is the paper's threshold, 5 mm."
            svg = self._figures.recall_curves(panels)
            items.append(self._figure("recall-curves", caption, svg, self._panels.pooled))
        if any(len(summaries) > 1 for summaries in self._panels.readable.values()):
            caption = "Recall over the median time of a frame: up and left is better."
            svg = self._figures.recall_against_time(self._panels.readable)
            items.append(self._figure("recall-against-time", caption, svg, self._panels.pooled))
        for name, results in panels.items():
            if self._reference in results and len(results) > 1:
                table = comparison_tables.difference_table(results, self._reference)
                items.append(self._table(f"difference-{name}", name, table, results))
        text = (
            f"The names of methods that are given the object's true pixels end with {UPPER_BOUND}: "
            "an upper bound, which does not stand out in the tables."
        )
        bounded = any(m.endswith(UPPER_BOUND) for m in self._panels.pooled)
        return Section("Methods", text if bounded else "", tuple(items))

    def _objects(self) -> Section:
        items = self._per_set("objects", self._panels.readable, comparison_tables.object_table)
        return Section("Objects", "", tuple(items))

    def _visible(self) -> Section:
        seen = where(self._panels.readable, lambda s: s["recall"]["visible share"])
        items = []
        if seen:
            caption = (
                "Recall by how much of the object's silhouette is visible, with 95 % intervals."
            )
            svg = self._figures.visible_recall(seen)
            items.append(self._figure("visible-share", caption, svg, self._panels.pooled))
        items += self._per_set("visible", seen, comparison_tables.visible_table)
        return Section("Occlusion", "", tuple(items))

    def _measures(self) -> Section:
        items = self._per_set("measures", self._panels.readable, comparison_tables.measure_table)
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
        panels = self._panels.ablation
        if not panels:
            return Section("Ablation", "", ())
        steps = [method for method in self._study.by_method if method.startswith(ABLATION)]
        caption = "Recall as one part after the other is added, with 95 % intervals."
        figure = self._figure("ablation", caption, figures.ablation_bars(panels), steps)
        items = self._per_set("ablation", panels, comparison_tables.ablation_table, steps)
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
            table = comparison_tables.perturbation_table(of)
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
        timed = {
            m: s for m, s in self._panels.pooled.items() if s["time"]["whole estimate"]["count"]
        }
        if not timed:
            return Section("Time", "", ())
        caption = "Mean time of every stage. Rest: what no stage accounts for."
        staged = {m: s for m, s in timed.items() if is_pipeline(s)}
        items = (
            self._figure("time", caption, figures.time_bars(timed), timed),
            self._table("time-table", EVERYWHERE, comparison_tables.time_table(timed), timed),
            self._table(
                "time-stages", EVERYWHERE, comparison_tables.stage_time_table(staged), staged
            ),
        )
        text = (
            "Wall clock of one estimate. The first frame of every object is run once more before "
            "it is timed, so that nothing is compiled or loaded in it."
        )
        return Section("Time", text, items)

    def _hand(self) -> Section:
        panels = where(self._panels.readable, lambda s: s["finger_error"]["all"]["count"])
        items = []
        for name, summaries in panels.items():
            results = {m: self._study.results(name)[m] for m in summaries}
            svg = self._figures.error_curves(hand_errors(results))
            caption = f"{name}: share of joints, and of frames, whose error is below a limit."
            items.append(self._figure(f"hand-{name}", caption, svg, results, name))
        items += self._per_set("hand-table", panels, comparison_tables.hand_table)
        return Section("Hand", "", tuple(items))

    def _confidence(self) -> Section:
        sure = where(self._panels.readable, lambda s: len(s["confidence"]["reliability"]) > 1)
        if not sure:
            return Section("Confidence", "", ())
        caption = (
            "Reliability: how often answers of a confidence are right (ADI < 5 mm), with 95 % "
            "intervals. On the grey line the confidence says just that."
        )
        # What other methods give is a score, which promises nothing.
        drawn = where(sure, is_pipeline) or sure
        methods = {method for summaries in drawn.values() for method in summaries}
        svg = self._figures.reliability_curves(drawn)
        figure = self._figure("reliability", caption, svg, methods)
        items = self._per_set("confidence", sure, comparison_tables.confidence_table)
        return Section("Confidence", "", (figure, *items))

    def _stages(self) -> Section:
        staged = {
            name: {m: s for m, s in of.items() if self._panels.has_stages(name, m)}
            for name, of in self._panels.readable.items()
        }
        staged = {name: summaries for name, summaries in staged.items() if summaries}
        items = self._per_set("alive", staged, comparison_tables.alive_table)
        items += self._per_set("lost", staged, comparison_tables.lost_table)
        text = (
            "A frame is lost at the stage after the last one that handed on a good pose (ADI below "
            "10 mm before refinement, 5 mm from there on)."
        )
        return Section("Where frames are lost", text, tuple(items))

    def _frames(self) -> Section:
        items = self._per_set("frames", self._panels.every, comparison_tables.outcome_table)
        failures = [
            (method, f["frame"], f["outcome"], f["reason"])
            for method, summary in self._panels.pooled.items()
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
            items.append(self._table("bad-frames", EVERYWHERE, table, self._panels.pooled))
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
