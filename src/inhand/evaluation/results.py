"""Results of a benchmark: one record a frame, on disk as soon as it is there."""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from inhand.errors import InputError
from inhand.whole_file import write_whole

JOINT_PIXELS = 500
"""A joint's angle counts when its link shows more pixels than this."""

Outcome = Literal["answer", "no answer", "error", "unreadable"]


@dataclass(frozen=True)
class FrameResult:
    """What a method did on one frame, and how good it was. Lengths [m], angles [rad]."""

    frame: str
    """Name of the frame."""
    file: str
    """Where it was read from."""
    outcome: Outcome
    """`error`: the method failed; `unreadable`: the file could not be read."""
    reason: str = ""
    """Why there is no answer."""
    object_name: str = ""
    """Name of the object."""
    visible_share: float | None = None
    """Visible share of the object's silhouette."""
    method: str = "inhand"
    """Name of the method."""
    perturbation: dict[str, float] = field(default_factory=dict)
    """What the method or its frame was handicapped by, by name [SI units]; empty for most."""
    T_camera_object: list[list[float]] | None = None
    """Estimated object pose."""
    T_camera_hand: list[list[float]] | None = None
    """Estimated wrist pose."""
    joint_positions: dict[str, float] = field(default_factory=dict)
    """Estimated joint angles by joint name."""
    confidence: float = 0.0
    """The estimator's confidence."""
    adi: float | None = None
    """ADI of the answer; this and the next errors are those of `metrics.PoseScores`."""
    adi_from_truth: float | None = None
    """ADI the other way round."""
    add: float | None = None
    """ADD of the answer to the nearest symmetric pose."""
    mssd: float | None = None
    """Maximum symmetry-aware surface distance."""
    mspd: float | None = None
    """Maximum symmetry-aware projection distance [pixel]."""
    mssd_share: float = 0.0
    """Share of BOP's MSSD thresholds that the answer stays below."""
    mspd_share: float = 0.0
    """Share of BOP's MSPD thresholds that the answer stays below."""
    vsd_share: float = 0.0
    """Share of BOP's VSD tolerances and thresholds that the answer stays below."""
    translation_error: float | None = None
    """Displacement of the object's symmetry centre."""
    rotation_error: float | None = None
    """Rotation to the nearest symmetric pose."""
    candidates_adi: list[float] = field(default_factory=list)
    """ADI of the first ranked candidates."""
    best_adi: dict[str, float | None] = field(default_factory=dict)
    """Smallest ADI among the poses that each stage handed on, by stage; None where it
    handed on nothing."""
    segment: list[float] | None = None
    """Precision and recall of the object segment."""
    wrist_errors: dict[str, list[float]] = field(default_factory=dict)
    """Translation and rotation error: `given`, after `wrist`, after `hand_state`, `answer`."""
    joint_errors: dict[str, float] = field(default_factory=dict)
    """Error of the answer's joint angles by joint name; prismatic joints left out."""
    joint_pixels: dict[str, int] = field(default_factory=dict)
    """Pixels that show the link of each of these joints."""
    lost_at: str | None = None
    """The stage that lost the frame; None when it is solved."""
    timings: dict[str, float] = field(default_factory=dict)
    """Time by stage [s]."""
    seconds: float | None = None
    """Time of the whole estimate [s]."""
    peak_memory: int | None = None
    """The process's peak memory up to here [byte]."""

    @property
    def key(self) -> "Key":
        """What the ledger knows the result by."""
        return result_key(self.frame, self.method, self.perturbation)

    @property
    def visible_joint_errors(self) -> dict[str, float]:
        """Errors [rad] of the joints whose link shows more than `JOINT_PIXELS` pixels."""
        return {
            name: error
            for name, error in self.joint_errors.items()
            if self.joint_pixels[name] > JOINT_PIXELS
        }


Key = tuple[str | tuple[str, float], ...]
"""Frame, method and its perturbation."""


def result_key(frame: str, method: str, perturbation: Mapping[str, float]) -> Key:
    """The key of the result of a method on a frame."""
    return (frame, method, *sorted(perturbation.items()))


