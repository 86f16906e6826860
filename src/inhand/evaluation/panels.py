"""What of a study a report shows side by side: summaries by data set and method."""

from collections.abc import Callable, Mapping
from functools import cached_property
from math import degrees

from inhand.evaluation.diagnosis import POSE_STAGES
from inhand.evaluation.study import ABLATION, Study
from inhand.evaluation.summary import Results, Summary, summarise

Panels = Mapping[str, Mapping[str, Summary]]
"""Summaries by data set and method."""


class StudyPanels:
    """Summarises a study.

    Args:
        study: the results.
    """

    def __init__(self, study: Study) -> None:
        self._study = study

    @cached_property
    def every(self) -> Panels:
        """Of all methods."""
        return self._summarise(self._study.results)

    @cached_property
    def readable(self) -> Panels:
        """Of the methods that had a frame that could be read."""
        return where(self.every, lambda s: s["recall"]["all"]["5 mm"]["frames"])

    @cached_property
    def pooled(self) -> dict[str, Summary]:
        """Summaries by method, of all data sets together."""
        return {
            method: summarise(results)
            for method, results in self._study.by_method.items()
            if not method.startswith(ABLATION)
        }

    @cached_property
    def ablation(self) -> Panels:
        """Of an ablation's steps, by their names."""
        panels = self._summarise(lambda name: self._study.results(name, ablation=True))
        return {
            name: {method.removeprefix(ABLATION): s for method, s in steps.items()}
            for name, steps in panels.items()
        }

    def has_stages(self, name: str, method: str) -> bool:
        """Whether a method is a variant of the pipeline, by its results on a data set."""
        return any(r.best_adi for r in self._study.results(name)[method])

    def _summarise(self, results: Callable[[str], Results]) -> Panels:
        found = {
            name: {method: summarise(of) for method, of in results(name).items()}
            for name in self._study.data_sets
        }
        return {name: summaries for name, summaries in found.items() if summaries}


def is_pipeline(summary: Summary) -> bool:
    """Whether the method is a variant of this project's pipeline, by the stages it timed."""
    return any(map(summary["time"].get, POSE_STAGES))


def where(panels: Panels, holds: Callable[[Summary], object]) -> Panels:
    """The summaries for which something holds, of the data sets that have any."""
    found = {
        name: {method: s for method, s in summaries.items() if holds(s)}
        for name, summaries in panels.items()
    }
    return {name: summaries for name, summaries in found.items() if summaries}


def hand_errors(results: Results) -> dict[str, dict[str, list[float]]]:
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
