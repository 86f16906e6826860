"""Results of one or several benchmark runs, sorted by method and data set."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from inhand.errors import InputError
from inhand.evaluation.results import FrameResult, Record, read_results
from inhand.evaluation.summary import Results, data_set
from inhand.evaluation.sweeps import perturbation_of

ABLATION = "ablation-"
"""Names of methods that are steps of the ablation begin with this."""
UPPER_BOUND = "+mask"
"""Names of methods that are given the object's true pixels end with this."""
UNITS = {"translation": ("mm", 1000.0), "rotation": ("deg", math.degrees(1))}
"""Units in which perturbations are shown, and how many of them are one in SI units."""


@dataclass(frozen=True)
class Study:
    """Everything that a report is made of."""

    records: tuple[Record, ...]
    """What was read."""
    by_method: Results
    """Results of the methods as they are."""
    perturbed: Results
    """Results of methods that were handicapped."""
    swept: Results
    """Results on frames that a sweep made harder."""
    sources: Mapping[tuple[str, str], frozenset[int]]
    """Which of the records the results come from, by method, handicapped or not, and data set."""

    @property
    def data_sets(self) -> list[str]:
        """Names of the data sets, sorted."""
        results = [*self.by_method.values(), *self.perturbed.values(), *self.swept.values()]
        return sorted({data_set(r) for of_method in results for r in of_method})

    def led_by(self, method: str) -> "Study":
        """The study with one method before the others."""
        order = sorted(self.by_method, key=lambda m: m != method)
        return replace(self, by_method={m: self.by_method[m] for m in order})

    def results(self, name: str, *, ablation: bool = False) -> Results:
        """Results on one data set, of the methods or of the ablation's steps."""
        found = _on(name, self.by_method)
        return {m: of for m, of in found.items() if m.startswith(ABLATION) == ablation}

    def perturbed_results(self, name: str) -> Results:
        """Results of the handicapped methods on one data set."""
        return _on(name, self.perturbed)

    def swept_results(self, name: str) -> Results:
        """Results on frames of one data set that a sweep made harder."""
        return _on(name, self.swept)

    def runs(self, methods: Iterable[str], name: str | None = None) -> frozenset[int]:
        """Which of the records the methods' results on one data set, or on all, come from."""
        wanted = set(methods)
        found = [
            runs
            for (method, of), runs in self.sources.items()
            if method in wanted and name in (None, of)
        ]
        return frozenset[int]().union(*found)

    def remarks(self) -> list[str]:
        """What a reader must know before comparing the methods: not all ran on the same frames."""
        found = []
        for name in self.data_sets:
            for methods in (self.results(name), self.results(name, ablation=True)):
                frames = {method: {r.frame for r in of} for method, of in methods.items()}
                every = set[str]().union(*frames.values())
                short = [f"{m} on {len(f)}" for m, f in frames.items() if len(f) < len(every)]
                if short:
                    found.append(
                        f"{name}: not every method ran on all {len(every)} frames: "
                        f"{', '.join(short)}"
                    )
        return found


def _on(name: str, results: Results) -> Results:
    """The results on one data set, of the methods that have any."""
    found = {m: [r for r in of if data_set(r) == name] for m, of in results.items()}
    return {method: of for method, of in found.items() if of}


def load_study(paths: Sequence[Path]) -> Study:
    """Read results files, or folders of such.

    A method whose results on a data set were made with different settings (or by different code)
    counts as several methods, told apart by the names of their folders.

    Raises:
        InputError: there is no results file, one is broken, they are all empty, or two hold the
            same method's result on the same frame.
    """
    records = tuple(map(read_results, find_results(paths)))
    clashing = _clashing_methods(records)
    plain: dict[str, list[FrameResult]] = {}
    perturbed: dict[str, list[FrameResult]] = {}
    swept: dict[str, list[FrameResult]] = {}
    sources: dict[tuple[str, str], set[int]] = {}
    first_seen: dict[tuple[object, ...], Path] = {}
    for index, record in enumerate(records):
        for result in record.results:
            label = result.method
            if label in clashing:
                label = f"{label} ({record.path.parent.name})"
            key = (label, result.frame, *sorted(result.perturbation.items()))
            if key in first_seen:
                raise InputError(
                    f"{record.path} and {first_seen[key]} both hold the result of {label} on "
                    f"{result.frame}: leave one of them out"
                )
            first_seen[key] = record.path
            kind = plain
            if result.perturbation:
                kind = swept if perturbation_of(result) else perturbed
            kind.setdefault(label, []).append(result)
            sources.setdefault((label, data_set(result)), set()).add(index)
    if not first_seen:
        raise InputError(f"there is no result in {', '.join(str(r.path) for r in records)}")
    runs = {label: frozenset(indices) for label, indices in sources.items()}
    return Study(records, plain, perturbed, swept, runs)


def find_results(paths: Iterable[Path]) -> list[Path]:
    """The results files that are named, or that lie in the folders that are named.

    Raises:
        InputError: a file or folder is missing, or holds none.
    """
    found: list[Path] = []
    for path in paths:
        files = [path] if path.is_file() else sorted(path.glob("results*.jsonl"))
        files = files or sorted(path.glob("*/results*.jsonl"))
        if not files:
            what = "holds no results*.jsonl" if path.is_dir() else "does not exist"
            raise InputError(f"{path} {what}: name output folders of inhand bench")
        found += [file for file in files if file not in found]
    if not found:
        raise InputError("name at least one output folder of inhand bench")
    return found


def _clashing_methods(records: Sequence[Record]) -> set[str]:
    """Methods with results of different settings on one data set."""
    settings: dict[tuple[str, str], object] = {}
    clashing = set()
    for record in records:
        for result in record.results:
            first = settings.setdefault((result.method, data_set(result)), record.settings)
            if first != record.settings:
                clashing.add(result.method)
    return clashing


def by_quantity(perturbed: Results) -> dict[str, dict[str, dict[float, list[FrameResult]]]]:
    """Results by quantity, method and amount, the amounts in order.

    A result that was handicapped in nothing, by an amount of 0, counts for every quantity.
    """
    quantities = dict.fromkeys(q for of in perturbed.values() for r in of for q in r.perturbation)
    table: dict[str, dict[str, dict[float, list[FrameResult]]]] = {}
    for quantity in quantities:
        table[quantity] = {}
        for method, of in perturbed.items():
            amounts: dict[float, list[FrameResult]] = {}
            for r in of:
                if not any(v for name, v in r.perturbation.items() if name != quantity):
                    amounts.setdefault(r.perturbation.get(quantity, 0.0), []).append(r)
            if amounts:
                table[quantity][method] = dict(sorted(amounts.items()))
    return table
