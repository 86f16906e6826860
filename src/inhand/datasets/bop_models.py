"""Object models of a BOP data set: `models/obj_000001.ply` [mm] and `models/models_info.json`.

Besides BOP's fields, `models_info.json` may hold `name`, the object's name in our reports. Meshes
are written with 64-bit coordinates in millimetres, so that they come back to the last bit or the
one before it.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inhand.datasets.exact import metres, millimetres, read_json, rigid
from inhand.errors import InputError
from inhand.geometry.mesh import TriangleMesh
from inhand.object_model import ObjectModel
from inhand.object_symmetry import Symmetry
from inhand.whole_file import write_whole

INFO = "models_info.json"
SAME_BOX = 0.002
"""Meshes of one object, such as one for looking at and one for evaluation, differ by less in their
bounding boxes [m]."""
_FOLDERS = ("models", "models_eval", "models_cad", "models_fine", "models_reconst")
_FACE = np.dtype([("count", "u1"), ("index", "<i4", 3)])


def find_models(dataset: Path) -> Path | None:
    """The folder of models in a data set's folder, or None."""
    return next((dataset / f for f in _FOLDERS if is_models_folder(dataset / f)), None)


def is_models_folder(folder: Path) -> bool:
    """Whether a folder holds BOP models."""
    return (folder / INFO).is_file()


def model_name(models: Path | None, object_id: int) -> str:
    """Name of an object: as `models_info.json` says, or such as `obj_000001`."""
    info = {} if models is None else _info(models).get(object_id, {})
    return str(info.get("name", f"obj_{object_id:06d}"))


def model_ids(models: Path) -> dict[str, int]:
    """Numbers of the objects by name.

    Raises:
        InputError: `models_info.json` is broken.
    """
    return {model_name(models, i): i for i in _info(models)}


def model_id(models: Path, name: str) -> int:
    """Number of the object of a name.

    Raises:
        InputError: there is no such object.
    """
    names = model_ids(models)
    if name not in names:
        raise InputError(
            f'there is no object "{name}" in {models / INFO}; it holds: '
            f"{', '.join(names) or 'no objects'}"
        )
    return names[name]


def model_alike(models: Path, mesh: TriangleMesh) -> int:
    """Number of the object whose model fills the same box as a mesh, in the mesh's own frame.

    Raises:
        InputError: there is none, so the mesh is of another object, or has another origin.
    """
    corners = np.concatenate(mesh.bounds)
    differences = {i: np.abs(_corners(models, i) - corners).max() for i in _info(models)}
    best = min(differences, key=differences.__getitem__, default=None)
    if best is None or differences[best] > SAME_BOX:
        raise InputError(
            f"the mesh is none of the models in {models}: no bounding box there is its own"
        )
    return best


