"""Mean and covariance where the posterior is no Gaussian.

A Gauss-Newton matrix tells how evidence bends at one pose. Some evidence bends otherwise a step away: space that was
seen to be empty, and the hand itself, are walls with nothing before them; and normals felt on the facets of a mesh step
from facet to facet, as if each were sure of its own. A mug whose handle is hidden may turn until the handle would show;
Laplace's method is sure of a pose that the data do not tell. Here such directions are found by importance sampling from
the cost itself (defensive mixture, self-normalised: Owen, Monte Carlo theory, methods and examples, chapter 9). Only
they are changed: all else keeps its Gaussian, which knows of the errors that a frame's rows share.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.solve.kernels import log_mixture
from scenes.evidence.align import AlignSettings, Prior, align, costs, terms
from scenes.evidence.search import thin
from scenes.evidence.table import SIGMA_NORMAL, TOUCH, Evidence, stack
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from touch.polish import NO_DISTANCE

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MomentSettings:
    """When and how the posterior is sampled. Tuned on generated captures."""

    # Uneven evidence that holds less than this share of the information in every direction is not looked into.
    share: float = 0.2
    # Vision rows that stand for all (see scenes.evidence.search.thin), and samples: with a third of them effective the
    # error of a standard deviation is 8 % of it.
    rows: int = 100
    samples: int = 240
    # Fewer effective samples than this tell nothing: the Gaussian stays.
    effective: float = 20.0
    # Directions this many times as wide (variance) as Laplace's method has them are changed.
    wider: float = 1.5
    # When so many of the first half of the samples are effective, and they change nothing, the rest is not drawn.
    clear: float = 40.0
    # Width of a direction that nothing else bounds: rad, and shares of the object's radius (as for modes).
    widest_angle: float = 1.0
    widest_share: float = 1.0


@dataclass(frozen=True)
class Moments:
    """pose (4, 4) frame_from_object and covariance (6, 6) about the centroid; effective: samples that carried weight,
    0 when none were drawn; widened: directions that were changed.
    """

    pose: Array
    covariance: Array
    effective: float
    widened: int


def uneven_rows(rows: Evidence) -> Evidence:
    """The rows whose cost may be no parabola over the posterior: one-sided ones, and of contacts the normals alone."""
    walls, normals = (rows.take(own) for own in _uneven(rows))
    return stack(walls, normals.with_sigma(NO_DISTANCE, TOUCH))


def _uneven(rows: Evidence) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(n,) whether each row is one-sided, and whether it is a contact with a normal."""
    walls = ~rows.on
    return walls, rows.on & (rows.rows[:, SIGMA_NORMAL] > 0.0) & (rows.sense == TOUCH)


