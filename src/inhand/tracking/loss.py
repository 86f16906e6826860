"""How sure a followed pose is: a hidden Markov model with two states, right and lost."""

import math

from inhand.tracking.config import LossConfig


def expected_confidence(confidence: float, config: LossConfig) -> float:
    """Probability that a pose is right in the next image, before looking at it."""
    return min(confidence, config.most) * (1 - config.loss_rate)


def seen_confidence(expected: float, score: float, config: LossConfig) -> float:
    """The same after its score there."""
    odds = math.log(expected / (1 - expected)) if 0 < expected < 1 else -50.0
    odds += config.evidence_bias + config.evidence_fit * score
    return 1 / (1 + math.exp(-max(min(odds, 50.0), -50.0)))
