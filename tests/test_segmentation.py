from dataclasses import replace

import numpy as np
import pytest
from held_object import CAMERA, HeldObject, distance_to_hand, held_object
from reference_depth import plane_depth, rays

from inhand.config import ObservationConfig, SegmentationConfig
from inhand.errors import NoAnswer
from inhand.geometry.se3 import transform
from inhand.stages.observation import Observation, observe
from inhand.stages.results import HandState, Segment
from inhand.stages.segmentation import segment_object

SOFT = SegmentationConfig(dense_below=1)
PAPER = SegmentationConfig(method="threshold")
WHOLE = SegmentationConfig(method="none")


def segmented(
    scene: HeldObject, config: SegmentationConfig, state: HandState | None = None, size: float = 0.1
) -> Segment:
    """The object segment; `size` is the diameter of the object [m]."""
    return segment_object(scene.observation, state or scene.hand_state, scene.hand, size, config)


def rows(points: np.ndarray, among: np.ndarray) -> np.ndarray:
    """Where each of some points is among others, shape (n,); -1 if it is not."""
    place = {p.tobytes(): i for i, p in enumerate(among)}
    return np.array([place.get(p.tobytes(), -1) for p in points])


def on_object(scene: HeldObject, points: np.ndarray) -> np.ndarray:
    """Whether points lie on the object; smoothing takes them off its edges a little."""
    T = scene.T_camera_object
    to_object = scene.obj.model.distance_field.distance((points - T[:3, 3]) @ T[:3, :3])
    return np.asarray(np.abs(to_object) < 0.0025)


@pytest.mark.parametrize("name", ["cuboid", "industrial_part", "cylinder"])
@pytest.mark.parametrize("config", [SOFT, PAPER], ids=["soft", "threshold"])
def test_the_object_is_what_is_left(name: str, config: SegmentationConfig) -> None:
    scene = held_object(name)
    found = segmented(scene, config)
    right = on_object(scene, found.points)
    assert found.weight[right].sum() > 0.95 * found.weight.sum()
    # Only where it touches the hand something is missing.
    assert right.sum() > 0.7 * len(scene.segment.points)


def test_without_segmentation_the_hand_stays() -> None:
    scene = held_object("cuboid")
    found = segmented(scene, WHOLE)
    np.testing.assert_array_equal(found.points, scene.observation.points)
    np.testing.assert_array_equal(found.weight, 1)


def test_the_threshold_of_the_paper() -> None:
    scene = held_object("cuboid")
    points = scene.observation.points
    distance = distance_to_hand(points, scene.hand, scene.hand_state)
    found = segmented(scene, PAPER, size=1.0)
    kept = rows(found.points, points)
    expected = np.flatnonzero(distance >= PAPER.hand_distance)
    # A point may lie on the threshold.
    assert len(np.setxor1d(kept, expected)) <= 2
    np.testing.assert_array_equal(found.weight, 1)
    np.testing.assert_allclose(found.hand_distance, distance[kept], atol=0.001)
    np.testing.assert_array_equal(found.normals, scene.observation.normals[kept])


@pytest.mark.parametrize("shift", [0.0, 0.002])
def test_how_far_the_readings_of_the_hand_are_off_it(shift: float) -> None:
    scene = held_object("cuboid")
    links = scene.hand_state.T_camera_link.copy()
    links[:, 2, 3] += shift
    state = replace(scene.hand_state, T_camera_link=links)
    off = np.abs(distance_to_hand(scene.observation.points, scene.hand, state))
    expected = off[off < SOFT.certain_distance].mean()
    assert segmented(scene, SOFT, state).hand_misfit == pytest.approx(expected, abs=5e-5)
    assert expected > 0.5 * shift


