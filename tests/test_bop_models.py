"""Models of a BOP data set: symmetries come back, folders are found, broken files are named."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from bop_nonsense import three_objects, write_dataset

from inhand.datasets.bop_models import load_model, write_models
from inhand.datasets.frames import find_objects, load_object
from inhand.errors import InputError


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "nonsense")


def test_models_come_back_with_their_symmetries(tmp_path: Path) -> None:
    objects = three_objects()
    write_models(tmp_path / "set" / "models", objects)
    (tmp_path / "set" / "test" / "000001").mkdir(parents=True)
    for number, obj in objects.items():
        again = load_object(tmp_path / "set" / "models", obj.name)
        assert again.name == obj.name
        assert again.diameter == pytest.approx(obj.diameter, rel=1e-14)
        np.testing.assert_allclose(again.mesh.bounds, obj.mesh.bounds, rtol=1e-14, atol=1e-17)
        rotations = again.symmetry.rotations, obj.symmetry.rotations
        np.testing.assert_allclose(*rotations, rtol=1e-14, atol=1e-16)
        np.testing.assert_allclose(again.symmetry.centre, obj.symmetry.centre, atol=2e-5)
        assert (again.symmetry.axis is None) == (obj.symmetry.axis is None)
        if obj.symmetry.axis is not None and again.symmetry.axis is not None:
            np.testing.assert_allclose(again.symmetry.axis, obj.symmetry.axis, atol=1e-15)
        independent = trimesh.load_mesh(tmp_path / "set" / "models" / f"obj_{number:06d}.ply")
        np.testing.assert_allclose(independent.bounds, obj.mesh.bounds * 1000, rtol=1e-12)
        assert len(independent.faces) == len(obj.mesh.faces)
    info = json.loads((tmp_path / "set" / "models" / "models_info.json").read_text())
    assert info["1"].keys() & {"symmetries_discrete", "symmetries_continuous"} == set()
    assert len(info["2"]["symmetries_discrete"]) == 7
    assert np.shape(info["3"]["symmetries_continuous"][0]["axis"]) == (3,)
    assert info["3"]["diameter"] == pytest.approx(objects[3].diameter * 1000)
    with pytest.raises(InputError, match=r'no object "sock".*holds: odd, cuboid, rod'):
        load_model(tmp_path / "set" / "models", "sock")


def test_models_folder_is_found(dataset: Path) -> None:
    assert find_objects(dataset, "") == dataset / "models"
    shutil.move(dataset / "models", dataset / "models_eval")
    assert find_objects(dataset / "test", "") == dataset / "models_eval"


def test_broken_models_are_named(dataset: Path) -> None:
    models = dataset / "models"
    (models / "obj_000001.ply").write_bytes((models / "obj_000001.ply").read_bytes()[:200])
    with pytest.raises(InputError, match=r"obj_000001\.ply"):
        load_object(models, "odd")
    info = json.loads((models / "models_info.json").read_text())
    info["2"]["symmetries_discrete"] = [[1, 2, 3]]
    (models / "models_info.json").write_text(json.dumps(info))
    with pytest.raises(InputError, match=r"models_info\.json"):
        load_object(models, "cuboid")
    (models / "models_info.json").write_text("{")
    with pytest.raises(InputError, match=r"models_info\.json"):
        load_object(models, "cuboid")
