from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from inhand.errors import InputError
from inhand.geometry import se3
from inhand.geometry.mesh import (
    TriangleMesh,
    box,
    concatenate,
    cylinder,
    from_trimesh,
    load_mesh,
    oriented_outward,
    sphere,
    transformed,
)


def as_trimesh(mesh: TriangleMesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def flipped(mesh: TriangleMesh, which: NDArray[np.bool_]) -> TriangleMesh:
    return TriangleMesh(mesh.vertices, np.where(which[:, None], mesh.faces[:, ::-1], mesh.faces))


@pytest.mark.parametrize("ending", ["stl", "ply", "obj", "off", "glb"])
def test_load_scales_to_metres(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"part.{ending}"
    as_trimesh(box([10, 20, 40])).export(path)
    mesh = load_mesh(path, 0.001)
    np.testing.assert_allclose(np.ptp(mesh.bounds, axis=0), [0.01, 0.02, 0.04], rtol=1e-6)
    assert (len(mesh.vertices), len(mesh.faces)) == (8, 12)


def test_mirroring_scale_keeps_the_faces_outward(tmp_path: Path) -> None:
    path = tmp_path / "part.ply"
    as_trimesh(box([0.01, 0.02, 0.04])).export(path)
    assert as_trimesh(load_mesh(path, (1, -2, 1))).volume == pytest.approx(1.6e-5, rel=1e-5)


def test_scene_parts_are_placed_by_their_transforms(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    for x in (0.0, 0.5):
        T = np.eye(4)
        T[0, 3] = x
        scene.add_geometry(as_trimesh(box([0.1, 0.1, 0.1])), transform=T)
    scene.export(tmp_path / "scene.glb")
    mesh = load_mesh(tmp_path / "scene.glb")
    assert len(mesh.faces) == 24
    np.testing.assert_allclose(mesh.bounds, [[-0.05, -0.05, -0.05], [0.55, 0.05, 0.05]], atol=1e-6)


def test_duplicate_vertices_degenerate_faces_and_unused_vertices_go() -> None:
    corners = [
        [0, 0, 0],
        [1, 0, 0],
        [0, 1, 0],
        [1, 0, 0],
        [1, 1, 0],
        [0, 1, 0],
        [2, 0, 0],
        [9, 9, 9],
    ]
    faces = [[0, 1, 2], [3, 4, 5], [0, 1, 6], [0, 1, 1]]
    mesh = from_trimesh(trimesh.Trimesh(corners, faces, process=False))
    assert (len(mesh.vertices), len(mesh.faces)) == (4, 2)
    np.testing.assert_allclose(mesh.face_areas, 0.5)


def test_unusable_files_are_input_errors(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        load_mesh(tmp_path / "missing.stl")
    broken = tmp_path / "broken.ply"
    broken.write_bytes(b"ply\nthis is no mesh")
    with pytest.raises(InputError, match=r"broken\.ply"):
        load_mesh(broken)
    unknown = tmp_path / "mesh.unknown"
    unknown.write_text("?")
    with pytest.raises(InputError, match=r"mesh\.unknown"):
        load_mesh(unknown)
    cloud = tmp_path / "cloud.ply"
    trimesh.PointCloud(np.random.default_rng(0).random((10, 3))).export(cloud)
    with pytest.raises(InputError, match=r"cloud\.ply"):
        load_mesh(cloud)
    flat = tmp_path / "flat.obj"
    flat.write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    with pytest.raises(InputError, match="zero area"):
        load_mesh(flat)


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (np.zeros((3, 2)), [[0, 1, 2]], "vertices must have shape"),
        (np.zeros((3, 3)), [[0, 1, 2, 2]], "faces must have shape"),
        (np.zeros((3, 3)), np.zeros((0, 3)), "no faces"),
        (np.full((3, 3), np.nan), [[0, 1, 2]], "NaN"),
        (np.zeros((3, 3)), [[0, 1, 3]], "names vertex 3"),
        (np.zeros((3, 3)), [[0, 1, -1]], "names vertex -1"),
    ],
)
def test_broken_arrays_are_input_errors(vertices: Any, faces: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        TriangleMesh(vertices, np.asarray(faces, dtype=np.int32))


@pytest.mark.parametrize("scale", [0.0, (1, 2), (1, np.nan, 1)])
def test_broken_scale_is_an_input_error(scale: Any) -> None:
    with pytest.raises(InputError, match="scale"):
        from_trimesh(as_trimesh(box([1, 1, 1])), scale)


def test_diameter_is_the_largest_vertex_distance() -> None:
    vertices = np.random.default_rng(3).normal(size=(60, 3))
    mesh = TriangleMesh(vertices, np.arange(60, dtype=np.int32).reshape(-1, 3))
    all_distances = np.linalg.norm(vertices[:, None] - vertices, axis=-1)
    assert mesh.diameter == pytest.approx(all_distances.max())
    flat = TriangleMesh(vertices * [1, 1, 0], mesh.faces)
    assert flat.diameter == pytest.approx(
        np.linalg.norm((vertices[:, None] - vertices)[..., :2], axis=-1).max()
    )


def test_content_key_tells_meshes_apart() -> None:
    assert box([1, 2, 3]).content_key == box([1, 2, 3]).content_key
    assert box([1, 2, 3]).content_key != box([1, 2, 3.0001]).content_key


def test_primitives_have_their_volume() -> None:
    assert as_trimesh(box([0.1, 0.2, 0.3])).volume == pytest.approx(0.006)
    assert as_trimesh(cylinder(0.1, 0.5)).volume == pytest.approx(np.pi * 0.005, rel=5e-3)
    assert as_trimesh(sphere(0.1)).volume == pytest.approx(4 / 3 * np.pi * 1e-3, rel=5e-3)
    for mesh in (box([0.1, 0.2, 0.3]), cylinder(0.1, 0.5), sphere(0.1)):
        np.testing.assert_allclose(mesh.bounds.mean(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(np.ptp(cylinder(0.1, 0.5).bounds, axis=0), [0.2, 0.2, 0.5])


def test_transformed_and_concatenate() -> None:
    T = se3.exp(np.array([0.3, -0.2, 0.5, 1, 2, 3.0]))
    moved = transformed(box([1, 2, 3]), T)
    both = concatenate([box([1, 2, 3]), moved])
    np.testing.assert_allclose(both.vertices[8:], se3.transform(T, both.vertices[:8]))
    assert as_trimesh(both).volume == pytest.approx(12)


def test_randomly_wound_faces_turn_outward() -> None:
    rng = np.random.default_rng(0)
    mesh = concatenate([sphere(0.03), transformed(box([0.03] * 3), se3.exp(np.eye(6)[3] * 0.1))])
    mixed = flipped(mesh, rng.random(len(mesh.faces)) < 0.4)
    assert as_trimesh(oriented_outward(mixed)).volume == pytest.approx(as_trimesh(mesh).volume)


def test_inside_out_body_turns_outward_and_a_right_one_is_left_alone() -> None:
    good = cylinder(0.02, 0.05)
    assert oriented_outward(good) is good
    inverted = flipped(good, np.ones(len(good.faces), dtype=bool))
    np.testing.assert_array_equal(oriented_outward(inverted).faces, good.faces)


def test_box_without_a_lid_turns_outward() -> None:
    mesh = box([0.04, 0.04, 0.04])
    open_box = TriangleMesh(mesh.vertices, mesh.faces[:-2][:, ::-1])
    turned = oriented_outward(open_box)
    outward = np.einsum("ij,ij->i", turned.face_normals, turned.triangles.mean(axis=1))
    assert (outward > 0).all()


def test_open_sheet_keeps_its_winding() -> None:
    sheet = TriangleMesh(
        np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]]),
        np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32),
    )
    assert oriented_outward(sheet) is sheet