def test_the_weight_grows_with_the_distance_to_the_hand() -> None:
    scene = held_object("cuboid")
    found = segmented(scene, SOFT)
    order = np.argsort(found.hand_distance)
    assert (np.diff(found.weight[order]) >= -1e-6).all()
    assert found.weight.min() > 0
    assert found.weight.max() == 1
    assert (found.weight[found.hand_distance > SOFT.certain_distance + 0.001] == 1).all()
    assert (found.weight[found.hand_distance < SOFT.certain_distance - 0.001] < 1).all()
    assert found.hand_distance.min() > SOFT.hand_distance


@pytest.mark.parametrize("config", [SOFT, PAPER], ids=["soft", "threshold"])
def test_what_no_finger_can_touch_is_not_the_object(config: SegmentationConfig) -> None:
    scene = held_object("cuboid")
    everything = segmented(scene, config, size=1.0)
    away = everything.points + np.array([0.3, 0, 0], dtype=np.float32)
    cloud = replace(
        scene.observation,
        points=np.concatenate([scene.observation.points, away]),
        normals=np.concatenate([scene.observation.normals, everything.normals]),
    )
    far = replace(scene, observation=cloud)
    found = segmented(far, config)
    assert (rows(found.points, away) < 0).all()
    assert (rows(segmented(far, config, size=1.0).points, away) >= 0).any()


def test_what_only_an_unsupported_link_explains_keeps_some_weight() -> None:
    scene = held_object("cuboid")
    links = list(scene.hand.hand.fingers[0].links)
    certain = np.ones(len(scene.hand.hand.links), dtype=bool)
    certain[links] = False
    doubtful = segmented(scene, SOFT, replace(scene.hand_state, certain=certain))
    sure = segmented(scene, SOFT)
    extra = rows(doubtful.points, sure.points) < 0
    assert extra.sum() > 20
    state = replace(scene.hand_state, T_camera_link=scene.hand_state.T_camera_link[links])
    fields = [scene.hand.hand.links[i].distance_field for i in links]
    to_finger = np.min(
        [
            f.distance((doubtful.points[extra] - T[:3, 3]) @ T[:3, :3])
            for f, T in zip(fields, state.T_camera_link, strict=True)
        ],
        axis=0,
    )
    assert to_finger.max() < SOFT.hand_distance + 0.001
    assert doubtful.weight[extra].max() <= SOFT.uncertain_weight + 1e-6
    assert doubtful.weight[extra].min() > 0


def test_a_small_segment_is_taken_from_finer_clouds_down_to_every_pixel() -> None:
    scene = held_object("cuboid")
    sparse = segmented(scene, SOFT)
    small = replace(SOFT, dense_below=len(sparse.points) + 1)
    enough = 2 * len(sparse.points)
    denser = segmented(scene, replace(small, dense_points=enough))
    assert 0.9 * enough < len(denser.points) < 2.5 * enough
    dense = segmented(scene, replace(small, dense_points=100_000))
    assert len(dense.points) > 3 * len(sparse.points)
    assert (rows(dense.points, scene.observation.cloud(step=1).points) >= 0).all()
    right = on_object(scene, dense.points)
    assert dense.weight[right].sum() > 0.95 * dense.weight.sum()


@pytest.mark.parametrize("config", [SOFT, PAPER], ids=["soft", "threshold"])
def test_without_an_object_there_is_no_answer(config: SegmentationConfig) -> None:
    scene = held_object("cuboid")
    hand_only = distance_to_hand(scene.observation.points, scene.hand, scene.hand_state) < 0.001
    camera, smooth = scene.observation.camera, scene.observation.smooth
    surface = (rays(camera) * smooth[..., None]).reshape(-1, 3)
    off_hand = distance_to_hand(surface, scene.hand, scene.hand_state).reshape(smooth.shape) > 0.001
    observation = replace(
        scene.observation,
        points=scene.observation.points[hand_only],
        normals=scene.observation.normals[hand_only],
        smooth=np.where(off_hand, np.float32(0), smooth),
    )
    with pytest.raises(NoAnswer, match="do not belong to it: the object is hidden"):
        segmented(replace(scene, observation=observation), config)


