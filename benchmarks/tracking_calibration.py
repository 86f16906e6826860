"""Fits what a score says about whether a followed pose is right (`LossConfig`).

    python benchmarks/tracking_calibration.py out/track-fit --test out/track-test

The tracker follows every sequence. At every third image, the object is also followed from poses up
to 40 degrees and 12 mm away from the expected and from the true one: many of these end where a lost
tracker would be. A logistic regression on the scores of all of them, less the log odds of a right
pose among them, gives `evidence_bias` and `evidence_fit`. A pose is right below an ADI of 5 mm.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial import KDTree

import inhand
from inhand.datasets.bop_images import read_image
from inhand.datasets.bop_models import load_model, model_name
from inhand.datasets.bop_scene import find_hand, find_scenes, read_scene
from inhand.errors import NoAnswer
from inhand.evaluation.metrics import adi, sample_model
from inhand.evaluation.statistics import auroc
from inhand.stages.observation import Observation
from inhand.stages.results import HandState
from inhand.tracking.gaussian import moved
from inhand.tracking.object_track import FollowedObject
from inhand.tracking.track import Track, start_covariance

RIGHT = 0.005
"""ADI below which a pose is right [m]."""
EVERY, PROBES = 3, 3
"""Images from probes to probes, and probes about either pose."""
TURN, SHIFT = 0.7, 0.012
"""Farthest that a probe begins away, about and along each axis, in standard deviations [rad, m]."""


class ProbedTracker(inhand.PoseTracker):
    """A tracker that can be asked what it would have made of another expectation."""

    seen: tuple[Observation, HandState, Track] | None = None
    """What it followed the object with in the last image."""

    def _follow_object(
        self, observation: Observation, state: HandState, track: Track
    ) -> FollowedObject:
        self.seen = observation, state, track
        return super()._follow_object(observation, state, track)

    def probe(self, T_camera_object: NDArray[np.float64]) -> FollowedObject:
        """The object in the last image, followed from this pose."""
        observation, state, track = self.seen
        elsewhere = replace(
            track,
            T_camera_object=T_camera_object,
            object_covariance=start_covariance(self.config),
        )
        return super()._follow_object(observation, state, elsewhere)


def scores(scene: Path, rng: np.random.Generator) -> Iterator[tuple[float, float]]:
    """Score and ADI [m] of followed poses in a sequence, right ones and wrong ones."""
    models = scene.parents[1] / "models"
    name = model_name(models, read_image(scene, 0).instances[0].object_id)
    obj = load_model(models, name)
    tracker = ProbedTracker(inhand.Hand.from_urdf(find_hand(scene)), obj, device="cpu")
    tree = KDTree(sample_model(obj.mesh))
    for i in sorted(read_scene(scene).truth):
        image, tracker.seen = read_image(scene, i), None
        given = image.hand.T_camera_hand_given
        tracker.update(image.depth, image.camera, given, time=image.time)
        if tracker.seen is None:
            continue
        truth, expected = image.instances[0].T_camera_object, tracker.seen[2].T_camera_object
        starts = [expected]
        if i % EVERY == 0:
            starts += [_away(T, obj.centre, rng) for T in [expected, truth] * PROBES]
        for T in starts:
            try:
                found = tracker.probe(T)
            except NoAnswer:
                continue
            yield found.score, adi(tree, found.T_camera_object, truth)


def _away(
    T: NDArray[np.float64], pivot: NDArray[np.float64], rng: np.random.Generator
) -> NDArray[np.float64]:
    turn, shift = rng.normal(size=3) * rng.uniform(0, TURN), rng.normal(size=3)
    return moved(T, np.concatenate([turn, shift * rng.uniform(0, SHIFT)]), pivot)


def fit(score: NDArray[np.float64], right: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Bias and slope of a logistic regression."""
    sign = np.where(right, 1.0, -1.0)
    return minimize(
        lambda b: np.logaddexp(0, -sign * (b[0] + b[1] * score)).mean() + 1e-4 * b @ b, np.zeros(2)
    ).x


def report(score: NDArray[np.float64], right: NDArray[np.bool_], b: NDArray[np.float64]) -> None:
    """Print how well the probabilities hold."""
    p = 1 / (1 + np.exp(-b[0] - b[1] * score))
    print(f"{len(p)} poses, {right.mean():.1%} right, AUROC {auroc(p, right) or np.nan:.3f}")
    for low, high in zip((0, 0.2, 0.4, 0.6, 0.8, 0.9), (0.2, 0.4, 0.6, 0.8, 0.9, 1), strict=True):
        inside = (p >= low) & (p <= high)
        if inside.any():
            print(f"  {low:.1f} to {high:.1f}: {right[inside].mean():.1%} of {inside.sum()} right")


def main() -> int:
    """Fit on some data sets, and look at others."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", type=Path, nargs="+", help="data sets of sequences")
    parser.add_argument("--test", type=Path, nargs="*", default=[], help="others, to look at")
    args = parser.parse_args()
    b = None
    for folders in (args.folders, args.test):
        rng = np.random.default_rng(0)
        pairs = [pair for f in folders for s in find_scenes(f) for pair in scores(s, rng)]
        if not pairs:
            continue
        score, error = np.array(pairs).T
        right = error < RIGHT
        if b is None:
            b = fit(score, right)
            odds = np.log(right.mean() / (1 - right.mean()))
            print(f"evidence_bias {b[0] - odds:.2f}, evidence_fit {b[1]:.2f}")
        report(score, right, b)
    return 0


if __name__ == "__main__":
    sys.exit(main())
