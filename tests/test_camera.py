import json
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from reference_depth import rays

from inhand.camera import Camera
from inhand.geometry import mesh as meshes
from inhand.geometry.se3 import exp
from inhand.kernels.depth import DepthRenderer

CAMERA = Camera(fx=130, fy=110, cx=40.25, cy=33.5, width=90, height=64, depth_unit=0.0001)
sizes = st.floats(50, 500)


@st.composite
def cameras(draw: st.DrawFn) -> Camera:
    width, height = draw(st.integers(40, 300)), draw(st.integers(40, 300))
    share = st.floats(0.2, 0.8)
    return Camera(
        draw(sizes), draw(sizes), draw(share) * width, draw(share) * height, width, height
    )


@given(cameras(), st.integers(0, 1000))
def test_projection_is_the_intrinsic_matrix(camera: Camera, seed: int) -> None:
    points = np.random.default_rng(seed).uniform([-1, -1, 0.2], [1, 1, 3], (10, 3))
    homogeneous = points @ camera.matrix.T
    expected = homogeneous[:, :2] / homogeneous[:, 2:]
    np.testing.assert_allclose(camera.project(points), expected, rtol=1e-12)


@given(cameras())
def test_pixels_are_centred_at_integers(camera: Camera) -> None:
    """The ray of pixel (u, v) projects to (u, v)."""
    ray = rays(camera)
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    np.testing.assert_allclose(
        camera.project(ray.reshape(-1, 3)), np.stack([u, v], -1).reshape(-1, 2), atol=1e-9
    )


@given(cameras())
def test_matrix_and_camera_say_the_same(camera: Camera) -> None:
    size = {"width": camera.width, "height": camera.height}
    assert Camera.from_matrix(camera.matrix, **size) == camera
    assert Camera.from_matrix(camera.matrix.tolist(), **size) == camera


def test_from_json(tmp_path: Path) -> None:
    fields = {name: getattr(CAMERA, name) for name in ("fx", "fy", "cx", "cy", "width", "height")}
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(fields | {"depth_unit_m": 0.0001, "comment": "ignored"}))
    assert Camera.from_json(path) == CAMERA
    path.write_text(json.dumps(fields))
    assert Camera.from_json(str(path)).depth_unit == 0.001


@given(cameras(), st.data())
@settings(max_examples=30, deadline=None)
def test_windows_and_subsampled_images_have_the_rays_of_their_pixels(
    camera: Camera, data: st.DataObject
) -> None:
    u0, v0 = (data.draw(st.integers(0, n - 1)) for n in (camera.width, camera.height))
    width = data.draw(st.integers(1, camera.width - u0))
    height = data.draw(st.integers(1, camera.height - v0))
    window = camera.crop(u0, v0, width, height)
    np.testing.assert_allclose(
        rays(window), rays(camera)[v0 : v0 + height, u0 : u0 + width], atol=1e-12
    )
    step = data.draw(st.integers(1, 7))
    np.testing.assert_allclose(
        rays(camera.subsampled(step)), rays(camera)[::step, ::step], atol=1e-12
    )


def test_windows_and_subsampled_cameras_see_parts_of_the_image() -> None:
    renderer = DepthRenderer([meshes.box([0.1, 0.2, 0.15])])
    pose = exp(np.array([[0.4, -0.7, 0.2, 0.02, -0.03, 0.5]]))
    depth, index = renderer.render(CAMERA, pose)
    assert 0.1 < (index == 0).mean() < 0.9
    window, window_index = renderer.render(CAMERA.crop(13, 7, 50, 44), pose)
    np.testing.assert_array_equal(window_index, index[7:51, 13:63])
    np.testing.assert_allclose(window, depth[7:51, 13:63], atol=1e-6)
    coarse, coarse_index = renderer.render(CAMERA.subsampled(3), pose)
    np.testing.assert_array_equal(coarse_index, index[::3, ::3])
    np.testing.assert_allclose(coarse, depth[::3, ::3], atol=1e-6)
    assert CAMERA.crop(1, 2, 3, 4).depth_unit == CAMERA.subsampled(2).depth_unit == 0.0001
