"""The objects that may be in the hand; their models are built when they are looked at."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path

from inhand.datasets import bop_models, frames
from inhand.errors import InputError
from inhand.object_model import ObjectModel

MESH_SUFFIXES = (".ply", ".obj", ".stl", ".off", ".glb", ".dae")


@dataclass(frozen=True)
class ObjectSource:
    """An object that may be in the hand."""

    number: int
    """Its number in the data set of labels."""
    load: Callable[[], ObjectModel] = field(repr=False)
    """Its model. Raises InputError when the mesh is broken."""


def find_objects(
    source: Path, objects: Sequence[Path] = (), unit: str = "m"
) -> dict[str, ObjectSource]:
    """The objects that may be in the hand, by name.

    Args:
        source: the folder of images.
        objects: mesh files; by default the models of the data set, or all meshes in the folder
            `objects` beside `source` or above.
        unit: length unit of the mesh files.

    Raises:
        InputError: there is none, a file is missing, or two have the same name.
    """
    if not objects:
        folder = _models_folder(source)
        if bop_models.is_models_folder(folder):
            return {
                name: ObjectSource(number, cache(partial(bop_models.load_model, folder, name)))
                for name, number in bop_models.model_ids(folder).items()
            }
        objects = sorted(f for f in folder.iterdir() if f.suffix.lower() in MESH_SUFFIXES)
    missing = [mesh for mesh in objects if not mesh.is_file()]
    if missing or not objects:
        raise InputError(f"there is no mesh {missing[0]}" if missing else "there are no meshes")
    found = {
        mesh.stem: ObjectSource(1 + i, cache(partial(_load_mesh, mesh, unit)))
        for i, mesh in enumerate(objects)
    }
    if len(found) < len(objects):
        raise InputError(f"two objects have the same name: {', '.join(m.stem for m in objects)}")
    return found


def _models_folder(source: Path) -> Path:
    """The folder of a data set's models, labelled or not, or `objects` beside it or above."""
    near = [source, *source.resolve().parents[:3]]
    models = next((found for f in near if (found := bop_models.find_models(f))), None)
    folder = models or frames.find_upwards(source, "objects")
    if folder is None:
        raise InputError(f"{source} says nothing about the object: name its mesh with --objects")
    return folder


def _load_mesh(mesh: Path, unit: str) -> ObjectModel:
    return replace(ObjectModel.from_mesh(mesh, unit=unit), name=mesh.stem)
