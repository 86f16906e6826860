"""Results of a benchmark: one record a frame, on disk as soon as it is there."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from inhand.errors import InputError

JOINT_PIXELS = 500
"""A joint's angle counts when its link shows more pixels than this."""

Outcome = Literal["answer", "no answer", "error", "unreadable"]


@dataclass(frozen=True)
class FrameResult:
    """What the estimator did on one frame, and how good it was. Lengths [m], angles [rad]."""

    frame: str
    """Name of the frame."""
    file: str
    """Where it was read from."""
    outcome: Outcome
    """`error`: the estimator failed; `unreadable`: the file could not be read."""
    reason: str = ""
    """Why there is no answer."""
    object_name: str = ""
    """Name of the object."""
    visible_share: float | None = None
    """Visible share of the object's silhouette."""
    T_camera_object: list[list[float]] | None = None
    """Estimated object pose."""
    T_camera_hand: list[list[float]] | None = None
    """Estimated wrist pose."""
    joint_positions: dict[str, float] = field(default_factory=dict)
    """Estimated joint angles by joint name."""
    confidence: float = 0.0
    """The estimator's confidence."""
    adi: float | None = None
    """ADI of the answer."""
    add: float | None = None
    """ADD of the answer to the nearest symmetric pose."""
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
    def visible_joint_errors(self) -> dict[str, float]:
        """Errors [rad] of the joints whose link shows more than `JOINT_PIXELS` pixels."""
        return {
            name: error
            for name, error in self.joint_errors.items()
            if self.joint_pixels[name] > JOINT_PIXELS
        }


class Ledger:
    """The results file: one JSON object a line, the settings first.

    A result is on disk as soon as it is appended, so a run that is stopped loses none, and the
    next one goes on with the frames that are not here yet.

    Args:
        path: the file; made with its folder when it does not exist.
        settings: what the results depend on, as JSON values.
        restart: drop what an earlier run left.

    Raises:
        InputError: the file holds results made with other settings, or something else, or
            cannot be written.
    """

    def __init__(self, path: Path, settings: Mapping[str, Any], *, restart: bool = False) -> None:
        self.path = path
        self.results: dict[str, FrameResult] = {}
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            lines = [] if restart or not path.exists() else self._complete_lines()
            if not lines:
                path.write_text(json.dumps({"settings": settings}) + "\n")
        except OSError as error:
            raise InputError(f"cannot write the results to {path}: {error.strerror}") from error
        if lines:
            self._load(lines, settings)

    def append(self, result: FrameResult) -> None:
        """Write one result."""
        with self.path.open("a") as file:
            file.write(json.dumps(asdict(result)) + "\n")
        self.results[result.frame] = result

    def _complete_lines(self) -> list[str]:
        """The file's lines; a last line that was cut short is removed."""
        text = self.path.read_text()
        complete = text[: text.rfind("\n") + 1]
        if complete != text:
            self.path.write_text(complete)
        return complete.splitlines()

    def _load(self, lines: list[str], settings: Mapping[str, Any]) -> None:
        try:
            earlier = json.loads(lines[0])["settings"]
            results = [FrameResult(**json.loads(line)) for line in lines[1:]]
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(
                f"{self.path} is not a results file of this version ({error}): restart, or choose "
                "another output folder"
            ) from error
        changed = [k for k in {**earlier, **settings} if earlier.get(k) != settings.get(k)]
        if changed:
            raise InputError(
                f"{self.path} holds results with another {', '.join(changed)}: restart, or choose "
                "another output folder"
            )
        self.results = {result.frame: result for result in results}


def source_key() -> str:
    """Hash of the package's source code: results of different code are not mixed."""
    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
