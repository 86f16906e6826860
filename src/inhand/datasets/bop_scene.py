"""The scenes of a data set in BOP's format: found, and their JSON files read.

The layout is described in `datasets.bop`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from inhand.datasets.bop import CAMERA, HAND, INFO, TRUTH, UNFINISHED, HandInfo
from inhand.datasets.exact import read_json
from inhand.errors import InputError


@dataclass(frozen=True, eq=False)
class SceneFiles:
    """The JSON files of a scene, entries by image."""

    folder: Path
    camera: Mapping[int, Any]
    truth: Mapping[int, Any]
    info: Mapping[int, Any]
    hand: Mapping[int, Any]
    hand_info: HandInfo | None
    """None where the data set has no hand."""


def is_scene(folder: Path) -> bool:
    """Whether a folder is a scene with ground truth, and finished."""
    return (folder / TRUTH).is_file()


def find_scenes(folder: Path) -> list[Path]:
    """The scenes in a data set's folder, in one of its splits', or the scene itself; sorted."""
    found: list[Path] = []
    for pattern in ("", "*/", "*/*/"):
        found = found or sorted(path.parent for path in folder.glob(pattern + TRUTH))
    return found


def dataset_folder(scene: Path) -> Path:
    """The folder of a scene's data set."""
    return scene.resolve().parents[1]


def find_hand(folder: Path) -> Path | None:
    """URDF of the hand in a BOP data set, of a split or of a scene; None if there is none."""
    for scene in find_scenes(folder):
        if hand := read_scene(scene).hand_info:
            return hand.urdf
    return None


def read_scene(scene: Path) -> SceneFiles:
    """The JSON files of a scene.

    Raises:
        InputError: one is missing or broken, or they do not speak of the same images.
    """
    if not is_scene(scene):
        unfinished = (scene / UNFINISHED).is_dir()
        why = (
            "is unfinished: the command that makes it goes on where it stopped"
            if unfinished
            else ""
        )
        raise InputError(f"the scene {scene} {why or f'has no ground truth: there is no {TRUTH}'}")
    files = [scene / name for name in (CAMERA, TRUTH, INFO, HAND)]
    return _read_scene(scene, tuple(f.stat().st_mtime_ns for f in files if f.is_file()))


@lru_cache(maxsize=4)
def _read_scene(scene: Path, _changed: tuple[int, ...]) -> SceneFiles:
    truth = by_image(read_json(scene / TRUTH), scene / TRUTH)
    camera = by_image(read_json(scene / CAMERA), scene / CAMERA)
    info, hand, hand_info = {}, {}, None
    if (scene / INFO).is_file():
        info = by_image(read_json(scene / INFO), scene / INFO)
    if (scene / HAND).is_file():
        fields = read_json(scene / HAND)
        hand_info = _read_hand_info(fields, scene)
        hand = by_image(fields.get("images"), scene / HAND)
    for name, entries in ((CAMERA, camera), (INFO, info), (HAND, hand)):
        missing = sorted(set(truth) - set(entries)) if entries else []
        if missing:
            raise InputError(f"{scene / name} lacks image {missing[0]}, which {TRUTH} has")
    for instances in truth.values():
        if not isinstance(instances, list) or not all("obj_id" in i for i in instances):
            raise InputError(f"{scene / TRUTH} must hold a list of objects by image, with obj_id")
    if info and any(len(info[i]) != len(objects) for i, objects in truth.items()):
        raise InputError(f"{scene / INFO} speaks of other objects than {TRUTH}")
    return SceneFiles(scene, camera, truth, info, hand, hand_info)


def _read_hand_info(fields: Mapping[str, Any], scene: Path) -> HandInfo:
    try:
        return HandInfo(
            urdf=(scene / fields["urdf"]).resolve(),
            segmentation={int(k): str(name) for k, name in fields["segmentation"].items()},
            package_paths={
                name: (scene / folder).resolve()
                for name, folder in fields.get("package_paths", {}).items()
            },
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"{scene / HAND} must hold urdf, segmentation and images: {error!r}"
        ) from error


def by_image(fields: Any, path: Path) -> dict[int, Any]:
    """The entries of one of a scene's JSON files by the image's number.

    Raises:
        InputError: they have other keys.
    """
    try:
        return {int(key): entry for key, entry in fields.items()}
    except (ValueError, AttributeError) as error:
        raise InputError(f"{path} must hold entries by image number: {error}") from error


def entry(entries: Mapping[int, Any], image_id: int, path: Path) -> Any:
    """An image's entry among those of a JSON file.

    Raises:
        InputError: there is none.
    """
    if image_id not in entries:
        raise InputError(f"{path} has no image {image_id}")
    return entries[image_id]
