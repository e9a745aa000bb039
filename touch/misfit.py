"""Is what contacts leave over noise, or another shape? Evidence that a candidate is not what was touched.

Contacts of the true object are off its surface by noise that each has of its own, and by what its mesh leaves out.
Contacts of another object that resembles it are off by a smooth field over the surface: neighbours err together, and
by millimetres. Both are Gaussian; their sizes are unknown and integrated out. Object frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import lgamma

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MisfitSettings:
    """What sizes of noise and of misfit are thought possible. Values by judgement where no source is named."""

    # No finger is truer than this (m).
    least_noise: float = 0.1e-3
    # What a mesh leaves out of its own object (m): scans of products agree to half a millimetre.
    mesh_sigma: float = 0.5e-3
    # How far another object of the same kind is off at least, and at most (m); equal weight per factor.
    least_other: float = 0.5e-3
    most_other: float = 30e-3
    # One that is plainly another is off by this at least (m): recorded contacts leave half a millimetre over, smoothly,
    # on the right tool. Evidence against these is not diluted by those that nothing tells from a mesh's own errors
    # (tuned on draws of nine tools).
    plainly: float = 2e-3
    # Lengths over which a misfit stays the same, as shares of the object's diameter: a scan's dents, another's parts.
    lengths: tuple[float, ...] = (0.03, 0.08, 0.2)
    # A residual of more than this many sigmas, sigma from their median, and of more than this (m), is wild: it is
    # trusted as much less. Half of the contacts may fit a relative exactly, and the misfit be in the others alone.
    least_wild: float = 5e-3
    cut: float = 3.0
    # A wild contact is false, and left out, where its neighbours would tell of a misfit and do not: they leave less
    # than this share of the variance open, and predict less than this share of what is wild.
    open_share: float = 0.7
    shared: float = 0.5
    # What is wild and has no neighbours to tell may be false, too: over how many metres those are anywhere; and true
    # contacts for each of them beforehand (no unit): their share has a beta distribution of 1 and this.
    false_reach: float = 0.1
    true_before: float = 8.0
    # Sizes tried of the misfit, and of the noise.
    steps: tuple[int, int] = (24, 16)


def log_odds_of_another(
    points: Array,
    normals: Array,
    residuals: Array,
    diameter: float,
    noise: tuple[float, float],
    settings: MisfitSettings | None = None,
) -> tuple[float, float]:
    """Log Bayes factors (nats) that contacts were made on another object rather than on this one: on any other, and on
    one that is plainly another.

    points (n, 3): of the surface, nearest to the contacts, relative to the object's centroid; outward normals (n, 3)
    there; residuals (n,): signed distances of the contacts at the fitted pose; diameter (m); noise: least and most
    sigma (m) of a contact. What the six freedoms of the pose could have fitted tells nothing and is projected out: few
    contacts give 0.
    """
    s = settings or MisfitSettings()
    median = float(np.median(np.abs(residuals)))
    limit = max(s.cut * 1.48 * median, s.least_wild)
    # a misfit is a field on the surface: where noise put a contact it would be a smooth function of that noise; what is
    # beyond noise is where it was felt
    beyond = np.sign(residuals) * np.maximum(np.abs(residuals) - limit, 0.0)
    places = points + beyond[:, None] * normals, points + residuals[:, None] * normals
    apart, felt = (np.sum((x[:, None] - x[None]) ** 2, axis=2) for x in places)
    false, doubtful = _false(residuals, felt / (s.lengths[-1] * diameter) ** 2, limit, median, s)
    true = ~false
    jacobian = np.concatenate([np.cross(normals, points) / diameter, -normals], axis=1)
    lengths = [share * diameter for share in s.lengths]

    def told(chosen: NDArray[np.bool_]) -> tuple[Array, int]:
        own = apart[np.ix_(chosen, chosen)]
        return _hypotheses(jacobian[chosen], residuals[chosen], own, lengths, limit, noise, s)

    logs, free = told(true)
    if free > 0 and doubtful.any():
        tame = true & ~doubtful
        # or what is wild and not borne out is false, whichever object it is: anywhere, but what the pose could fit
        left, fewer = told(tame)
        some, beside = true.sum() - tame.sum(), tame.sum()
        share = lgamma(1 + some) + lgamma(s.true_before + beside) - lgamma(1 + s.true_before + some + beside)
        share += np.log(s.true_before)
        logs = np.logaddexp(logs, left + share + (free - fewer) * (0.5 * np.log(2.0 * np.pi) - np.log(s.false_reach)))
    return float(logs[1] - logs[0]), float(logs[2] - logs[0])


def _hypotheses(
    jacobian: Array,
    residuals: Array,
    apart: Array,
    lengths: list[float],
    limit: float,
    noise: tuple[float, float],
    settings: MisfitSettings,
) -> tuple[Array, int]:
    """Log likelihoods (3,) of residuals (n,) on this object, on another, and on one that is plainly another, powers of
    2 pi left out; and of how many numbers: none where the pose, jacobian (n, 6), could have fitted all. apart (n, n):
    squared distances (m^2).
    """
    if not len(residuals):
        return np.zeros(3), 0
    # a wild contact is as noisy as it is off: alone it tells nothing, many together do
    trust = np.minimum(1.0, limit / np.maximum(np.abs(residuals), limit))
    left, values, _ = np.linalg.svd(jacobian * trust[:, None], full_matrices=True)
    free = left[:, int((values > 1e-6 * max(float(values[0]), 1e-300)).sum()) :]
    if free.shape[1] < 1:
        return np.zeros(3), 0
    rest = free.T @ (trust * residuals)
    free = free * trust[:, None]
    sizes = np.geomspace(0.1 * settings.mesh_sigma, settings.most_other, settings.steps[0])
    sigmas = np.geomspace(noise[0], max(noise[1], 1.001 * noise[0]), settings.steps[1])
    likelihood = np.stack([_likelihood(free, rest, apart, length, sizes, sigmas) for length in lengths])
    # equal weight per factor of the noise and of another's misfit; a half Gaussian on that of the own mesh
    own = np.log(sizes) - 0.5 * (sizes / settings.mesh_sigma) ** 2
    others = [np.where(sizes >= least, 0.0, -np.inf) for least in (settings.least_other, settings.plainly)]
    told = np.logaddexp.reduce(np.logaddexp.reduce(likelihood, axis=2), axis=0)
    logs = [np.logaddexp.reduce(told + w) - np.logaddexp.reduce(w) for w in (own, *others)]
    return np.array(logs) + np.log(trust).sum() - np.log(len(lengths) * len(sigmas)), free.shape[1]


def _false(
    residuals: Array, apart: Array, limit: float, median: float, settings: MisfitSettings
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which contacts (n,) are false: wild alone, among neighbours that are not; and which may be: wild, with too few
    neighbours to tell. Where neighbours are as wild, the same way, all are off together, and none is false.

    apart (n, n): squared distances, in lengths of the misfit; limit and median (m): of wild residuals, and of their
    sizes. What the others predict of each residual is its leave-one-out mean under a Gaussian process (Rasmussen and
    Williams 2006, eq. 5.12), of wild ones no more than the limit.
    """
    wild = np.abs(residuals) > limit
    if not wild.any():
        return wild, wild
    noise = max(1.48 * median, settings.least_noise)
    inverse = np.linalg.inv(limit**2 * np.exp(-0.5 * apart) + noise**2 * np.eye(len(residuals)))
    held = np.clip(residuals, -limit, limit)
    left_open = 1.0 / np.diag(inverse)
    predicted = held - (inverse @ held) * left_open
    told = left_open < settings.open_share * (limit**2 + noise**2)
    alone = predicted * np.sign(residuals) < settings.shared * limit
    return np.asarray(wild & told & alone), np.asarray(wild & ~told)


def _likelihood(free: Array, rest: Array, apart: Array, length: float, sizes: Array, sigmas: Array) -> Array:
    """Log likelihood (sizes, sigmas) of residuals under a smooth field of each size and noise of each sigma."""
    kernel = free.T @ np.exp(-0.5 * apart / length**2) @ free
    values, vectors = np.linalg.eigh(0.5 * (kernel + kernel.T))
    along = (vectors.T @ rest) ** 2
    variance = sizes[:, None, None] ** 2 * np.maximum(values, 0.0) + sigmas[:, None] ** 2
    return np.asarray(-0.5 * np.sum(np.log(variance) + along / variance, axis=2), dtype=np.float64)