# Surfaces that are too large for the object


def before(scene: HeldObject, behind: np.ndarray) -> Observation:
    """What the camera sees of the scene when there is a surface of this depth [m] as well."""
    seen = (behind > 0) & ((scene.depth == 0) | (behind < scene.depth))
    depth = np.where(seen, behind, scene.depth).astype(np.float32)
    reach, diameter = scene.hand.hand.reach, scene.obj.model.diameter
    T = scene.hand_state.T_camera_hand
    return observe(depth, CAMERA, T, reach, diameter, ObservationConfig(), "cpu")


def plane_beyond(scene: HeldObject, outward: np.ndarray, gap: float) -> np.ndarray:
    """Depth [m] of the plane this far beyond the object's last point along `outward`."""
    T = scene.T_camera_object
    last = (transform(T, scene.obj.model.mesh.vertices) @ outward).max()
    return plane_depth(CAMERA, outward, last + gap)


@pytest.mark.parametrize("name", ["cuboid", "industrial_part", "cylinder"])
@pytest.mark.parametrize("gap", [0.01, 0.03])
@pytest.mark.parametrize("slope", [0.0, 0.7])
def test_a_wall_behind_the_object_is_not_the_object(name: str, gap: float, slope: float) -> None:
    scene = held_object(name)
    wall = plane_beyond(scene, np.array([0, np.sin(slope), np.cos(slope)]), gap)
    observation = before(scene, wall)
    diameter = scene.obj.model.diameter
    walled = replace(scene, observation=observation)
    found = segmented(walled, SOFT, size=diameter)
    right = on_object(scene, found.points)
    assert found.weight[right].sum() > 0.9 * found.weight.sum()
    alone = segmented(scene, SOFT, size=diameter)
    assert right.sum() > 0.9 * on_object(scene, alone.points).sum()
    # It is more than half of what there is without the hand.
    kept = segmented(walled, replace(SOFT, max_length=100), size=diameter)
    assert on_object(scene, kept.points).mean() < 0.5


def test_an_object_ends_where_it_stands_on_a_table() -> None:
    """The table is the plane of the cuboid's face that looks away from the camera most.

    At some places in the image, and not at others, a chain of points across the edge joins the two
    when creases do not count. So several places are looked at, fractions of a cell apart.
    """
    joined = []
    for aside in np.arange(8) * 0.0013:
        scene = held_object("cuboid", float(aside))
        axes, ahead = scene.T_camera_object[:3, :3].T, scene.T_camera_object[:3, 3]
        outward = max([*axes, *-axes], key=ahead.dot)
        on_table = replace(scene, observation=before(scene, plane_beyond(scene, outward, 0.0)))
        diameter = scene.obj.model.diameter
        found = segmented(on_table, SOFT, size=diameter)
        right = on_object(scene, found.points)
        assert found.weight[right].sum() > 0.85 * found.weight.sum()
        alone = on_object(scene, segmented(scene, SOFT, size=diameter).points).sum()
        assert right.sum() > 0.9 * alone
        flat = segmented(on_table, replace(SOFT, crease=10), size=diameter)
        joined.append(on_object(scene, flat.points).sum() < 0.1 * alone)
    assert sum(joined) >= 3


def test_a_surface_no_longer_than_the_object_stays() -> None:
    """A plate of 12 cm behind the object."""
    scene = held_object("cuboid")
    wall = plane_beyond(scene, np.array([0, 0, 1.0]), 0.02)
    beside = rays(CAMERA) * wall[..., None] - scene.T_camera_object[:3, 3]
    plate = np.where((np.abs(beside[..., :2]) < 0.06).all(axis=-1), wall, 0)
    seen = replace(scene, observation=before(scene, plate))
    kept, removed = (segmented(seen, SOFT, size=size) for size in (0.12, 0.10))
    assert on_object(scene, kept.points).mean() < 0.7
    assert on_object(scene, removed.points).mean() > 0.95
