"""How sure a followed pose is."""

import math

from inhand.tracking.config import LossConfig


def confidence_of(score: float, config: LossConfig) -> float:
    """Probability that a followed pose is right, from its score."""
    logit = config.confidence_bias + config.confidence_fit * score
    return 1 / (1 + math.exp(-max(min(logit, 50.0), -50.0)))
