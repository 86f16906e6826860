from dataclasses import replace

import numpy as np
import pytest
from held_object import CAMERA, HeldObject, held_object

from inhand.camera import Camera
from inhand.config import SelectionConfig
from inhand.geometry.mesh import TriangleMesh
from inhand.geometry.se3 import exp, transform
from inhand.kernels.lcp import pose_lcp
from inhand.stages.render_selection import depth_discrepancies, select_by_rendering
from inhand.stages.results import PoseSet

CONFIG = SelectionConfig(method="render")


def poses_around(scene: HeldObject, count: int) -> PoseSet:
    """Poses up to a centimetre from the true one, which is the last."""
    motions = np.random.default_rng(0).normal(0, 1, (count, 6)) * ([0.3] * 3 + [0.008] * 3)
    motions[-1] = 0
    poses = scene.T_camera_object @ exp(motions)
    return PoseSet(poses.astype(np.float32), np.zeros(count, dtype=np.float32))


def open3d_depth(meshes: list[TriangleMesh], poses: np.ndarray, camera: Camera) -> np.ndarray:
    """Depth image [m] of posed meshes, infinite where nothing is."""
    o3d = pytest.importorskip("open3d", exc_type=ImportError)
    scene = o3d.t.geometry.RaycastingScene()
    for mesh, T in zip(meshes, poses, strict=True):
        vertices = transform(T, mesh.vertices).astype(np.float32)
        scene.add_triangles(vertices, mesh.faces.astype(np.uint32))
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.zeros((camera.height, camera.width, 6), dtype=np.float32)
    rays[..., 3:] = np.stack(
        [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1
    )
    return np.asarray(scene.cast_rays(rays)["t_hit"].numpy())


def test_discrepancy_is_that_of_an_independent_renderer() -> None:
    scene = held_object("industrial_part")
    poses = poses_around(scene, 8)
    # Nothing is behind the hand: all pixels without a reading are empty.
    config = replace(CONFIG, empty_share=0.0)
    found = depth_discrepancies(
        poses, scene.observation, scene.hand_state, scene.hand, scene.obj, config
    )
    z = scene.hand_state.T_camera_hand[2, 3]
    step = max(1, round(CONFIG.ray_spacing * CAMERA.fx / z))
    assert step > 1
    camera = scene.observation.camera.subsampled(step)
    observed = scene.observation.depth[::step, ::step].astype(np.float64)
    meshes = [*(link.mesh for link in scene.hand.hand.links), scene.obj.model.mesh]
    expected = []
    for T in poses.T_camera_object.astype(np.float64):
        rendered = open3d_depth(
            meshes, np.concatenate([scene.hand_state.T_camera_link, T[None]]), camera
        )
        empty = observed <= 0
        difference = np.abs(np.where(empty, 1e3, observed) - np.minimum(rendered, 1e3))
        expected.append(np.minimum(difference, CONFIG.max_discrepancy).mean())
    assert found[-1] < 1e-6
    np.testing.assert_allclose(found, expected, rtol=0.01, atol=1e-6)


def test_the_best_third_is_ranked_by_lcp() -> None:
    scene = held_object("industrial_part")
    poses = poses_around(scene, 40)
    arguments = (scene.observation, scene.hand_state, scene.hand, scene.obj)
    ranked = select_by_rendering(poses, *arguments, scene.segment, CONFIG)
    discrepancy = depth_discrepancies(poses, *arguments, CONFIG)
    best = np.argsort(discrepancy)[:14]
    lcp = pose_lcp(
        poses.T_camera_object,
        scene.segment.points,
        scene.segment.normals,
        scene.obj.fields,
        CONFIG.lcp_distance,
        CONFIG.lcp_normal_angle,
        "cpu",
    )
    np.testing.assert_array_equal(ranked.score, np.sort(lcp[best])[::-1])
    np.testing.assert_array_equal(ranked.T_camera_object[0], poses.T_camera_object[-1])
    assert ranked.score[0] > 0.7