@dataclass(frozen=True)
class Record:
    """What a results file holds."""

    path: Path
    """The file."""
    settings: dict[str, Any]
    """What the results depend on, as JSON values."""
    origins: tuple[dict[str, str], ...]
    """What made them: command, commit, machine and versions of every session that added some."""
    results: tuple[FrameResult, ...]
    """The results, in the order in which they were written."""


def read_results(path: Path) -> Record:
    """Read a results file; a last line that was cut short is left out.

    Raises:
        InputError: the file is missing, or is not a results file of this version.
    """
    try:
        lines = _complete(path.read_text()).splitlines()
    except FileNotFoundError as error:
        raise InputError(f"there is no results file {path}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read the results in {path}: {error}") from error
    try:
        settings = json.loads(lines[0])["settings"]
        entries = [json.loads(line) for line in lines[1:]]
        origins = tuple(entry["origin"] for entry in entries if "origin" in entry)
        found = [FrameResult(**entry) for entry in entries if "origin" not in entry]
    except (ValueError, KeyError, IndexError, TypeError) as error:
        raise InputError(
            f"{path} is not a results file of this version ({error}): restart, or choose another "
            "output folder"
        ) from error
    # A run that was started twice at once wrote some results twice.
    results = {result.key: result for result in found}
    return Record(path, settings, origins, tuple(results.values()))


def _complete(text: str) -> str:
    """The text without a last line that was cut short."""
    return text[: text.rfind("\n") + 1]


class Ledger:
    """The results file: one JSON object a line, the settings first.

    A result is on disk as soon as it is appended, so a run that is stopped loses none, and the
    next one goes on with the frames that are not here yet, method by method.

    Args:
        path: the file; made with its folder when it does not exist.
        settings: what the results depend on, as JSON values.
        origin: what makes the results of this session; written before the first of them.
        restart: drop what an earlier run left.

    Raises:
        InputError: the file holds results made with other settings, or something else, or
            cannot be written.
    """

    def __init__(
        self,
        path: Path,
        settings: Mapping[str, Any],
        origin: Mapping[str, str] | None = None,
        *,
        restart: bool = False,
    ) -> None:
        self.path = path
        self.results: dict[Key, FrameResult] = {}
        self._origin = origin
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            text = path.read_text() if path.exists() and not restart else ""
            kept = _complete(text) or json.dumps({"settings": settings}) + "\n"
            if kept != text:
                write_whole(path, kept)
        except OSError as error:
            raise InputError(f"cannot write the results to {path}: {error.strerror}") from error
        self._load(settings)

    def append(self, result: FrameResult) -> None:
        """Write one result.

        Raises:
            InputError: it cannot be written; those before it are on disk.
        """
        entries = (
            [asdict(result)] if self._origin is None else [{"origin": self._origin}, asdict(result)]
        )
        try:
            with self.path.open("a") as file:
                file.writelines(json.dumps(entry) + "\n" for entry in entries)
        except OSError as error:
            raise InputError(
                f"cannot write the results to {self.path}: {error.strerror or error}; those until "
                "then are there, and the same command goes on from them"
            ) from error
        self._origin = None
        self.results[result.key] = result

    def found(self, keys: Iterable[Key]) -> list[FrameResult]:
        """The results with these keys that are here."""
        return [self.results[key] for key in keys if key in self.results]

    def record(self, results: Iterable[FrameResult]) -> Iterator[FrameResult]:
        """Results as they come, each written before it is handed on."""
        for result in results:
            self.append(result)
            yield result

    def _load(self, settings: Mapping[str, Any]) -> None:
        record = read_results(self.path)
        earlier = record.settings
        changed = [k for k in {**earlier, **settings} if earlier.get(k) != settings.get(k)]
        if changed:
            raise InputError(
                f"{self.path} holds results with another {', '.join(changed)}: restart, or choose "
                "another output folder"
            )
        if record.origins and record.origins[-1] == self._origin:
            self._origin = None
        self.results = {result.key: result for result in record.results}


def source_key() -> str:
    """Hash of the package's source code: results of different code are not mixed."""
    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
