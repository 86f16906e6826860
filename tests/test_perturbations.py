"""Every perturbation of a frame against what it must be in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from inhand.camera import Camera
from inhand.datasets.frames import (
    LABEL_BACKGROUND,
    LABEL_HAND,
    LABEL_NOTHING,
    LABEL_OBJECT,
    Frame,
    Truth,
)
from inhand.errors import InputError
from inhand.evaluation import perturbations as p
from inhand.evaluation.perturbations import Bodies
from inhand.evaluation.results import FrameResult
from inhand.evaluation.sweeps import (
    OBJECT_SCALE,
    SWEEPS,
    Perturbation,
    by_level,
    find_perturbations,
    perturbation_of,
)
from inhand.geometry import mesh as meshes
from inhand.geometry.se3 import exp
from inhand.hand import Hand
from inhand.object_model import ObjectModel

CAMERA = Camera(150.0, 160.0, 79.5, 59.5, 160, 120)
URDF = """
<robot name="poker">
  <link name="palm"><visual><geometry><box size="0.06 0.04 0.02"/></geometry></visual></link>
  <link name="finger"><visual><origin xyz="0 0 0.03"/>
    <geometry><box size="0.01 0.02 0.06"/></geometry></visual></link>
  <joint name="bend" type="revolute"><parent link="palm"/><child link="finger"/>
    <origin xyz="0.02 0 0.01"/><axis xyz="0 1 0"/><limit lower="-1" upper="1"/></joint>
