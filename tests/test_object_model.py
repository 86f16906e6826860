from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from inhand import object_model
from inhand.errors import InputError
from inhand.geometry import se3
from inhand.geometry.mesh import TriangleMesh, box, concatenate, cylinder, sphere, transformed
from inhand.geometry.sampling import sample_surface
from inhand.object_model import ObjectModel
from inhand.object_symmetry import Symmetry, detect_symmetry, rotations_about
from inhand.pair_table import build_pair_table

Array = NDArray[np.float64]


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("INHAND_CACHE_DIR", str(tmp_path / "cache"))


def of_trimesh(solid: trimesh.Trimesh) -> TriangleMesh:
    return TriangleMesh(solid.vertices, solid.faces)


def prism(sides: int, radius: float, length: float) -> TriangleMesh:
    return of_trimesh(trimesh.creation.cylinder(radius, length, sections=sides))


def shifted(mesh: TriangleMesh, x: float, y: float = 0.0, z: float = 0.0) -> TriangleMesh:
    return transformed(mesh, se3.exp(np.array([0, 0, 0, x, y, z])))


def tetrahedron() -> TriangleMesh:
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) * 0.02
    return TriangleMesh(corners, np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]))


def random_pose(seed: int) -> Array:
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = se3.random_rotation(rng), rng.uniform(-0.2, 0.2, 3)
    return T


def symmetry_of(mesh: TriangleMesh) -> Symmetry:
    return detect_symmetry(mesh, sample_surface(mesh, 2000, 0))


# ---- the model ----


def test_model_in_metres_whatever_the_unit(tmp_path: Path) -> None:
    path = tmp_path / "peg.stl"
    trimesh.creation.box([30, 30, 64]).export(path)
    model = ObjectModel.from_mesh(path, unit="mm")
    assert model.name == "peg"
    assert model.diameter == pytest.approx(np.linalg.norm([0.03, 0.03, 0.064]), rel=1e-6)
    assert model.surface.points.shape == (2000, 3)
    assert model.symmetry.rotations.shape == (8, 4, 4)
    inside, outside = model.distance_field.distance(np.array([[0, 0, 0], [0, 0, 0.042]]))
    assert inside == pytest.approx(-0.015, abs=1e-3)
    assert outside == pytest.approx(0.01, abs=1e-4)


def test_same_model_from_file_arrays_and_trimesh(tmp_path: Path) -> None:
    solid = trimesh.creation.box([0.03, 0.04, 0.05])
    solid.export(tmp_path / "box.ply")
    ours = of_trimesh(solid)
    models = [ObjectModel.from_mesh(m) for m in (tmp_path / "box.ply", str(tmp_path / "box.ply"))]
    models += [ObjectModel.from_mesh(solid), ObjectModel.from_mesh(ours)]
    assert [m.name for m in models] == ["box", "box", "object", "object"]
    for model in models:
        assert model.diameter == pytest.approx(np.linalg.norm([0.03, 0.04, 0.05]), rel=1e-6)


def test_frame_origin_may_lie_outside() -> None:
    T = random_pose(5)
    T[:3, 3] = [0.5, -0.3, 0.9]
    model = ObjectModel.from_mesh(transformed(box([0.03, 0.04, 0.05]), T))
    np.testing.assert_allclose(model.centre, T[:3, 3], atol=5e-4)
    np.testing.assert_allclose(model.symmetry.centre, T[:3, 3], atol=5e-4)
    assert model.distance_field.distance(T[None, :3, 3])[0] < -0.01
    assert np.linalg.norm(model.mesh.vertices - model.centre, axis=1).max() < 0.502 * model.diameter


def test_another_voxel_size_is_built_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = cylinder(0.0175, 0.064)
    first = ObjectModel.from_mesh(mesh)
    monkeypatch.setattr(object_model, "SMALLEST_VOXEL", 0.002)
    again = ObjectModel.from_mesh(mesh)
    assert (first.distance_field.voxel, again.distance_field.voxel) == (0.001, 0.002)


def test_second_build_comes_from_the_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = cylinder(0.0175, 0.064)
    first = ObjectModel.from_mesh(mesh)

    def fail(*_: Any) -> None:
        raise AssertionError("built again")

    monkeypatch.setattr(object_model, "_derive", fail)
    again = ObjectModel.from_mesh(mesh)
    for read in (
        lambda m: m.surface.points,
        lambda m: m.surface.normals,
        lambda m: m.distance_field.values,
        lambda m: m.distance_field.origin,
        lambda m: m.pairs.cell_start,
        lambda m: m.pairs.pair_first,
        lambda m: m.pairs.pair_second,
        lambda m: m.symmetry.rotations,
        lambda m: m.symmetry.axis,
        lambda m: m.symmetry.centre,
    ):
        np.testing.assert_array_equal(read(first), read(again))
    assert first.pairs.distance_step == again.pairs.distance_step
    assert first.distance_field.voxel == again.distance_field.voxel


