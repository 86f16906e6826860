"""Labels as ground truth: a BOP data set with the hand's file, which `inhand bench` reads.

Masks, boxes and visible shares come from rendering hand and object where the labels put them. A
pixel where the camera read something clearly in front of them shows that, not them.
"""

import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inhand.annotation.images import ImageFile, RawImage
from inhand.annotation.session import Label, Session
from inhand.datasets.bop import DEPTH_UNIT, SPLIT, BopImage, HandInfo, HandTruth, Instance
from inhand.datasets.bop_models import write_models
from inhand.datasets.bop_writer import finish_scene, write_dataset_files, write_image
from inhand.errors import InputError
from inhand.evaluation.symmetric_poses import nearest_symmetric
from inhand.hand import Hand
from inhand.object_model import ObjectModel
from inhand.synth.renderer import BACKGROUND_BODY, NO_BODY, OBJECT_BODY, Images, SceneRenderer
from inhand.whole_file import write_whole

IN_FRONT = 0.015
"""A reading this far in front of a model hides it [m]: BOP's tolerance for visibility masks."""
FARTHEST = np.iinfo(np.uint16).max * DEPTH_UNIT
"""Readings beyond this do not fit the depth images that are written [m]."""
SOURCES = "sources.json"
"""File in a scene's folder that says which image came from which."""


@dataclass(frozen=True, eq=False)
class LabelledHand:
    """The hand of a data set."""

    model: Hand
    urdf: Path
    """Its URDF, which the data set refers to."""
    package_paths: Mapping[str, Path] = field(default_factory=dict)
    """Folders of the ROS packages that the URDF names."""

    @property
    def info(self) -> HandInfo:
        """What `scene_hand.json` says about all images."""
        meanings = {1 + i: link.name for i, link in enumerate(self.model.links)}
        meanings |= {BACKGROUND_BODY: "background", OBJECT_BODY: "object"}
        return HandInfo(self.urdf, meanings, self.package_paths)


def write_ground_truth(
    folder: Path,
    session: Session,
    files: Sequence[ImageFile],
    hand: LabelledHand,
    objects: Mapping[str, tuple[int, ObjectModel]],
    tell: Callable[[int, int], None] = lambda done, total: None,
) -> int:
    """Write a data set of all images that are labelled, instead of the one written before.

    Args:
        folder: the data set's folder.
        session: the labels.
        files: the images.
        hand: the hand.
        objects: numbers and models of the objects by name.
        tell: called with the number of images written, and of all.

    Returns:
        the number of images.

    Raises:
        InputError: no image is labelled, an image cannot be read, or a file cannot be written. The
            data set written before is still there.
    """
    labelled = [file for file in files if session.status(file.name) == "labelled"]
    if not labelled:
        raise InputError("no image is labelled yet, so there is nothing to write")
    makers = {name: ImageMaker(hand.model, number, obj) for name, (number, obj) in objects.items()}
    camera = None
    with _unfinished(folder) as split:
        for done, file in enumerate(labelled):
            tell(done, len(labelled))
            raw, label = file.read(), session.labels[file.name]
            image = makers[label.object_name].make(raw, label)
            camera = camera or image.camera
            write_image(_scene(split, file), file.image_id, image)
        assert camera is not None
        for scene in sorted({_scene(split, file) for file in labelled}):
            finish_scene(scene, hand.info)
            sources = {f.image_id: f.name for f in labelled if _scene(split, f) == scene}
            write_whole(scene / SOURCES, json.dumps(sources, indent=1) + "\n")
        write_models(folder / "models", dict(objects.values()))
        _put_in_place(split, folder / SPLIT)
    scenes = sorted({_scene(folder / SPLIT, file) for file in labelled})
    write_dataset_files(folder, camera, scenes)
    return len(labelled)


class ImageMaker:
    """Makes annotated images of one hand and object.

    Args:
        hand: the hand.
        object_id: number of the object in the data set.
        obj: the object.
    """

    def __init__(self, hand: Hand, object_id: int, obj: ObjectModel) -> None:
        self._hand, self._object_id = hand, object_id
        self._renderer, self._symmetry = SceneRenderer(hand, obj), obj.symmetry

    def make(self, raw: RawImage, label: Label) -> BopImage:
        """An image with its label as ground truth.

        Of the poses that the object's symmetry makes alike, the one that is turned least is
        written, whichever the label holds: they count as one.

        Args:
            raw: the image. Where the wrist pose is not known, the label's is what estimators are
                given.
            label: the label.
        """
        q = self._hand.joint_vector(label.joint_positions)
        T_camera_object = nearest_symmetric(self._symmetry, np.eye(4), label.T_camera_object)
        links = label.T_camera_hand @ self._hand.forward_kinematics(q)
        depth = np.where(raw.depth <= FARTHEST, raw.depth, np.float32(0))
        rendered = self._renderer.render(raw.camera, T_camera_object, links)
        segmentation = _what_is_seen(rendered, raw.depth)
        given = label.T_camera_hand if raw.T_camera_hand is None else raw.T_camera_hand
        by_name = self._hand.link_poses(label.joint_positions)
        return BopImage(
            camera=replace(raw.camera, depth_unit=DEPTH_UNIT),
            depth=depth,
            instances=(
                Instance(
                    object_id=self._object_id,
                    T_camera_object=T_camera_object,
                    mask=rendered.object_depth > 0,
                    mask_visible=segmentation == OBJECT_BODY,
                    silhouette_pixels=self._renderer.silhouette_pixels(
                        raw.camera, T_camera_object, rendered
                    ),
                    depth=rendered.object_depth,
                ),
            ),
            rgb=raw.rgb,
            hand=HandTruth(
                T_camera_hand=label.T_camera_hand,
                T_camera_hand_given=given,
                joint_positions=self._hand.joint_dict(q),
                T_camera_link={name: label.T_camera_hand @ T for name, T in by_name.items()},
            ),
            segmentation=segmentation,
        )


def _what_is_seen(rendered: Images, observed: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Body that each pixel shows, shape (H, W); values as in `synth.renderer.Images`."""
    seen = rendered.segmentation.copy()
    hidden = (observed > 0) & (observed < rendered.depth - IN_FRONT)
    seen[hidden | ((seen == NO_BODY) & (observed > 0))] = BACKGROUND_BODY
    return seen


def _scene(split: Path, file: ImageFile) -> Path:
    return split / f"{file.scene_id:06d}"


@contextmanager
def _unfinished(folder: Path) -> Iterator[Path]:
    """A folder for what is not finished; it is gone at the end, unless it was put in place."""
    path = folder / "unfinished"
    shutil.rmtree(path, ignore_errors=True)  # of a process that was killed
    try:
        yield path
    finally:
        shutil.rmtree(path, ignore_errors=True)  # on a full disk, the labels need the room


def _put_in_place(new: Path, place: Path) -> None:
    """Rename a folder, instead of the one that may be there.

    Raises:
        InputError: it cannot be renamed.
    """
    old = place.with_name(f"old-{place.name}")
    shutil.rmtree(old, ignore_errors=True)
    try:
        with suppress(FileNotFoundError):
            os.replace(place, old)
        os.replace(new, place)
    except OSError as error:
        raise InputError(f"cannot write {place}: {error.strerror or error}") from error
    shutil.rmtree(old, ignore_errors=True)
