"""Drawing particles in proportion to their weights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def normalised(log_weights: Array) -> Array:
    """Weights (n,) that sum to 1 from their logs, whatever their size; -inf is 0, all -inf is uniform."""
    top = log_weights.max()
    if not np.isfinite(top):
        return np.full(len(log_weights), 1.0 / len(log_weights))
    weights = np.exp(log_weights - top)
    return weights / weights.sum()


def systematic(log_weights: Array, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """(count,) indices, each drawn floor or ceil of count x weight times: one random number, the least variance."""
    edges = np.cumsum(normalised(log_weights))
    at = (rng.random() + np.arange(count)) / count
    return np.minimum(np.searchsorted(edges, at * edges[-1], side="right"), len(log_weights) - 1)