@pytest.mark.parametrize(
    ("size", "unit", "hint"),
    [
        (64.0, "m", 'unit="mm"'),
        (6.4, "m", 'unit="cm"'),
        (2.5, "m", 'unit="inch"'),
        (0.064, "mm", 'unit="m"'),
        (2.0, "mm", 'unit="inch"'),
    ],
)
def test_implausible_size_names_the_likely_unit(size: float, unit: str, hint: str) -> None:
    with pytest.raises(InputError, match="diameter") as error:
        ObjectModel.from_mesh(box([size, size / 2, size / 2]), unit=unit)
    assert hint in str(error.value)


def test_bad_arguments_are_input_errors(tmp_path: Path) -> None:
    good = box([0.03, 0.04, 0.05])
    with pytest.raises(InputError, match=r"unknown unit .* known: m, cm, mm, inch"):
        ObjectModel.from_mesh(good, unit="metre")
    with pytest.raises(InputError, match="symmetry must be"):
        ObjectModel.from_mesh(good, symmetry="round")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="does not exist"):
        ObjectModel.from_mesh(tmp_path / "missing.ply")
    with pytest.raises(InputError, match="triangle mesh"):
        ObjectModel.from_mesh(np.zeros((4, 3)))
    with pytest.raises(InputError, match="no faces"):
        ObjectModel.from_mesh(trimesh.Trimesh())


def test_symmetry_override() -> None:
    mesh = cylinder(0.0175, 0.064)
    none = ObjectModel.from_mesh(mesh, symmetry="none").symmetry
    assert none.axis is None
    np.testing.assert_array_equal(none.rotations, np.eye(4)[None])
    own = Symmetry(np.zeros(3), None, rotations_about(np.zeros(3), np.array([0, 0, 1]), [0, 2, 4]))
    assert ObjectModel.from_mesh(mesh, symmetry=own).symmetry is own


