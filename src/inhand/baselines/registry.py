"""All methods by name."""

import importlib
import math
import re
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from inhand.baselines.estimators import ablation, estimators
from inhand.baselines.from_truth import FromTruth
from inhand.baselines.front_end import Source
from inhand.baselines.kiss_matcher import KissMatcher
from inhand.baselines.method import Method
from inhand.baselines.open3d_features import FastGlobalRegistration, FpfhRansac
from inhand.baselines.opencv_ppf import OpenCVPpf
from inhand.baselines.registration import CloudMethod, Registration
from inhand.baselines.super4pcs import Super4PCS
from inhand.errors import InputError
from inhand.packed import PackedObject


class Library(NamedTuple):
    """What a method needs besides the core."""

    module: str
    extra: str
    """Extra of this package that brings it."""


MakeRegistration = Callable[[PackedObject, int], Registration]

REGISTRATIONS: dict[str, tuple[MakeRegistration, Library | None]] = {
    "super4pcs": (Super4PCS, None),
    "fpfh-ransac": (FpfhRansac, Library("open3d", "bench")),
    "fgr": (FastGlobalRegistration, Library("open3d", "bench")),
    "opencv-ppf": (OpenCVPpf, Library("cv2", "bench")),
    "kiss-matcher": (KissMatcher, Library("kiss_matcher", "kiss")),
}
"""Each runs on the hand's whole region, and by these suffixes on other clouds. All but Super4PCS
end with ICP; it comes with and without, as in the paper."""
SOURCES: dict[str, Source] = {"": "region", "+hs": "hs", "+mask": "mask"}

FROM_TRUTH = "icp-from-truth"
"""ICP of what is left without the hand, or of the true pixels, from a perturbed true pose."""
FROM_TRUTH_SOURCES: dict[str, Source] = {"": "hs", "+mask": "mask"}
TRANSLATIONS, ROTATIONS = (0, 2, 5, 10, 15, 20, 30, 40), (5, 10, 20, 30, 45, 60, 90)
"""Perturbations [mm, degree] of the two curves that its bare name stands for."""


def find_methods(names: str, seed: int = 0) -> list[Method]:
    """The methods with these names, separated by commas, each once.

    A few names stand for several methods: `ablation` for all its steps, `icp-from-truth` for its
    perturbation curves; `icp-from-truth@5mm` and `icp-from-truth@10deg` are points on them.

    Raises:
        InputError: a name is unknown, there is none, or a method's library is not installed.
    """
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    methods = {method.label: method for name in wanted for method in _named(name, seed)}
    if not methods:
        raise InputError(f"name at least one method: {', '.join(method_names())}")
    return list(methods.values())


def method_names() -> list[str]:
    """Every name that `find_methods` knows, but for the points on the perturbation curves."""
    curves = [FROM_TRUTH + suffix for suffix in FROM_TRUTH_SOURCES]
    return [*estimators(), *_cloud_methods(0), *curves, "ablation"]


def _named(name: str, seed: int) -> list[Method]:
    """The methods that a name stands for."""
    own, clouds = estimators(seed), _cloud_methods(seed)
    if name in own:
        return [own[name]]
    if name == "ablation":
        return [own[step] for step in ablation()]
    if name in clouds:
        if library := REGISTRATIONS[name.split("+")[0]][1]:
            _check_installed(library, name)
        return [clouds[name]]
    if name.split("@")[0] in (FROM_TRUTH + suffix for suffix in FROM_TRUTH_SOURCES):
        return _from_truth(name, seed)
    raise InputError(f'there is no method "{name}"; known: {", ".join(method_names())}')


def _cloud_methods(seed: int) -> dict[str, Method]:
    """The registrations with all clouds; the true pixels, an upper bound, come last in a name."""
    methods: dict[str, Method] = {}
    for base, (make, _) in REGISTRATIONS.items():
        for icp in ("", "+icp") if base == "super4pcs" else ("",):
            for suffix, source in SOURCES.items():
                name = base + (icp + suffix if source == "mask" else suffix + icp)
                refined = bool(icp) or base != "super4pcs"
                methods[name] = CloudMethod(name, make, source, refined, seed)
    return methods


def _from_truth(name: str, seed: int) -> list[Method]:
    """ICP from the truth with the perturbation in the name, or with those of both curves."""
    base, *amounts = name.split("@")
    source = FROM_TRUTH_SOURCES[base.removeprefix(FROM_TRUTH)]
    perturbations = [dict(map(_amount, amounts))]
    if not amounts:
        perturbations = [{"translation": mm / 1000} for mm in TRANSLATIONS]
        perturbations += [{"rotation": math.radians(angle)} for angle in ROTATIONS]
    return [
        CloudMethod(base, partial(FromTruth, perturbation=p), source, True, seed, p)
        for p in perturbations
    ]


def _amount(text: str) -> tuple[str, float]:
    """Quantity and amount [m, rad] of a perturbation such as 5mm or 10deg."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)(mm|deg)", text)
    if not match:
        raise InputError(f'a perturbation is given as 5mm or 10deg, got "{text}"')
    number = float(match[1])
    if match[2] == "mm":
        return "translation", number / 1000
    return "rotation", math.radians(number)


def _check_installed(library: Library, method: str) -> None:
    """Raise InputError in one line when the library is not there."""
    try:
        importlib.import_module(library.module)
    except (ImportError, OSError) as error:
        missing = isinstance(error, ModuleNotFoundError) and error.name == library.module
        why = (
            f'is not installed: pip install "inhand[{library.extra}]"'
            if missing
            else f"does not load here: {error}"
        )
        raise InputError(f"the method {method} needs {library.module}, which {why}") from error
