from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from held_object import CAMERA, held_object

from inhand.datasets.frames import LABEL_OBJECT
from inhand.estimator import StageResults
from inhand.evaluation.diagnosis import segment_quality
from inhand.stages.results import Segment


@pytest.mark.parametrize("finer", [0, 1])
def test_a_segment_is_judged_by_the_cloud_it_was_chosen_from(finer: int) -> None:
    observation = held_object("cuboid").observation
    assert observation.step > 1
    cloud = observation.cloud(observation.step - finer)
    pixels = np.rint(CAMERA.project(cloud.points.astype(np.float64))).astype(int)
    labels = np.zeros((CAMERA.height, CAMERA.width), dtype=np.uint8)
    labels[:, CAMERA.width // 2 :] = LABEL_OBJECT
    is_object = pixels[:, 0] >= CAMERA.width // 2
    rng = np.random.default_rng(0)
    weight = rng.uniform(0, 1, len(cloud.points)).astype(np.float32)
    keep = rng.random(len(cloud.points)) < 0.7
    kept = (cloud.points[keep], cloud.normals[keep], np.zeros(keep.sum()), weight[keep])

    results = StageResults(observation=observation, segment=Segment(*kept))
    frame: Any = SimpleNamespace(camera=CAMERA, truth=SimpleNamespace(label=labels))
    quality = segment_quality(results, frame)

    of_object = weight[keep & is_object].sum()
    assert quality is not None
    assert quality.precision == pytest.approx(of_object / weight[keep].sum(), rel=1e-5)
    assert quality.recall == pytest.approx(of_object / is_object.sum(), rel=1e-5)
