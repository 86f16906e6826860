"""A report of a study: what stands in it, and pictures of frames."""

import io
from functools import cache

from PIL import Image

from inhand.datasets.frames import load_object
from inhand.errors import InputError
from inhand.evaluation.contact_sheet import ContactSheet, hardest_solved, worst_frames
from inhand.evaluation.contents import Contents
from inhand.evaluation.machine import origin
from inhand.evaluation.page import Pictures, Report
from inhand.evaluation.results import FrameResult, Record
from inhand.evaluation.study import Study
from inhand.evaluation.summary import is_solved
from inhand.hand import Hand
from inhand.object_model import ObjectModel

DEFAULT_REFERENCE = "inhand"
"""The method that others are compared with, unless told otherwise."""
_CAPTION = "Contours: green the true object, red the estimated one, blue the estimated hand."


def make_report(
    study: Study, title: str, reference: str | None = None, pictures: int = 0
) -> Report:
    """A report of the results.

    Args:
        study: the results.
        title: title of the page.
        reference: method that the others are compared with and whose frames are shown.
        pictures: number of successes, and of failures, in the gallery of each data set.

    Raises:
        InputError: there is no such method.
    """
    methods = list(study.by_method) or [*study.perturbed, *study.swept]
    if reference is not None and reference not in methods:
        raise InputError(f'there is no method "{reference}" in the results: {", ".join(methods)}')
    if reference is None:
        reference = DEFAULT_REFERENCE if DEFAULT_REFERENCE in methods else methods[0]
    remarks = study.remarks()
    gallery = _gallery(study, reference, pictures, remarks) if pictures else []
    sections = Contents(study.led_by(reference), reference).sections()
    return Report(
        title=title,
        facts=tuple(_facts(study)),
        remarks=tuple(remarks),
        sections=tuple(sections),
        gallery=tuple(gallery),
        records=study.records,
        made_by=origin("cpu"),
    )


def _facts(study: Study) -> list[str]:
    facts = []
    for name in study.data_sets:
        methods = {**study.results(name), **study.results(name, ablation=True)}
        harder = {**study.perturbed_results(name), **study.swept_results(name)}
        every = [*methods.values(), *harder.values()]
        frames = {r.frame for of in every for r in of}
        objects = sorted({r.object_name for of in every for r in of if r.object_name})
        facts.append(
            f"{name}: {len(frames)} frames of {len(objects)} objects ({', '.join(objects)})."
        )
    facts.append(
        "A frame is solved when the ADI of the answer is below 5 mm. Shares are in percent, with "
        "95 % confidence intervals."
    )
    return facts


def _gallery(study: Study, method: str, count: int, remarks: list[str]) -> list[Pictures]:
    """Successes and failures of a method; what cannot be drawn is told in `remarks`."""
    groups = []
    for name in study.data_sets:
        results = study.results(name).get(method, [])
        kinds = {
            "solved with the least of the object visible": hardest_solved(results, count),
            "failures": [r for r in worst_frames(results, count) if not is_solved(r)],
        }
        runs = study.runs([method], name)
        try:
            sheet = _contact_sheet(study.records[min(runs)]) if runs else None
        except (InputError, KeyError) as error:
            remarks.append(f"{name}: no pictures of frames: {error}")
            continue
        for kind, shown in kinds.items():
            pngs = [png for r in shown if sheet and (png := _tile(sheet, r, remarks))]
            if pngs:
                title = f"{name}, {method}: {kind}"
                groups.append(Pictures(title, _CAPTION, tuple(pngs), runs))
    return groups


def _contact_sheet(record: Record) -> ContactSheet:
    @cache
    def load(name: str) -> ObjectModel:
        return load_object(record.settings["objects"], name)

    return ContactSheet(Hand.from_urdf(record.settings["hand"]), load)


def _tile(sheet: ContactSheet, result: FrameResult, remarks: list[str]) -> bytes | None:
    """The picture of a frame as PNG; None, and a remark, when it cannot be drawn."""
    try:
        picture = sheet.tile(result)
    except InputError as error:
        remarks.append(f"no picture of {result.frame}: {error}")
        return None
    buffer = io.BytesIO()
    picture.quantize(128, dither=Image.Dither.NONE).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()
