from dataclasses import replace

import numpy as np
import pytest
from held_object import HeldObject, distance_to_hand, held_object
from reference_depth import rays

from inhand.config import SegmentationConfig
from inhand.errors import NoAnswer
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


def test_a_small_segment_takes_every_pixel() -> None:
    scene = held_object("cuboid")
    sparse = segmented(scene, SOFT)
    dense = segmented(scene, replace(SOFT, dense_below=len(sparse.points) + 1))
    assert len(dense.points) > 3 * len(sparse.points)
    assert (rows(dense.points, scene.observation.every_pixel.points) >= 0).all()
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
