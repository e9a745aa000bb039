"""Drawing particles: from a prior, and in proportion to their weights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.align import Prior
from scenes.evidence.modes import covariance_of
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]


def from_prior(model: ObjectModel, prior: Prior, count: int, rng: np.random.Generator) -> Array:
    """(count, 4, 4) poses drawn from a prior's Gaussian about the object's centroid."""
    spread = np.linalg.cholesky(covariance_of(model, prior.information))
    return se3.perturb(prior.pose, rng.normal(size=(count, 6)) @ spread.T, model.centroid)


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
