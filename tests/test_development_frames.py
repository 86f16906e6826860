"""Accuracy on a sample of the development frames: every sixth, as `inhand bench` scores them."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from inhand.datasets.frames import find_frames, load_object, read_frame
from inhand.estimator import PoseEstimator
from inhand.evaluation.hand_errors import wrist_error
from inhand.evaluation.metrics import adi, sample_model
from inhand.hand import Hand


@pytest.fixture(scope="module")
def errors(shared_data: Path) -> dict[str, list[tuple[float, float]]]:
    """Object ADI [m] (inf without an answer) and wrist position error [m], by kind of frame."""
    hand = Hand.from_urdf(shared_data / "hands/t42/hand_T42b.urdf")
    estimators: dict[str, PoseEstimator] = {}
    found: dict[str, list[tuple[float, float]]] = {"clean": [], "real": []}
    for kind, results in found.items():
        for path in find_frames([shared_data / "dev" / kind])[::6]:
            frame = read_frame(path)
            if frame.object_name not in estimators:
                model = load_object(shared_data / "objects", frame.object_name)
                estimators[frame.object_name] = PoseEstimator(hand, model, device="cpu")
            estimator = estimators[frame.object_name]
            estimate = estimator.estimate(frame.depth, frame.camera, frame.T_camera_hand_given)
            points = sample_model(estimator.object.model.mesh, 2000)
            pose, truth = estimate.T_camera_object, frame.truth
            assert truth.T_camera_hand is not None
            assert estimate.T_camera_hand is not None
            distance = np.inf if pose is None else adi(KDTree(points), pose, truth.T_camera_object)
            wrist = wrist_error(estimate.T_camera_hand, truth.T_camera_hand)
            results.append((distance, wrist.translation))
    return found


# One frame in ten may turn, as the nearly hidden ones do with every change; no more.
@pytest.mark.parametrize(("kind", "least"), [("clean", 0.9), ("real", 0.75)])
def test_object_is_found(
    errors: dict[str, list[tuple[float, float]]], kind: str, least: float
) -> None:
    assert np.mean([distance < 0.005 for distance, _ in errors[kind]]) >= least


@pytest.mark.parametrize(("kind", "most"), [("clean", 0.0003), ("real", 0.001)])
def test_wrist_is_corrected(
    errors: dict[str, list[tuple[float, float]]], kind: str, most: float
) -> None:
    assert np.median([wrist for _, wrist in errors[kind]]) < most