@pytest.mark.parametrize(
    ("centre", "axis", "rotations", "message"),
    [
        ([0, 0], None, np.eye(4)[None], "centre"),
        ([0, 0, np.nan], None, np.eye(4)[None], "centre"),
        ([0, 0, 0], [0, 0, 0], np.eye(4)[None], "axis"),
        ([0, 0, 0], [0, 1], np.eye(4)[None], "axis"),
        ([0, 0, 0], None, np.eye(4), "shape"),
        ([0, 0, 0], None, np.zeros((0, 4, 4)), "shape"),
        ([0, 0, 0], None, 2 * np.eye(4)[None], "last row"),
        ([0, 0, 0], None, np.diag([-1.0, -1, 1, 1])[None], "identity"),
    ],
)
def test_broken_symmetry_is_an_input_error(
    centre: Any, axis: Any, rotations: Any, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        Symmetry(centre, axis, rotations)


# ---- symmetry detection ----


@pytest.mark.parametrize(
    ("mesh", "order"),
    [
        (box([0.03, 0.03, 0.064]), 8),
        (box([0.03, 0.04, 0.064]), 4),
        (box([0.05, 0.05, 0.05]), 24),
        (tetrahedron(), 12),
        (prism(3, 0.02, 0.06), 6),
        (prism(6, 0.02, 0.06), 12),
        (of_trimesh(trimesh.creation.cone(0.02, 0.05, sections=4)), 4),
        (concatenate([cylinder(0.03, 0.08), shifted(box([0.03, 0.008, 0.05]), 0.04)]), 2),
        (concatenate([cylinder(0.03, 0.12), shifted(box([0.02, 0.01, 0.01]), 0.035, 0, 0.04)]), 1),
        (concatenate([box([0.06, 0.04, 0.02]), shifted(box([0.01] * 3), 0.02, 0.01, 0.012)]), 1),
    ],
    ids=[
        "cuboid",
        "box",
        "cube",
        "tetrahedron",
        "prism3",
        "prism6",
        "pyramid",
        "mug",
        "spout",
        "block",
    ],
)
def test_finite_symmetry_in_any_frame(mesh: TriangleMesh, order: int) -> None:
    T = random_pose(order)
    moved = transformed(mesh, T)
    found = symmetry_of(moved)
    assert found.axis is None
    assert found.rotations.shape == (order, 4, 4)
    np.testing.assert_array_equal(found.rotations[0], np.eye(4))
    # Every element maps the surface to itself and the set is a group.
    surface = trimesh.Trimesh(moved.vertices, moved.faces)
    points = sample_surface(moved, 200, 3).points
    for element in found.rotations:
        _, distance, _ = trimesh.proximity.closest_point(surface, se3.transform(element, points))
        assert distance.max() < 0.01 * moved.diameter
    products = (found.rotations[:, None] @ found.rotations).reshape(-1, 4, 4)
    angles = se3.rotation_angle(products[:, None, :3, :3], found.rotations[None, :, :3, :3])
    assert angles.min(axis=1).max() < np.radians(3)


@pytest.mark.parametrize(
    ("mesh", "flips"),
    [
        (cylinder(0.0175, 0.064), 2),
        (cylinder(0.04, 0.005), 2),
        (of_trimesh(trimesh.creation.cone(0.02, 0.05)), 1),
        (of_trimesh(trimesh.creation.torus(0.03, 0.008)), 2),
        (TriangleMesh(sphere(0.032).vertices * [0.55, 0.55, 1], sphere(0.032).faces), 2),
    ],
    ids=["cylinder", "disc", "cone", "torus", "ellipsoid"],
)
def test_continuous_symmetry_in_any_frame(mesh: TriangleMesh, flips: int) -> None:
    T = random_pose(flips)
    found = symmetry_of(transformed(mesh, T))
    assert found.axis is not None
    assert abs(found.axis @ T[:3, 2]) > np.cos(np.radians(0.5))
    off_axis = np.cross(found.centre - T[:3, 3], T[:3, 2])
    assert np.linalg.norm(off_axis) < 0.005 * mesh.diameter
    assert len(found.rotations) == flips
    if flips == 2:
        np.testing.assert_allclose(found.rotations[1, :3, :3] @ found.axis, -found.axis, atol=1e-9)


def test_sphere_turns_every_way() -> None:
    found = symmetry_of(shifted(sphere(0.03), 0.1))
    np.testing.assert_allclose(found.centre, [0.1, 0, 0], atol=5e-4)
    representatives = found.representatives(24)
    np.testing.assert_array_equal(representatives[0], np.eye(4))
    for seed in range(50):
        R = random_pose(seed)[:3, :3]
        nearest = se3.rotation_angle(representatives[:, :3, :3], R).min()
        assert nearest < np.radians(25)


def test_representatives_of_a_cylinder() -> None:
    found = symmetry_of(cylinder(0.0175, 0.064))
    representatives = found.representatives(12)
    assert representatives.shape == (24, 4, 4)
    np.testing.assert_array_equal(representatives[0], np.eye(4))
    points = sample_surface(cylinder(0.0175, 0.064), 100, 0).points
    for T in representatives:
        moved = se3.transform(T, points)
        assert np.hypot(moved[:, 0], moved[:, 1]).max() < 0.01755
        assert np.abs(moved[:, 2]).max() < 0.03205


def test_development_objects(shared_data: Path) -> None:
    expected = {
        "cylinder": (True, 2),
        "ellipse": (True, 2),
        "005_tomato_soup_can": (True, 1),
        "cuboid": (False, 8),
        "elliptic_cylinder": (False, 4),
        "006_mustard_bottle": (False, 2),
        "tless_21": (False, 1),
    }
    for name, (continuous, rotations) in expected.items():
        mesh = object_model.load_mesh(shared_data / "objects" / f"{name}.ply")
        found = symmetry_of(mesh)
        assert (found.axis is not None, len(found.rotations)) == (continuous, rotations), name


# ---- pair table ----


def test_pair_table_equals_brute_force() -> None:
    mesh = cylinder(0.02, 0.06)
    surface = sample_surface(mesh, 2000, 0)
    table = build_pair_table(surface, mesh.diameter)
    assert (table.n_distance, table.n_angle) == (24, 12)
    assert table.distance_step == pytest.approx(mesh.diameter / 24)
    assert len(table.cell_start) == 24 * 12**3 + 1
    assert table.cell_start[-1] == len(table.pair_first) == len(table.pair_second) == 500 * 499
    cell_of = np.full((500, 500), -1)
    cells = np.repeat(np.arange(24 * 12**3), np.diff(table.cell_start))
    cell_of[table.pair_first, table.pair_second] = cells
    assert (cell_of >= 0).sum() == 500 * 499
    assert (np.diag(cell_of) == -1).all()

    def angle_step(a: Array, b: Array) -> float:
        angle = np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)
        return float(angle / (np.pi / 12))

    rng = np.random.default_rng(0)
    checked = 0
    for i, j in rng.integers(0, 500, (400, 2)):
        if i == j:
            continue
        p, q, n, m = (
            x.astype(np.float64) for x in (*surface.points[[i, j]], *surface.normals[[i, j]])
        )
        d = q - p
        steps = np.array(
            [
                np.linalg.norm(d) / table.distance_step,
                angle_step(n, d),
                angle_step(m, d),
                angle_step(n, m),
            ]
        )
        if np.abs(steps - np.rint(steps)).min() < 1e-3:
            continue  # on the edge of a cell: either side is right
        a, b, c, e = np.floor(steps).astype(int)
        assert cell_of[i, j] == ((a * 12 + b) * 12 + c) * 12 + e
        checked += 1
    assert checked > 150
