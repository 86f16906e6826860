"""Renderings of hand and object together, against renderers that are not the project's."""

import numpy as np
import pytest
from reference_depth import open3d_depth, plane_depth
from viewed_scenes import demo

from inhand.camera import Camera
from inhand.geometry.mesh import box
from inhand.object_model import ObjectModel
from inhand.overlay import HAND_COLOUR, ModelRenderer, Placement, draw_outlines, residual_map
from inhand.synth.demo import builtin_hand

CAMERA = Camera(300.0, 300.0, 79.5, 59.5, width=160, height=120)


@pytest.fixture(scope="module")
def models() -> ModelRenderer:
    return ModelRenderer(builtin_hand(), ObjectModel.from_mesh(box((0.03, 0.05, 0.02))))


@pytest.fixture(scope="module")
def in_front() -> Placement:
    """The box alone, its face 0.29 m away."""
    T = np.eye(4)
    T[:3, 3] = 0, 0, 0.3
    return Placement(T_camera_object=T)


def test_residual_of_a_box_before_a_plane(models: ModelRenderer, in_front: Placement) -> None:
    observed = plane_depth(CAMERA, np.array([0.1, 0, 1.0]), 0.292).astype(np.float32)
    observed[60:] = 0
    rendering = models.render(CAMERA, in_front)
    residual = rendering.residual(observed)
    known = np.isfinite(residual)
    assert not known[60:].any()
    # The face is 31 pixels wide and 52 high: f * size / depth; its lower half has no readings.
    assert known.sum() == pytest.approx(31 * 26, rel=0.05)
    np.testing.assert_allclose(residual[known], observed[known] - 0.29, atol=1e-6)


def test_hand_and_object_are_seen_as_in_open3d() -> None:
    scene = demo()
    q = scene.hand.joint_vector(scene.joint_positions)
    placement = Placement(scene.T_camera_hand, q, scene.T_camera_object)
    camera = scene.camera.subsampled(4)
    links = scene.T_camera_hand @ scene.hand.forward_kinematics(q)
    meshes = [*(link.mesh for link in scene.hand.links), scene.obj.mesh]
    depth, index = open3d_depth(meshes, np.stack([*links, scene.T_camera_object]), camera)
    rendering = ModelRenderer(scene.hand, scene.obj).render(camera, placement)
    seen = np.isfinite(depth)
    edge = 0.004  # pixels on an edge may fall either way
    assert np.mean((rendering.depth > 0) != seen) < edge
    assert np.mean(rendering.is_object != (index == len(links))) < edge
    assert np.mean(rendering.link != np.where(index == len(links), -1, index)) < edge
    both = seen & (rendering.depth > 0) & (rendering.is_object == (index == len(links)))
    assert np.median(np.abs(rendering.depth - depth)[both]) < 1e-6


def test_the_silhouette_goes_on_behind_the_hand() -> None:
    scene = demo()
    q = scene.hand.joint_vector(scene.joint_positions)
    models = ModelRenderer(scene.hand, scene.obj)
    together = models.render(scene.camera, Placement(scene.T_camera_hand, q, scene.T_camera_object))
    alone = models.render(scene.camera, Placement(T_camera_object=scene.T_camera_object))
    np.testing.assert_array_equal(together.silhouette, alone.silhouette)
    assert together.is_object.sum() < alone.is_object.sum()
    assert not (together.is_object & together.is_hand).any()


def test_what_has_no_place_is_not_seen(models: ModelRenderer) -> None:
    rendering = models.render(CAMERA, Placement())
    assert not rendering.depth.any()
    assert not (rendering.is_hand | rendering.silhouette).any()


def test_outlines_leave_the_picture_alone_that_they_are_drawn_on(
    models: ModelRenderer, in_front: Placement
) -> None:
    pixels = np.full((120, 160, 3), 7, dtype=np.uint8)
    drawn = draw_outlines(pixels, models.render(CAMERA, in_front))
    assert (pixels == 7).all()
    assert (drawn != 7).any()
    assert not (drawn == HAND_COLOUR).all(axis=-1)[60, 80]


def test_the_residual_map_is_blue_in_front_and_red_behind(
    models: ModelRenderer, in_front: Placement
) -> None:
    rendering = models.render(CAMERA, in_front)
    for shift, strong, weak in ((-0.008, 2, 0), (0.008, 0, 2)):
        colour = residual_map(np.full((120, 160), 0.29 + shift, np.float32), rendering)[60, 80]
        assert int(colour[strong]) - int(colour[weak]) > 60