def moments(
    model: ObjectModel,
    rows: Evidence,
    pose: Array,
    covariance: Array,
    seed: int,
    prior: Prior | None = None,
    settings: MomentSettings | None = None,
) -> Moments:
    """Pose and covariance with directions in which the posterior is no Gaussian as wide as it is.

    (pose, covariance): the Gaussian so far. rows and prior: all evidence, frame_from_object.
    """
    settings = settings or MomentSettings()
    if not any(own.any() for own in _uneven(rows)):
        return Moments(pose, covariance, 0.0, 0)
    few = thin(rows, settings.rows)
    found = align(model, few, pose[None], prior, AlignSettings(iterations=10))
    middle, hessian = found.poses[0], found.hessians[0]
    weak = np.array([settings.widest_angle] * 3 + [settings.widest_share * model.radius] * 3) ** -2.0
    hessian = hessian + np.diag(weak)
    scale = 1.0 / np.sqrt(np.diag(hessian))
    lower = np.linalg.cholesky(hessian * scale * scale[:, None] + 1e-9 * np.eye(6))
    # columns: directions of unit length under Laplace's method
    factor = scale[:, None] * np.linalg.inv(lower).T
    _, _, theirs = terms(model, uneven_rows(few), middle, settings=AlignSettings(bend=0.0))
    held = factor.T @ theirs @ factor
    values, vectors = np.linalg.eigh(0.5 * (held + held.T))
    if values[-1] < settings.share:
        return Moments(pose, covariance, 0.0, 0)
    basis = factor @ vectors
    # without the uneven rows a direction is as wide as what is left of its information
    wide = 1.0 / np.sqrt(np.maximum(1.0 - values, np.sum(basis**2 * weak[:, None], axis=0)))
    proposals = [(np.zeros(6), np.diag(w)) for w in (np.ones(6), np.sqrt(wide), wide)]

    def log_target(z: Array) -> Array:
        samples = se3.perturb(middle, z @ basis.T, model.centroid)
        return -costs(model, few, samples, prior)

    rng = np.random.default_rng(seed)
    each = settings.samples // (2 * len(proposals))
    z = np.concatenate([mean + rng.normal(size=(each, 6)) @ factor.T for mean, factor in proposals])
    log = log_target(z)
    first = log - _log_mixture(z, proposals, np.full(len(proposals), each))
    weights = np.exp(first - first.max())
    weights /= weights.sum()
    effective = float(1.0 / np.sum(weights**2))
    if effective >= settings.clear and np.linalg.eigvalsh(_weighted(z, weights)[1])[-1] < settings.wider:
        return Moments(pose, covariance, effective, 0)
    z, weights = _sampled_on(log_target, proposals, (z, log, first), settings, rng)
    effective = float(1.0 / np.sum(weights**2))
    if effective < settings.effective:
        return Moments(pose, covariance, effective, 0)
    mean, spread = _weighted(z, weights)
    variances, axes = np.linalg.eigh(spread)
    changed = variances > settings.wider
    along = basis @ axes[:, changed]
    shift = along @ (axes[:, changed].T @ mean)
    wider = covariance + (along * (variances[changed] - 1.0)) @ along.T
    return Moments(se3.perturb(pose, shift, model.centroid), wider, effective, int(changed.sum()))


def _sampled_on(
    log_target: Callable[[Array], Array],
    proposals: list[tuple[Array, Array]],
    drawn: tuple[Array, Array, Array],
    settings: MomentSettings,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Samples (n, 6) and weights (n,) that sum to 1: half from the proposals (mean, factor), half from what these find.

    drawn: the first half, as many from each proposal, their log targets, and these less the log density they were drawn
    with. All weights are against the mixture of all proposals (deterministic mixture: Owen, section 9.11).
    """
    z, log, first = drawn
    each = len(z) // len(proposals)
    # tempered until enough samples carry weight, so that what they find is a region and not a point
    for power in (1.0, 0.5, 0.25, 0.125):
        weights = np.exp(power * (first - first.max()))
        weights /= weights.sum()
        if 1.0 / np.sum(weights**2) >= settings.effective:
            break
    mean, spread = _weighted(z, weights)
    found: tuple[Array, Array] = mean, np.asarray(np.linalg.cholesky(spread + 1e-6 * np.eye(6)), dtype=np.float64)
    more = mean + rng.normal(size=(3 * each, 6)) @ found[1].T
    z, log = np.concatenate([z, more]), np.concatenate([log, log_target(more)])
    log = log - _log_mixture(z, [*proposals, found], np.array([*[each] * len(proposals), 3 * each]))
    weights = np.exp(log - log.max())
    return z, weights / weights.sum()


def _log_mixture(z: Array, proposals: list[tuple[Array, Array]], counts: NDArray[np.int64]) -> Array:
    """Log density (n,) of the mixture of Gaussians (mean, lower factor), `counts` of each, up to a constant."""
    means, factors = (np.array([proposal[k] for proposal in proposals]) for k in (0, 1))
    out = np.zeros(len(z))
    log_mixture(np.ascontiguousarray(z), means, factors, counts.astype(np.float64), out)
    return out


def _weighted(z: Array, weights: Array) -> tuple[Array, Array]:
    """Mean (6,) and covariance (6, 6)."""
    mean = weights @ z
    return mean, ((z - mean) * weights[:, None]).T @ (z - mean)
