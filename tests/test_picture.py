"""The picture of an estimate, checked pixel by pixel where it matters."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tiny_urdf
from numpy.typing import NDArray

from inhand.camera import Camera
from inhand.estimate import PoseEstimate
from inhand.geometry.mesh import box
from inhand.hand import Hand
from inhand.kernels.depth import DepthRenderer
from inhand.object_model import ObjectModel
from inhand.overlay import (
    HAND_COLOUR,
    HIDDEN_COLOUR,
    NO_READING,
    OBJECT_COLOUR,
    PANEL,
    Window,
    grey_depth,
    outline,
    residual_colours,
)
from inhand.picture import draw_estimate

CAMERA = Camera(300.0, 300.0, 79.5, 59.5, width=160, height=120)
LEFT, RIGHT, TOP = 14, PANEL + 28, 34


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    parts = (
        tiny_urdf.link("palm"),
        tiny_urdf.link("finger"),
        tiny_urdf.joint("bend", "palm", "finger"),
    )
    return Hand.from_urdf(tiny_urdf.write(tmp_path_factory.mktemp("hand"), *parts))


@pytest.fixture(scope="module")
def obj() -> ObjectModel:
    return ObjectModel.from_mesh(box((0.03, 0.05, 0.02)))


@pytest.fixture(scope="module")
def estimate() -> PoseEstimate:
    """Hand on the left, object on the right, both 0.3 m away."""
    T_hand, T_object = np.eye(4), np.eye(4)
    T_hand[:3, 3] = -0.03, 0, 0.3
    T_object[:3, 3] = 0.03, 0, 0.3
    return PoseEstimate(True, "", T_object, {"bend": 0.5}, T_hand, 0.75)


@pytest.fixture(scope="module")
def depth(hand: Hand, obj: ObjectModel, estimate: PoseEstimate) -> NDArray[np.float32]:
    """What the camera sees if the estimate is true, before a wall."""
    assert estimate.T_camera_hand is not None
    assert estimate.T_camera_object is not None
    renderer = DepthRenderer([*(link.mesh for link in hand.links), obj.mesh])
    links = estimate.T_camera_hand @ hand.forward_kinematics([0.5])
    image = renderer.render(CAMERA, np.stack([*links, estimate.T_camera_object]))[0]
    return np.where(image > 0, image, np.float32(0.8))


def draw(*args: object, **options: object) -> NDArray[np.uint8]:
    return np.asarray(draw_estimate(*args, **options))  # type: ignore[arg-type]


def has_colour(pixels: NDArray[np.uint8], colour: tuple[int, int, int]) -> bool:
    return bool((pixels == colour).all(axis=-1).any())


def panel(picture: NDArray[np.uint8], left: int) -> NDArray[np.uint8]:
    return picture[TOP : TOP + PANEL, left : left + PANEL]


def saturated(pixels: NDArray[np.uint8], low: int, high: int) -> int:
    """Pixels whose channel `high` is far above `low`."""
    return int((pixels[..., high].astype(int) - pixels[..., low] > 150).sum())


def test_a_true_estimate_leaves_no_residual(
    hand: Hand, obj: ObjectModel, estimate: PoseEstimate, depth: NDArray[np.float32]
) -> None:
    picture = draw(estimate, hand, obj, depth, CAMERA)
    overlay, residual = panel(picture, LEFT), panel(picture, RIGHT)
    assert has_colour(overlay, HAND_COLOUR)
    assert has_colour(overlay, OBJECT_COLOUR)
    white = (residual > 240).all(axis=-1)
    assert white.sum() > 0.1 * PANEL**2
    assert saturated(residual, 0, 2) == 0


@pytest.mark.parametrize(("shift", "low", "high"), [(0.02, 0, 2), (-0.02, 2, 0)])
def test_a_wrong_object_is_coloured(
    hand: Hand,
    obj: ObjectModel,
    estimate: PoseEstimate,
    depth: NDArray[np.float32],
    shift: float,
    low: int,
    high: int,
) -> None:
    T = np.array(estimate.T_camera_object)
    T[2, 3] += shift
    residual = panel(draw(replace(estimate, T_camera_object=T), hand, obj, depth, CAMERA), RIGHT)
    # Blue: the image is in front of the model that lies too far away. Red: behind.
    assert saturated(residual[:, PANEL // 2 :], low, high) > 0.03 * PANEL**2
    left_of_hand = residual[:, : PANEL // 3]
    assert saturated(left_of_hand, low, high) == 0


def test_no_answer_with_a_hand(
    hand: Hand, obj: ObjectModel, estimate: PoseEstimate, depth: NDArray[np.float32]
) -> None:
    found_not = replace(estimate, found=False, T_camera_object=None, reason="it is hidden " * 20)
    picture = draw(found_not, hand, obj, depth, CAMERA)
    assert picture.shape[0] > draw(estimate, hand, obj, depth, CAMERA).shape[0]  # a longer text
    panels = picture[100 : 100 + PANEL - 70]
    assert has_colour(panels, HAND_COLOUR)
    assert not has_colour(panels, OBJECT_COLOUR)


def test_no_answer_at_all(hand: Hand, obj: ObjectModel, depth: NDArray[np.float32]) -> None:
    nothing = PoseEstimate(False, "the hand is outside the image", None, {}, None, 0.0)
    holes = depth.copy()
    holes[:60] = np.nan
    picture = draw(nothing, hand, obj, holes, CAMERA)
    overlay = panel(picture, LEFT)
    assert not has_colour(overlay, HAND_COLOUR)
    assert has_colour(overlay, NO_READING)
    assert len(np.unique(panel(picture, RIGHT))) > 3  # the note


def test_colour_is_the_background(
    hand: Hand, obj: ObjectModel, estimate: PoseEstimate, depth: NDArray[np.float32]
) -> None:
    pink = np.full((120, 160, 3), (255, 0, 200), dtype=np.uint8)
    overlay = panel(draw(estimate, hand, obj, depth, CAMERA, colour=pink), LEFT)
    assert has_colour(overlay, (255, 0, 200))
    assert not has_colour(pink, HAND_COLOUR)  # the caller's image stays as it was


def test_hidden_edges_are_drawn(
    hand: Hand, obj: ObjectModel, estimate: PoseEstimate, depth: NDArray[np.float32]
) -> None:
    in_view = panel(draw(estimate, hand, obj, depth, CAMERA), LEFT)
    T = np.array(estimate.T_camera_hand)
    T[2, 3] += 0.04
    behind = replace(estimate, T_camera_object=T)
    hidden = panel(draw(behind, hand, obj, depth, CAMERA), LEFT)
    assert not has_colour(in_view, HIDDEN_COLOUR)
    assert has_colour(hidden, HIDDEN_COLOUR)


def test_the_window_camera_sees_what_the_window_cuts() -> None:
    renderer = DepthRenderer([box((0.04, 0.02, 0.02))])
    T = np.eye(4)
    T[:3, 3] = 0.02, -0.01, 0.3
    native = renderer.render(CAMERA, T[None])[1] >= 0
    window = Window.around(native)
    cut = window.cut(native, False, 400)
    rendered = renderer.render(window.camera(CAMERA, 400), T[None])[1] >= 0
    v, u = (np.flatnonzero(rendered.any(axis=1 - axis)) for axis in (0, 1))
    vc, uc = (np.flatnonzero(cut.any(axis=1 - axis)) for axis in (0, 1))
    pixel = 400 / window.side
    for a, b in ((v, vc), (u, uc)):
        assert abs(a[0] - b[0]) <= pixel
        assert abs(a[-1] - b[-1]) <= pixel
        assert abs((a[0] + a[-1]) - (b[0] + b[-1])) <= pixel


def test_the_window_fills_what_lies_outside_the_image() -> None:
    image = np.full((20, 40), 5)
    cut = Window.around(np.zeros((20, 40), dtype=bool)).cut(image, fill=-1, size=80)
    assert (cut[:20] == -1).all()
    assert (cut[-20:] == -1).all()
    assert (cut[20:60] == 5).all()


def test_outline() -> None:
    labels = np.zeros((8, 8), dtype=int)
    labels[2:6, 2:6] = 1
    border = outline(labels)
    assert border[2, 2:6].all()
    assert border[6, 2:6].all()
    assert not border[3:6, 3:6].any()
    assert outline(labels, 2).sum() > border.sum()
    assert not outline(np.ones((4, 4))).any()


def test_near_is_bright_and_nothing_is_blue() -> None:
    picture = grey_depth(np.array([[0.3, 0.6, 0.0]], dtype=np.float32))
    assert picture[0, 0, 0] > picture[0, 1, 0]
    assert tuple(picture[0, 2]) == NO_READING
    assert tuple(grey_depth(np.zeros((1, 1), dtype=np.float32))[0, 0]) == NO_READING


def test_residual_colours_diverge() -> None:
    colours = residual_colours(np.array([-0.02, -0.01, 0.0, 0.01, 0.02])).astype(int)
    assert (colours[0] == colours[1]).all()
    assert (colours[3] == colours[4]).all()
    assert colours[0][2] > 200 > colours[0][0]
    assert (colours[2] > 240).all()
    assert colours[4][0] > 200 > colours[4][2]


def test_real_frame(shared_data: Path, tmp_path: Path) -> None:
    """A reference fit, drawn into the real colour image, as a check that nothing breaks."""
    from inhand.io import read_colour, read_depth, read_transform

    folder = shared_data / "real_frame"
    camera = Camera.from_json(folder / "camera.json")
    hand = Hand.from_urdf(shared_data / "hands" / "t42" / "hand_T42b.urdf")
    obj = ObjectModel.from_mesh(shared_data / "objects" / "elliptic_cylinder.ply")
    T = read_transform(folder / "reference_fit.json")
    estimate = PoseEstimate(
        False, "no object", None, hand.joint_dict(np.full(len(hand.lower), 0.7)), T, 0.0
    )
    depth = read_depth(folder / "depth.png", camera)
    colour = read_colour(folder / "rgb.png", camera)
    picture = draw_estimate(estimate, hand, obj, depth, camera, colour=colour)
    picture.save(tmp_path / "picture.png")
    assert has_colour(np.asarray(picture), HAND_COLOUR)
