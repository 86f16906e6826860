"""A whole data set in BOP's layout: its plan, and making it image by image.

One scene for every object and hand colour: single images, or one sequence of images. Every image
is drawn from its own seed (that of the plan, the scene's and the image's number), and a sequence's
motion from the scene's, so the data set does not depend on the order in which its images are made,
on how many processes make them, or on how often the work was stopped.
"""

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import inhand
from inhand.builtin.hand import write_hand
from inhand.builtin.objects import OBJECTS
from inhand.camera import Camera
from inhand.datasets.bop import (
    DEPTH_UNIT,
    SPLIT,
    BopImage,
    HandInfo,
    HandTruth,
    Instance,
    is_scene,
)
from inhand.datasets.bop_models import write_models
from inhand.datasets.bop_writer import finish_scene, is_written, write_dataset_files, write_image
from inhand.datasets.exact import read_json, write_whole
from inhand.errors import InputError
from inhand.hand import Hand
from inhand.object_model import ObjectModel
from inhand.synth.demo import CAMERA
from inhand.synth.motion import MotionProtocol
from inhand.synth.renderer import BACKGROUND_BODY, OBJECT_BODY
from inhand.synth.scene import (
    HAND_COLOURS,
    OBJECT_COLOURS,
    Scene,
    SceneMaker,
    SceneProtocol,
)
from inhand.synth.sequence import SequenceMaker

PLAN = "synth.json"
"""File in the data set's folder that holds its plan."""
MOTION = (0, 1)
"""What the seed of a sequence's motion ends with; those of images end with one number."""
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


def start(folder: Path, plan: Plan) -> None:
    """Write what does not depend on the images: plan, hand and object models.

    Raises:
        InputError: the folder holds another data set, a hand or an object cannot be read, or a
            file cannot be written.
    """
    fields = plan.as_json()
    if (folder / PLAN).is_file():
        earlier = json.loads(json.dumps(read_json(folder / PLAN), default=float))
        changed = [k for k in {**earlier, **fields} if earlier.get(k) != fields.get(k)]
        if changed:
            raise InputError(
                f"{folder} holds a data set with another {', '.join(changed)}: choose another "
                "folder, or remove it"
            )
    elif folder.is_dir() and any(folder.iterdir()):
        raise InputError(f"{folder} is not empty and holds no {PLAN}: choose another folder")
    models = {1 + i: load_object(plan, i) for i in range(len(plan.objects))}
    if plan.hand is not None:
        load_hand(folder, plan)
    write_whole(folder / PLAN, json.dumps(fields, indent=1) + "\n")
    if plan.hand is None and not hand_urdf(folder, plan).is_file():
        write_hand(folder / ".hand.unfinished")
        os.replace(folder / ".hand.unfinished", folder / "hand")
    write_models(folder / "models", models)


def missing_images(folder: Path, plan: Plan) -> list[tuple[int, int]]:
    """Numbers of scene and image of everything that is not there yet."""
    return [
        (scene_id, image_id)
        for scene_id in plan.scene_ids()
        if not is_scene(scene_folder(folder, scene_id))
        for image_id in range(plan.number)
        if not is_written(scene_folder(folder, scene_id), image_id)
    ]


class Workshop:
    """Makes images of a data set that was started.

    Args:
        folder: the data set's folder.
        plan: its plan.
        device: Warp device name.
    """

    def __init__(self, folder: Path, plan: Plan, device: str = "cpu") -> None:
        self._folder, self._plan, self._device = folder, plan, device
        self._hand = load_hand(folder, plan)
        self._scene_id = 0
        self._make: Callable[[int, np.random.Generator], tuple[Scene, float | None]] | None = None

    def make(self, scene_id: int, image_id: int) -> None:
        """Make one image and write it.

        Raises:
            InputError: the hand cannot hold the object, or no view of it fits the protocol, or a
                file cannot be written.
        """
        plan = self._plan
        if self._make is None or self._scene_id != scene_id:
            self._make, self._scene_id = self._scene(scene_id), scene_id
        rng = np.random.default_rng([plan.seed, scene_id, image_id])
        scene, time = self._make(image_id, rng)
        image = replace(_annotated(scene, 1 + plan.object_index(scene_id)), time=time)
        write_image(scene_folder(self._folder, scene_id), image_id, image)

    def _scene(
        self, scene_id: int
    ) -> Callable[[int, np.random.Generator], tuple[Scene, float | None]]:
        """What makes an image of a scene, and its time stamp [s], from its number and errors."""
        plan = self._plan
        index = plan.object_index(scene_id)
        edges = (plan.visible[0], plan.visible[-1])
        maker = SceneMaker(
            self._hand,
            load_object(plan, index),
            plan.camera,
            replace(plan.protocol, visible=edges),
            hand_colour=HAND_COLOURS[plan.colour(scene_id)],
            object_colour=OBJECT_COLOURS[index % len(OBJECT_COLOURS)],
            device=self._device,
        )
        if plan.motion is None:
            return lambda i, rng: (maker.make(rng, plan.visible_range(i)), None)
        sequences = SequenceMaker(maker, plan.motion)
        rng_of_motion = np.random.default_rng([plan.seed, scene_id, *MOTION])
        sequence = sequences.plan(plan.number, rng_of_motion)
        return lambda i, rng: (sequences.render(sequence, i, rng), float(sequence.times[i]))


def finish(folder: Path, plan: Plan) -> None:
    """Put the files of all scenes together and write the targets.

    Raises:
        InputError: a file cannot be read or written.
    """
    hand = load_hand(folder, plan)
    meanings = {1 + i: link.name for i, link in enumerate(hand.links)}
    meanings |= {BACKGROUND_BODY: "background", OBJECT_BODY: "object"}
    info = HandInfo(hand_urdf(folder, plan), meanings, plan.package_paths)
    scenes = [scene_folder(folder, scene_id) for scene_id in plan.scene_ids()]
    for scene in scenes:
        finish_scene(scene, info)
    write_dataset_files(folder, plan.camera, scenes)


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


def _annotated(scene: Scene, object_id: int) -> BopImage:
    """A scene as an image of a data set."""
    images = scene.images
    links = scene.hand.link_poses(scene.joint_positions)
    return BopImage(
        camera=replace(scene.camera, depth_unit=DEPTH_UNIT),
        depth=scene.depth,
        instances=(
            Instance(
                object_id=object_id,
                T_camera_object=scene.T_camera_object,
                mask=images.object_depth > 0,
                mask_visible=images.segmentation == OBJECT_BODY,
                silhouette_pixels=scene.silhouette_pixels,
                depth=images.object_depth,
            ),
        ),
        rgb=images.rgb,
        hand=HandTruth(
            T_camera_hand=scene.T_camera_hand,
            T_camera_hand_given=scene.T_camera_hand_given,
            joint_positions=scene.joint_positions,
            T_camera_link={name: scene.T_camera_hand @ T for name, T in links.items()},
        ),
        segmentation=images.segmentation,
    )
