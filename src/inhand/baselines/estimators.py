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


def estimators(seed: int = 0) -> dict[str, Method]:
    """The default method, the paper's, and the steps of the ablation, by name."""
    configs = {"inhand": EstimatorConfig(), "paper": EstimatorConfig.paper(), **ablation()}
    return {name: Estimator(name, replace(c, seed=seed)) for name, c in configs.items()}


def ablation() -> dict[str, EstimatorConfig]:
    """The way from the paper's baseline to the default method, one step after the other, by name.

    The first five are the paper's ablation: random bases on the whole scene cloud, the hand removed
    with its estimated state, the PPF constraint, heuristic sampling, and pruning by physics and
    rendering, which completes the paper's method. Each of the others replaces one of its stages by
    this project's; the likelihood leaves nothing to pruning. With its first and second look, the
    last one is the default method.
    """
    default, paper = EstimatorConfig(), EstimatorConfig.paper()
    # Without the features, a base's pairs are like many more pairs of the model.
    unconstrained = HypothesesConfig(
        method="congruent_sets", ppf_constraint=False, heuristic=False, max_pairs_per_base=5000
    )
    config = replace(
        paper,
        segmentation=SegmentationConfig(method="none"),
        hypotheses=unconstrained,
        pruning=PruningConfig(method="none"),
        selection=SelectionConfig(method="render", keep_share=1.0),
    )
    steps = {"ablation-baseline": config}
    for name, changes in (
        ("hand-state", {"segmentation": paper.segmentation}),
        ("ppf", {"hypotheses": replace(paper.hypotheses, heuristic=False)}),
        ("heuristic", {"hypotheses": paper.hypotheses}),
        ("pruning", {"pruning": paper.pruning, "selection": paper.selection}),
        ("joint-hand", {"wrist": default.wrist, "hand_state": default.hand_state}),
        ("soft-segment", {"segmentation": default.segmentation}),
        ("pairs", {"hypotheses": default.hypotheses, "clustering": default.clustering}),
        ("field-refinement", {"refinement": default.refinement}),
        ("likelihood", {"pruning": default.pruning, "selection": default.selection}),
        ("looks", {"first_look": default.first_look, "second_look": default.second_look}),
    ):
        config = replace(config, **changes)
        steps[f"ablation-{name}"] = config
    return steps
