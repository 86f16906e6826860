"""A whole data set in BOP's layout, made image by image from its plan.

One scene for every object and hand colour: single images, or one sequence of images. Every image
is drawn from its own seed (that of the plan, the scene's and the image's number), and a sequence's
motion from the scene's, so the data set does not depend on the order in which its images are made,
on how many processes make them, or on how often the work was stopped.
"""

import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from inhand.builtin.hand import write_hand
from inhand.datasets.bop import DEPTH_UNIT, BopImage, HandInfo, HandTruth, Instance
from inhand.datasets.bop_models import write_models
from inhand.datasets.bop_scene import is_scene
from inhand.datasets.bop_writer import finish_scene, is_written, write_dataset_files, write_image
from inhand.datasets.exact import read_json
from inhand.errors import InputError
from inhand.synth.plan import Plan, hand_urdf, load_hand, load_object, scene_folder
from inhand.synth.renderer import BACKGROUND_BODY, OBJECT_BODY
from inhand.synth.scene import HAND_COLOURS, OBJECT_COLOURS, Scene, SceneMaker
from inhand.synth.sequence import SequenceMaker
from inhand.whole_file import write_whole

PLAN = "synth.json"
"""File in the data set's folder that holds its plan."""
MOTION = (0, 1)
"""What the seed of a sequence's motion ends with; those of images end with one number."""


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
        _write_builtin_hand(folder / "hand")
    write_models(folder / "models", models)


def _write_builtin_hand(place: Path) -> None:
    unfinished = place.with_name(f".unfinished-{place.name}")
    try:
        write_hand(unfinished)
        os.replace(unfinished, place)
    except OSError as error:
        raise InputError(f"cannot write {place}: {error.strerror or error}") from error


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
        image = replace(annotated(scene, 1 + plan.object_index(scene_id)), time=time)
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


def annotated(scene: Scene, object_id: int) -> BopImage:
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