def load_model(models: Path, name: str) -> ObjectModel:
    """The object of a name, with the symmetries that the data set states.

    Raises:
        InputError: there is no such object, or its mesh is missing or broken.
    """
    object_id = model_id(models, name)
    model = ObjectModel.from_mesh(models / f"obj_{object_id:06d}.ply", unit="mm", symmetry="none")
    try:
        symmetry = _read_symmetry(_info(models)[object_id], model.symmetry.centre)
    except (InputError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError(f"the symmetries of {object_id} in {models / INFO}: {error}") from error
    return replace(model, symmetry=symmetry, name=name)


def write_models(models: Path, objects: Mapping[int, ObjectModel]) -> None:
    """Write meshes and `models_info.json`.

    Args:
        models: the folder.
        objects: the models by number.

    Raises:
        InputError: a file cannot be written.
    """
    for object_id, obj in objects.items():
        write_whole(models / f"obj_{object_id:06d}.ply", _ply(obj.mesh))
    entries = [f'  "{i}": {_info_text(obj)}' for i, obj in objects.items()]
    write_whole(models / INFO, "{\n" + ",\n".join(entries) + "\n}\n")


def _corners(models: Path, object_id: int) -> NDArray[np.float64]:
    """The corners of a model's bounding box [m], lowest and highest, shape (6,)."""
    info = _info(models)[object_id]
    try:
        low = metres(info[f"min_{axis}"] for axis in "xyz")
        return np.concatenate([low, low + metres(info[f"size_{axis}"] for axis in "xyz")])
    except (KeyError, ValueError) as error:
        raise InputError(f"the box of object {object_id} in {models / INFO}: {error!r}") from error


def _info(models: Path) -> dict[int, dict[str, Any]]:
    return _read_info(models / INFO, (models / INFO).stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _read_info(path: Path, _changed: int) -> dict[int, dict[str, Any]]:
    try:
        return {int(key): dict(fields) for key, fields in read_json(path).items()}
    except (ValueError, TypeError) as error:
        raise InputError(f"{path} must hold fields by object number: {error}") from error


def _ply(mesh: TriangleMesh) -> bytes:
    """A binary PLY file of a mesh, coordinates in millimetres."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(mesh.vertices)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(mesh.faces)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(mesh.faces), dtype=_FACE)
    faces["count"], faces["index"] = 3, mesh.faces
    return header.encode() + (mesh.vertices * 1000).astype("<f8").tobytes() + faces.tobytes()


def _info_text(obj: ObjectModel) -> str:
    """An entry of `models_info.json`; lengths in millimetres."""
    low, high = obj.mesh.bounds
    numbers = dict(zip(("min_x", "min_y", "min_z"), millimetres(low), strict=True))
    sizes = millimetres(high - low)
    numbers |= dict(zip(("size_x", "size_y", "size_z"), sizes, strict=True))
    numbers["diameter"] = millimetres([obj.diameter])[0]
    fields = [f'"{key}": {number}' for key, number in numbers.items()]
    fields.append(f'"name": {json.dumps(obj.name)}')
    symmetry = obj.symmetry
    if len(symmetry.rotations) > 1:
        matrices = ", ".join(f"[{', '.join(_elements(T))}]" for T in symmetry.rotations[1:])
        fields.append(f'"symmetries_discrete": [{matrices}]')
    if symmetry.axis is not None:
        offset = ", ".join(millimetres(symmetry.centre))
        axis = json.dumps(symmetry.axis.tolist())
        fields.append(f'"symmetries_continuous": [{{"axis": {axis}, "offset": [{offset}]}}]')
    return "{" + ", ".join(fields) + "}"


def _elements(T: NDArray[np.float64]) -> list[str]:
    """The 16 elements of a transform, row by row, its translation in millimetres."""
    elements = []
    for row, t in zip(T[:3, :3], millimetres(T[:3, 3]), strict=True):
        elements += [*map(repr, row.tolist()), t]
    return [*elements, "0.0", "0.0", "0.0", "1.0"]


def _read_symmetry(info: Mapping[str, Any], centre: NDArray[np.float64]) -> Symmetry:
    """The symmetry that an entry of `models_info.json` states.

    Of several continuous axes (a sphere), the first is taken. `centre` is the object's, shape (3,).
    """
    rotations = [np.eye(4)]
    for elements in info.get("symmetries_discrete", []):
        M = np.array(elements, dtype=object).reshape(4, 4)
        R = np.array(M[:3, :3], dtype=np.float64)
        rotations.append(rigid(R, metres(M[:3, 3]), "symmetries_discrete"))
    continuous = info.get("symmetries_continuous", [])
    if continuous:
        axis = np.array(continuous[0]["axis"], dtype=np.float64)
        return Symmetry(metres(continuous[0]["offset"]), axis, np.stack(rotations))
    return Symmetry(_fixed_point(np.stack(rotations), centre), None, np.stack(rotations))


def _fixed_point(rotations: NDArray[np.float64], near: NDArray[np.float64]) -> NDArray[np.float64]:
    """The point that all transforms leave in place which is nearest to a given one, shape (3,)."""
    A = np.concatenate([np.eye(3) - T[:3, :3] for T in rotations])
    b = np.concatenate([T[:3, 3] for T in rotations])
    return np.asarray(near + np.linalg.lstsq(A, b - A @ near, rcond=1e-6)[0])
