"""What is drawn in 3D, checked on the server's side of the page."""

from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from inhand.camera import Camera
from inhand.geometry.mesh import box
from inhand.geometry.se3 import exp, transform
from inhand.overlay import HAND_COLOUR
from inhand.synth.demo import builtin_hand
from inhand.viewer.clouds import scene_cloud
from inhand.viewer.drawing import (
    CloudDrawing,
    HandDrawing,
    ObjectDrawing,
    View,
    move,
    pose_of,
)
from inhand.viewer.server import serving

pytest.importorskip("viser")

CAMERA = Camera(60.0, 70.0, 32.0, 20.0, width=64, height=48)
small = st.floats(-3, 3)


@pytest.fixture(scope="module")
def view() -> Iterator[View]:
    with serving("test", port=0) as server:
        yield View(server)


@given(st.tuples(small, small, small, small, small, small).map(np.array))
def test_nodes_go_where_they_are_put(xi: np.ndarray) -> None:
    node = SimpleNamespace(wxyz=None, position=None)
    move(node, exp(xi))
    np.testing.assert_allclose(pose_of(node), exp(xi), atol=1e-12)


def test_points_of_the_cloud_project_to_their_pixels() -> None:
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.3, 0.9, (48, 64)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.3] = 0
    pixels = rng.integers(0, 255, (48, 64, 3)).astype(np.uint8)
    points, colours, index = scene_cloud(depth, CAMERA, pixels)
    assert len(points) == np.count_nonzero(depth)
    u, v = np.rint(CAMERA.project(points.astype(float))).astype(int).T
    np.testing.assert_array_equal(v * 64 + u, index)
    np.testing.assert_array_equal(depth[v, u], points[:, 2])
    np.testing.assert_array_equal(pixels[v, u], colours)


def test_the_cloud_may_be_thinned_and_cut_out() -> None:
    depth = np.full((48, 64), 0.5, np.float32)
    pixels = np.zeros((48, 64, 3), np.uint8)
    index = scene_cloud(depth, CAMERA, pixels, step=4)[2]
    assert len(index) == 12 * 16
    assert (index // 64 % 4 == 0).all()
    centre = np.array([0.0, 0, 0.5])
    points = scene_cloud(depth, CAMERA, pixels, sphere=(centre, 0.1))[0]
    assert 0 < len(points) < 48 * 64
    assert np.linalg.norm(points - centre, axis=1).max() < 0.1


def test_links_are_drawn_where_kinematics_puts_them(view: View) -> None:
    hand = builtin_hand()
    drawing = HandDrawing(view, "links", hand, HAND_COLOUR)
    T, q = exp(np.array([0.3, -0.2, 1, 0.1, 0.05, 0.5])), hand.upper / 2
    shown = np.arange(len(hand.links)) % 2 == 0
    drawing.draw(T, q, shown)
    for i, (node, T_hand_link) in enumerate(
        zip(drawing._links, hand.forward_kinematics(q), strict=True)
    ):
        np.testing.assert_allclose(
            pose_of(drawing._root) @ pose_of(node), T @ T_hand_link, atol=1e-12
        )
        assert node.visible == shown[i]
    assert drawing._root.visible
    drawing.hide()
    assert not drawing._root.visible


def test_the_point_looked_at_comes_to_the_origin(view: View) -> None:
    point = np.array([0.1, -0.2, 0.6])
    view.look_at(point)
    root = pose_of(view._camera)
    np.testing.assert_allclose(transform(root, point[None]), np.zeros((1, 3)), atol=1e-12)


def test_objects_and_clouds_hide(view: View) -> None:
    drawing = ObjectDrawing(view, "thing", box((0.1, 0.1, 0.1)), (1, 2, 3), axes=0.1)
    drawing.draw(np.eye(4))
    assert drawing._root.visible
    drawing.hide()
    assert not drawing._root.visible
    drawing.remove()
    cloud = CloudDrawing(view, "dots")
    cloud.hide()  # nothing there yet
    cloud.draw(np.zeros((3, 3)), np.zeros((3, 3), np.uint8))
    assert cloud._node.visible
    cloud.hide()
    assert not cloud._node.visible