</robot>
"""
OBJECT = meshes.box((0.03, 0.04, 0.05))


@pytest.fixture(scope="module")
def bodies(tmp_path_factory: pytest.TempPathFactory) -> Bodies:
    path = tmp_path_factory.mktemp("hand") / "poker.urdf"
    path.write_text(URDF)
    return Bodies(Hand.from_urdf(path), OBJECT)


@pytest.fixture(scope="module")
def frame(bodies: Bodies) -> Frame:
    """A box over a palm, with some clutter to the left, and a hole in the readings."""
    T_camera_hand = exp(np.array([1.9, 0.3, 0.2, 0.0, 0.02, 0.4]))
    truth = Truth(
        wrist=T_camera_hand,
        T_camera_object=T_camera_hand @ exp(np.array([0.2, 0.1, 0.4, -0.02, 0, 0.06])),
        joint_positions={"bend": 0.3},
        label=np.zeros((120, 160), np.uint8),
        visible_share=0.8,
    )
    bare = Frame("made/up", "box", np.zeros((120, 160), np.float32), CAMERA, T_camera_hand, truth)
    depth, body = bodies.render(bare, CAMERA)
    label = np.select([body < 0, body == 2], [LABEL_NOTHING, LABEL_OBJECT], LABEL_HAND)
    clutter = np.zeros_like(label, bool)
    clutter[20:60, 5:25] = True
    assert not (clutter & (body >= 0)).any()
    depth[clutter], label[clutter] = 0.8, LABEL_BACKGROUND
    v, u = np.argwhere(label == LABEL_HAND).mean(axis=0).astype(int)
    depth[v : v + 3, u : u + 3] = 0
    truth = replace(truth, label=label.astype(np.uint8))
    return replace(bare, depth=depth, truth=truth)


def rng() -> np.random.Generator:
    return np.random.default_rng(7)


# What an estimator is told


@pytest.mark.parametrize(("translation", "rotation"), [(0.0, 0.0), (0.015, 0.0), (0.004, 0.14)])
def test_wrist_error_is_exact(frame: Frame, translation: float, rotation: float) -> None:
    off = replace(frame, wrist=np.eye(4))  # the error that it came with is gone
    T = p.with_wrist_error(off, translation, rotation, rng()).T_camera_hand_given
    truth = frame.truth.T_camera_hand
    assert np.linalg.norm(T[:3, 3] - truth[:3, 3]) == pytest.approx(translation)
    turn = Rotation.from_matrix(T[:3, :3] @ truth[:3, :3].T).magnitude()
    assert turn == pytest.approx(rotation, abs=1e-7)


def test_wrist_errors_point_the_same_way_at_every_level_and_elsewhere_for_other_frames(
    frame: Frame, bodies: Bodies
) -> None:
    def error(level: float, name: str, seed: int = 0) -> np.ndarray:
        named = replace(frame, name=name)
        T = Perturbation("wrist", level).apply(named, bodies, seed).T_camera_hand_given
        return T[:3, 3] - frame.truth.T_camera_hand[:3, 3]

    np.testing.assert_allclose(5 * error(0.003, "a"), error(0.015, "a"))
    assert np.linalg.norm(error(0.015, "a") - error(0.015, "b")) > 1e-3
    assert np.linalg.norm(error(0.015, "a") - error(0.015, "a", seed=1)) > 1e-3


def test_focal_length(frame: Frame) -> None:
    camera = p.with_focal_length(frame, 1.02).camera
    assert camera == replace(CAMERA, fx=1.02 * CAMERA.fx, fy=1.02 * CAMERA.fy)


def test_object_scale_is_about_the_centre(bodies: Bodies, frame: Frame) -> None:
    model = ObjectModel.from_mesh(meshes.TriangleMesh(OBJECT.vertices + 0.1, OBJECT.faces))
    larger = p.scaled(model, 1.03)
    np.testing.assert_allclose(larger.mesh.vertices, 0.1 + 1.03 * OBJECT.vertices, atol=1e-5)
    level = Perturbation(OBJECT_SCALE, 0.03)
    assert level.object_scale == 1.03
    assert level.apply(frame, bodies, 0) is frame
    assert Perturbation("noise", 3.0).object_scale == 1.0


# What the camera reads


def test_noise_is_that_of_the_sensor_times_a_factor(frame: Frame) -> None:
    far = replace(frame, depth=np.full((400, 400), 0.9, np.float32))
    far.depth[:50] = 0
    one, three = (p.with_depth_noise(far, k, rng()).depth - far.depth for k in (1.0, 3.0))
    expected = 0.0012 + 0.0019 * (0.9 - 0.4) ** 2  # Nguyen et al. (2012)
    assert one[50:].std() == pytest.approx(expected, rel=0.02)
    assert abs(one[50:].mean()) < 0.05 * expected
    np.testing.assert_allclose(three, 3 * one, atol=1e-6)
    assert (one[:50] == 0).all()
    np.testing.assert_array_equal(p.with_depth_noise(frame, 0.0, rng()).depth, frame.depth)


def test_missing_share_in_areas_and_single_pixels(frame: Frame) -> None:
    full = replace(frame, depth=np.ones((600, 600), np.float32))
    lost = {s: p.with_missing_depth(full, s, rng()).depth == 0 for s in (0.0, 0.3, 0.7)}
    assert lost[0.0].sum() == 0
    assert lost[0.3].mean() == pytest.approx(0.3, abs=0.02)
    assert lost[0.7].mean() == pytest.approx(0.7, abs=0.02)
    assert (lost[0.7] | ~lost[0.3]).all(), "what is lost at a level is lost at the next"
    # Of independent single pixels, a whole 5 x 5 block is lost with a chance of 0.3^25.
    blocks = lost[0.3].reshape(120, 5, 120, 5).all(axis=(1, 3))
    assert blocks.mean() > 0.01
    # Of pixels whose neighbours are all there, areas would lose hardly any.
    alone = lost[0.3][1:-1, 1:-1] & ~lost[0.3][:-2, 1:-1] & ~lost[0.3][2:, 1:-1]
    alone &= ~lost[0.3][1:-1, :-2] & ~lost[0.3][1:-1, 2:]
    assert alone.mean() > 0.03


# What else is in view


def test_wall(frame: Frame, bodies: Bodies) -> None:
    corners = np.concatenate(
        [
            boxed(frame.truth.T_camera_hand, (0.06, 0.04, 0.02)),
            boxed(finger_pose(frame), (0.01, 0.02, 0.06)),
            boxed(frame.truth.T_camera_object, (0.03, 0.04, 0.05)),
        ]
    )
    wall = p.with_wall(frame, 0.02, bodies)
    shown = (wall.truth.label == LABEL_BACKGROUND) & (wall.depth < 0.79)
    np.testing.assert_allclose(wall.depth[shown], corners[:, 2].max() + 0.02, rtol=1e-6)
    assert (wall.truth.label != LABEL_NOTHING).all(), "it fills the image"
    assert not (wall.depth > 0.79).any(), "it hides the clutter behind it"
    held = np.isin(frame.truth.label, [LABEL_HAND, LABEL_OBJECT])
    np.testing.assert_array_equal(wall.depth[held], frame.depth[held])
    np.testing.assert_array_equal(wall.truth.label[held], frame.truth.label[held])


def boxed(T: np.ndarray, size: tuple[float, float, float]) -> np.ndarray:
    """Corners of a box around the origin of a pose, camera frame, shape (8, 3)."""
    signs = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T
    return np.asarray((signs * size) @ T[:3, :3].T + T[:3, 3])


def finger_pose(frame: Frame) -> np.ndarray:
    """Pose of the middle of the finger."""
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([0, 0.3, 0]).as_matrix()
    turn[:3, 3] = [0.02, 0, 0.01]
    middle = np.eye(4)
    middle[2, 3] = 0.03
    return np.asarray(frame.truth.T_camera_hand @ turn @ middle)


@pytest.mark.parametrize("gap", [0.0, 0.05])
def test_table_is_a_plane_below_everything(frame: Frame, bodies: Bodies, gap: float) -> None:
    table = p.with_table(frame, gap, bodies)
    new = (table.truth.label == LABEL_BACKGROUND) & (frame.truth.label == LABEL_NOTHING)
    v, u = np.nonzero(new)
    z = table.depth[new].astype(np.float64)
    points = np.stack([(u - 79.5) / 150 * z, (v - 59.5) / 160 * z, z], axis=1)
    middle = points.mean(axis=0)
    up = np.linalg.svd(points - middle, full_matrices=False)[2][2]
    up *= -np.sign(up[1])  # y points down
    np.testing.assert_allclose((points - middle) @ up, 0, atol=1e-6)
    np.testing.assert_allclose(up, [0, -np.sqrt(0.5), -np.sqrt(0.5)], atol=1e-5)
    lowest = ((bodies.points(frame) - middle) @ up).min()
    assert lowest == pytest.approx(gap, abs=1e-6)
    assert table.depth.max() <= 3.0


def test_second_hand_keeps_its_distance(frame: Frame, bodies: Bodies) -> None:
    two = p.with_second_hand(frame, 0.01, bodies)
    new = (two.truth.label == LABEL_BACKGROUND) & (frame.truth.label != LABEL_BACKGROUND)
    assert new.sum() > 200
    x = (np.nonzero(new)[1] - CAMERA.cx) / CAMERA.fx * two.depth[new]
    first = bodies.points(frame)[:, 0]
    assert min(abs(x.min() - first.max()), abs(first.min() - x.max())) < 0.013
    assert x.min() > first.max() or x.max() < first.min()
    # It is the same hand, moved along x only: it has the depths that the first one has.
    held = frame.truth.label == LABEL_HAND
    assert abs(two.depth[new].min() - frame.depth[held & (frame.depth > 0)].min()) < 1e-3


def test_a_surface_gives_no_reading_where_a_body_has_none(frame: Frame, bodies: Bodies) -> None:
    hole = np.isin(frame.truth.label, [LABEL_HAND, LABEL_OBJECT]) & (frame.depth == 0)
    assert hole.sum() == 9
    for name in ("wall", "table", "second-hand"):
        assert (Perturbation(name, 0.02).apply(frame, bodies, 0).depth[hole] == 0).all()


# Other images


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
@pytest.mark.parametrize("share", [0.25, 0.75])
def test_crop(frame: Frame, turns: int, share: float) -> None:
    """A hand of 40 x 10 pixels, with the object at its far end, turned to all sides."""
    label = np.zeros((120, 120), np.uint8)
    label[30:70, 40:50], label[75:85, 40:50] = LABEL_HAND, LABEL_OBJECT
    label = np.rot90(label, turns).copy()
    depth = np.arange(label.size, dtype=np.float32).reshape(label.shape)
    camera = Camera(150, 150, 59.5, 59.5, 120, 120)
    truth = replace(frame.truth, label=label)
    square = replace(frame, depth=depth, camera=camera, truth=truth)
    cut = p.cropped(square, share)
    assert np.count_nonzero(cut.truth.label == LABEL_HAND) == 400 * (1 - share)
    assert np.count_nonzero(cut.truth.label == LABEL_OBJECT) == 100
    assert cut.truth.visible_share == 0.8
    assert cut.depth.shape == cut.truth.label.shape == (cut.camera.height, cut.camera.width)
    # Every pixel is seen along the same ray as before.
    v, u = divmod(cut.depth, 120)
    np.testing.assert_allclose(u - camera.cx, np.arange(cut.camera.width) - cut.camera.cx + 0 * u)
    rows = np.arange(cut.camera.height)[:, None]
    np.testing.assert_allclose(v - camera.cy, rows - cut.camera.cy + 0 * v)


def test_crop_through_the_object_makes_it_less_visible(frame: Frame) -> None:
    label = np.zeros((120, 120), np.uint8)
    label[20:60, 40:80], label[30:50, 50:70] = LABEL_HAND, LABEL_OBJECT
    camera = Camera(150, 150, 59.5, 59.5, 120, 120)
    ringed = replace(
        frame,
        depth=np.ones(label.shape, np.float32),
        camera=camera,
        truth=replace(frame.truth, label=label),
    )
    # Half of the ring around the object lies on one side of its middle, as does half of it.
    cut = p.cropped(ringed, 0.5)
    left = np.count_nonzero(cut.truth.label == LABEL_OBJECT) / 400
    assert left == pytest.approx(0.5, abs=0.06)
    assert cut.truth.visible_share == pytest.approx(0.8 * left)


@pytest.mark.parametrize(("width", "height"), [(80, 60), (160, 120), (320, 240), (400, 240)])
def test_resized_surfaces_are_where_they_are(
    frame: Frame, bodies: Bodies, width: int, height: int
) -> None:
    other = p.resized(frame, width, height, bodies)
    assert other.depth.shape == other.truth.label.shape == (height, width)
    depth, body = bodies.render(frame, other.camera)
    held = np.isin(other.truth.label, [LABEL_HAND, LABEL_OBJECT]) & (body >= 0) & (other.depth > 0)
    right = np.abs(other.depth - depth)[held] < 1e-6
    assert right.mean() > 0.97, "all but some pixels at edges are exact"
    # The field of view is the old one in height, about the same axis.
    top, bottom = (
        v * (frame.camera.fy / other.camera.fy)
        for v in (other.camera.cy + 0.5, height - 0.5 - other.camera.cy)
    )
    assert (top, bottom) == pytest.approx((60, 60))
    assert other.camera.fx / other.camera.fy == pytest.approx(150 / 160)
    beyond = (width - 160 * height // 120) // 2
    assert (other.depth[:, :beyond] == 0).all()
    if (width, height) == (160, 120):
        np.testing.assert_array_equal(other.depth, frame.depth)
        assert other.camera == frame.camera


def test_resized_readings_keep_their_errors(frame: Frame, bodies: Bodies) -> None:
    off = replace(frame, depth=np.where(frame.depth > 0, frame.depth + 0.004, 0))
    for size in ((80, 60), (320, 240)):
        right, wrong = (p.resized(f, *size, bodies).depth for f in (frame, off))
        np.testing.assert_allclose(wrong[right > 0] - right[right > 0], 0.004, atol=1e-6)
        assert ((wrong > 0) == (right > 0)).all()


# Sweeps


def test_every_level_of_every_sweep_makes_a_sound_frame(frame: Frame, bodies: Bodies) -> None:
    before = frame.depth.copy()
    for perturbation in find_perturbations("all"):
        made, again = (perturbation.apply(frame, bodies, 3) for _ in range(2))
        assert made.depth.dtype == np.float32
        assert np.isfinite(made.depth).all()
        assert (made.depth >= 0).all()
        assert made.depth.shape == made.truth.label.shape
        assert made.depth.shape == (made.camera.height, made.camera.width)
        np.testing.assert_array_equal(made.depth, again.depth)
        np.testing.assert_array_equal(made.T_camera_hand_given, again.T_camera_hand_given)
        np.testing.assert_array_equal(made.truth.T_camera_object, frame.truth.T_camera_object)
    np.testing.assert_array_equal(frame.depth, before)


def test_sweeps_by_name() -> None:
    assert {p.sweep for p in find_perturbations("all")} == set(SWEEPS)
    found = find_perturbations("noise, crop,noise")
    assert [p.sweep for p in found] == ["noise"] * 4 + ["crop"] * 4
    for names in ("", "fog", "noise,fog"):
        with pytest.raises(InputError, match=r"known: all, wrist-position"):
            find_perturbations(names)


def test_results_by_level() -> None:
    def result(**perturbation: float) -> FrameResult:
        return FrameResult("set/1", "", "answer", perturbation=perturbation)

    results = [result(noise=2.0), result(), result(noise=0.5), result(translation=0.01)]
    assert [perturbation_of(r) for r in results] == [("noise", 2.0), None, ("noise", 0.5), None]
    assert by_level(results) == {"noise": {0.5: [results[2]], 2.0: [results[0]]}}


def test_levels_in_words() -> None:
    shown = {name: sweep.words(sweep.levels[-1]) for name, sweep in SWEEPS.items()}
    assert shown["wrist"] == "15 mm"
    assert shown["wrist-rotation"] == "8 deg"
    assert shown["missing"] == "70 %"
    assert shown["size"] == "1280 pixel"
