"""What a data set is made of, and where its parts are."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import inhand
from inhand.builtin.objects import OBJECTS
from inhand.camera import Camera
from inhand.datasets.bop import SPLIT
from inhand.errors import InputError
from inhand.hand import Hand
from inhand.object_model import ObjectModel
from inhand.synth.demo import CAMERA
from inhand.synth.motion import MotionProtocol
from inhand.synth.scene import HAND_COLOURS, SceneProtocol

FARTHEST = 4.0
"""Largest distance of the camera [m]: depth images of 16 bits in steps of 0.1 mm end at 6.5 m."""


@dataclass(frozen=True)
class Plan:
    """What a data set is made of.

    The default is the paper's: 6 objects, 2 hand colours, 1000 images of each pair.

    Raises:
        InputError: a field makes no sense.
    """

    hand: Path | None = None
    """URDF of the hand; None: the project's own."""
    package_paths: Mapping[str, Path] = field(default_factory=dict)
    """Folders of the ROS packages that the URDF names."""
    objects: tuple[str, ...] = tuple(OBJECTS)
    """Mesh files, or names of the project's own objects."""
    unit: str = "m"
    """Unit of the mesh files: m, cm, mm or inch."""
    colours: tuple[str, ...] = tuple(HAND_COLOURS)
    """Colours of the hand, by name."""
    number: int = 1000
    """Images of every object and colour."""
    seed: int = 0
    """Seed of everything random."""
    camera: Camera = CAMERA
    """The camera."""
    protocol: SceneProtocol = field(default_factory=SceneProtocol)
    """What the scenes are drawn from; of its `visible`, see the next."""
    visible: tuple[float, ...] = (0.05, 1.0)
    """Edges of ranges of the object's visible share. Images take the ranges in turn; a sequence's
    first image lies within all of them together."""
    motion: MotionProtocol | None = None
    """What motions are drawn from if every scene is a sequence; None: single images."""

    def __post_init__(self) -> None:
        low, high = self.protocol.distance
        nearest, farthest = self.protocol.backdrop or (0.0, 0.0)
        wrist = (self.protocol.wrist_translation, self.protocol.wrist_rotation)
        motion = self.motion or MotionProtocol()
        rate, rest = motion.rate, motion.rest
        edges = np.array(self.visible)
        names = self.object_names
        checks = {
            f"number must be at least 1, got {self.number}": self.number >= 1,
            f"seed must not be negative, got {self.seed}": self.seed >= 0,
            "name at least one object and one colour": bool(self.objects and self.colours),
            f"two objects have the same name: {', '.join(names)}": len(set(names)) == len(names),
            f"distance must be two numbers in order between 0 and {FARTHEST} m, got {low} and "
            f"{high}": 0 < low <= high <= FARTHEST,
            f"visible must be rising shares between 0 and 1, got {self.visible}": len(edges) > 1
            and bool((np.diff(edges) > 0).all() and edges[0] >= 0 and edges[-1] <= 1),
            f"clutter must not be negative, got {self.protocol.clutter}": self.protocol.clutter
            >= 0,
            f"backdrop must be two distances in order from 0 m on, got {nearest} and {farthest}": 0
            <= nearest
            <= farthest
            < np.inf,
            f"rate must be above 0 and rest a share from 0 to 1, got {rate} and {rest}": rate > 0
            and 0 <= rest <= 1,
            f"the wrist's errors must not be negative, got {wrist}": all(
                0 <= sd < np.inf for sd in wrist
            ),
        }
        for problem, fine in checks.items():
            if not fine:
                raise InputError(problem)
        for colour in self.colours:
            if colour not in HAND_COLOURS:
                known = ", ".join(HAND_COLOURS)
                raise InputError(f'unknown colour "{colour}" of the hand; known: {known}')

    @property
    def object_names(self) -> list[str]:
        """Names of the objects in the data set."""
        return [name if name in OBJECTS else Path(name).stem for name in self.objects]

    def scene_ids(self) -> range:
        """Numbers of the scenes: colour by colour for the first object, then the next."""
        return range(1, 1 + len(self.objects) * len(self.colours))

    def object_index(self, scene_id: int) -> int:
        """Index into `objects` of the object in a scene."""
        return (scene_id - 1) // len(self.colours)

    def colour(self, scene_id: int) -> str:
        """Colour of the hand in a scene."""
        return self.colours[(scene_id - 1) % len(self.colours)]

    def visible_range(self, image_id: int) -> tuple[float, float]:
        """Range of the visible share in an image."""
        i = image_id % (len(self.visible) - 1)
        return self.visible[i], self.visible[i + 1]

    def as_json(self) -> dict[str, Any]:
        """All fields and the project's version, in JSON's types."""
        fields = {**asdict(self), "version": inhand.__version__}
        return json.loads(json.dumps(fields, default=lambda path: str(path.resolve())))


def scene_folder(folder: Path, scene_id: int) -> Path:
    """The folder of a scene."""
    return folder / SPLIT / f"{scene_id:06d}"


def hand_urdf(folder: Path, plan: Plan) -> Path:
    """The hand's URDF: the plan's, or the project's own within the data set."""
    return plan.hand or folder / "hand" / "adaptive_hand.urdf"


def load_hand(folder: Path, plan: Plan) -> Hand:
    """The hand of a data set that was started."""
    return Hand.from_urdf(hand_urdf(folder, plan), plan.package_paths)


def load_object(plan: Plan, index: int) -> ObjectModel:
    """An object of a data set, by its place in the plan."""
    source = plan.objects[index]
    if source in OBJECTS:
        return replace(ObjectModel.from_mesh(OBJECTS[source]()), name=source)
    if not Path(source).is_file():
        raise InputError(
            f'there is no object "{source}": name a mesh file, or one of {", ".join(OBJECTS)}'
        )
    return ObjectModel.from_mesh(source, unit=plan.unit)
