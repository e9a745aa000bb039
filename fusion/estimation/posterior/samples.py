"""Poses drawn from what an answer says, for whoever plans with all that may be the case and not with one pose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import Estimate
from scenes.errors import InputError
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.checking.validation import check_is_model
from touch.answers import Localization

Array = NDArray[np.float64]


def sample_poses(model: ObjectModel, answer: Estimate | Localization, count: int, seed: int = 0) -> Array:
    """Poses (count, 4, 4) drawn from the answer's modes by their weights, each as wide as its covariance; in the frame
    of `answer.pose`, so of an `Estimate` camera_from_object.

    Drawn from Gaussians, whose tails are shorter than those of errors (see `Estimate`). A mode whose covariance is not
    finite is left out; none left, the result has no row. That no mode is right is not drawn: see `confidence`.
    """
    check_is_model(model)
    if not isinstance(count, int | np.integer) or count < 0:
        raise InputError(f"count: expected a whole number from 0, got {count!r}")
    rng = np.random.default_rng([seed, getattr(answer, "frame", 0)])
    modes = [mode for mode in answer.modes if np.isfinite(mode.covariance).all() and mode.weight > 0]
    if not modes or not count:
        return np.zeros((0, 4, 4))
    weights = np.array([mode.weight for mode in modes])
    which = rng.choice(len(modes), size=count, p=weights / weights.sum())
    roots = []
    for mode in modes:
        values, axes = np.linalg.eigh(0.5 * (mode.covariance + mode.covariance.T))
        roots.append(axes * np.sqrt(np.maximum(values, 0.0)))
    deltas = np.einsum("nij,nj->ni", np.array(roots)[which], rng.normal(size=(count, 6)))
    return se3.perturb(np.array([mode.pose for mode in modes])[which], deltas, model.centroid)
