"""This project's estimator under the methods' interface: as it is, as the paper's, and the steps
between the two."""

from dataclasses import dataclass, replace

from inhand.baselines.method import Method, PreparedMethod, View
from inhand.config import (
    EstimatorConfig,
    HypothesesConfig,
    PruningConfig,
    SegmentationConfig,
    SelectionConfig,
)
from inhand.estimate import PoseEstimate
from inhand.estimator import PoseEstimator, StageResults
from inhand.hand import Hand
from inhand.object_model import ObjectModel


@dataclass(frozen=True)
class Estimator(Method):
    """`PoseEstimator` with one configuration."""

    name: str
    config: EstimatorConfig

    def prepare(self, hand: Hand, obj: ObjectModel, device: str) -> PreparedMethod:
        """The estimator of this hand and object."""
        return _Prepared(PoseEstimator(hand, obj, config=self.config, device=device))


class _Prepared(PreparedMethod):
    def __init__(self, estimator: PoseEstimator) -> None:
        self._estimator = estimator

    def run(self, view: View) -> tuple[PoseEstimate, StageResults]:
        return self._estimator.run(view.depth, view.camera, view.T_camera_hand)


def ablation() -> dict[str, EstimatorConfig]:
    """The way from the paper's baseline to the default method, one step after the other, by name.

    The first five rows are the paper's ablation: random base sampling on the whole scene cloud,
    hand removal, the PPF constraint, heuristic sampling, and pruning by physics and rendering,
    which completes the paper's method. The others replace its stages by this project's. The last
    one, which leaves physics to the likelihood, is the default method, `inhand`.
    """
    default, paper = EstimatorConfig(), EstimatorConfig.paper()
    # Without the features a base's pairs are like many more pairs of the model.
    every_pair = HypothesesConfig(
        method="congruent_sets", ppf_constraint=False, heuristic=False, max_pairs_per_base=5000
    )
    baseline = replace(
        paper,
        segmentation=SegmentationConfig(method="none"),
        hypotheses=every_pair,
        pruning=PruningConfig(method="none"),
        selection=SelectionConfig(method="render", keep_share=1.0),
    )
    steps = {"ablation-baseline": baseline}

    def add(name: str, **sections: object) -> None:
        steps[f"ablation-{name}"] = replace(list(steps.values())[-1], **sections)

    add("hand-state", segmentation=paper.segmentation)
    add("ppf", hypotheses=HypothesesConfig(method="congruent_sets", heuristic=False))
    add("heuristic", hypotheses=paper.hypotheses)
    add("pruning", pruning=paper.pruning, selection=paper.selection)
    add("joint-hand", wrist=default.wrist, hand_state=default.hand_state)
    add("soft-segment", segmentation=default.segmentation)
    add("pairs", hypotheses=default.hypotheses, clustering=default.clustering)
    add("field-refinement", refinement=default.refinement)
    add("likelihood", selection=default.selection, pruning=default.pruning)
    return steps
