"""From many aligned poses to the few distinct ones, with their share of the posterior.

Poses are told apart modulo the object's symmetries, in millimetres of its surface: the largest displacement of a point
at the object's radius. Weights follow Laplace's method: exp(-cost) sqrt(det(2 pi H^-1)), H with a weak prior added
so that a free direction has the width of everything it could be, not infinity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenes.errors import check_above
from scenes.evidence.align import Alignment
from scenes.evidence.leader_kernels import are_one, displacements
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]

# Least variance (rad^2, m^2) that is told from none, and eigenvalue of a correlation (no unit) that rounding leaves.
LEAST_VARIANCE, KNOWN = 1e-280, 1e-14


@dataclass(frozen=True, eq=False)
class Mode:
    """One pose that the data cannot tell from the others.

    pose (4, 4) frame_from_object; weight: its share of the posterior, all modes sum to 1; cost: negative log
    posterior density at the pose, up to a constant shared by all modes; covariance (6, 6): rotation (rad) then
    translation (m) in the frame's axes, about the object's centroid.
    """

    pose: Array
    weight: float
    cost: float
    covariance: Array


@dataclass(frozen=True)
class ModeSettings:
    """When two answers are one, and how wide an unknown direction is. Values by judgement."""

    # Displacement of the object's surface, as a share of its radius, under which two poses are one mode.
    merge_share: float = 0.12
    # Two poses that are this many standard deviations away, by what ties each of them, are one mode, however far.
    merge_sigmas: float = 3.0
    # Width of a direction about which nothing is known: radians, and shares of the object's radius.
    widest_angle: float = 1.0
    widest_share: float = 1.0
    # Modes whose cost is this much above the best have less than 1e-4 of its weight and are not listed.
    cost_margin: float = 12.0
    # As many modes as anyone will look at.
    most: int = 24
    # What a mode's log weight is made of: the share of its cost that counts (1: each row is of its own, less where rows
    # share errors) and the power of its width, the root of its covariance's determinant. 1 and 1 are Laplace's method.
    temper: float = 1.0
    width: float = 1.0
    # How much of what lies between a mode and the minima that are one with it, weighed as modes are, its covariance has
    # (no unit): a valley in which several solutions end is as wide as they lie apart, whatever the curvature in each.
    # Nearer than this share of `merge_share` minima are the same one, which solutions ended in more than once.
    scatter: float = 0.0
    same_share: float = 0.25

    def __post_init__(self) -> None:
        """Refuse no modes at all, and widths that are none."""
        check_above(self, ("most", "widest_angle", "widest_share"))


def covariance_of(model: ObjectModel, hessian: Array, settings: ModeSettings | None = None) -> Array:
    """(..., 6, 6) inverses of Gauss-Newton Hessians regularised by the widest prior; finite for any Hessian."""
    settings = settings or ModeSettings()
    weak = np.array([settings.widest_angle] * 3 + [settings.widest_share * model.radius] * 3)
    # scaled by the widths, the matrix is at least the identity: its inverse never fails
    scaled = hessian * weak * weak[:, None] + np.eye(6)
    values, vectors = np.linalg.eigh(0.5 * (scaled + np.swapaxes(scaled, -1, -2)))
    inverse = (vectors / np.maximum(values, 1.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    return np.asarray(inverse * weak * weak[:, None])


def information_of(covariances: Array) -> Array:
    """Inverses (..., 6, 6) of covariances, finite for any: in units of each unknown's own width no direction is known
    better than to a ten-millionth.
    """
    width = np.sqrt(np.maximum(np.diagonal(covariances, axis1=-2, axis2=-1), LEAST_VARIANCE))
    units = width[..., :, None] * width[..., None, :]
    values, vectors = np.linalg.eigh(0.5 * (covariances + np.swapaxes(covariances, -1, -2)) / units)
    return np.asarray((vectors / np.maximum(values, KNOWN)[..., None, :]) @ np.swapaxes(vectors, -1, -2) / units)


def weighed(modes: tuple[Mode, ...], settings: ModeSettings) -> tuple[Mode, ...]:
    """The same modes, at least one, in the same order, with the shares that other settings give them."""
    costs, covariances = np.array([mode.cost for mode in modes]), np.array([mode.covariance for mode in modes])
    weights = _weights(costs, covariances, settings)
    return tuple(replace(mode, weight=float(weight)) for mode, weight in zip(modes, weights))


def _weights(costs: Array, covariances: Array, settings: ModeSettings) -> Array:
    """Shares (n,) of the posterior, see `ModeSettings.temper`."""
    if len(costs) == 1:
        return np.ones(1)
    log_weights = -settings.temper * costs + 0.5 * settings.width * np.linalg.slogdet(covariances)[1]
    weights = np.exp(log_weights - log_weights.max())
    return np.asarray(weights / weights.sum())


def displaced(model: ObjectModel, poses: Array, pose: Array) -> Array:
    """(n,) metres by which a point at the object's radius moves at most from poses (n, 4, 4) to `pose` (4, 4), modulo
    symmetry.
    """
    delta, out = se3.difference(model.symmetries.nearest(poses, pose), pose, model.centroid), np.zeros(len(poses))
    displacements(delta, model.radius, out)
    return out


def _scatter(
    model: ObjectModel, alignment: Alignment, lead: int, others: NDArray[np.intp], off: Array, settings: ModeSettings
) -> Array:
    """(6, 6) of how far minima `others` (n,) lie from `lead`, by off (n, 6) (rad, m), each weighed as a mode would be:
    each counts once, however many solutions ended there.
    """
    units = np.repeat([model.radius, 1.0], 3)
    nearest = settings.same_share * settings.merge_share * model.radius
    apart: list[int] = []
    for k, one in enumerate(off):
        if min(float(np.linalg.norm((one - there) * units)) for there in (np.zeros(6), *off[apart])) > nearest:
            apart.append(k)
    if not apart:
        return np.zeros((6, 6))
    every = [lead, *others[apart]]
    shares = _weights(alignment.costs[every], covariance_of(model, alignment.hessians[every], settings), settings)[1:]
    return np.asarray((off[apart] * shares[:, None]).T @ off[apart])


def distinct_modes(model: ObjectModel, alignment: Alignment, settings: ModeSettings | None = None) -> tuple[Mode, ...]:
    """Modes of an alignment's poses, highest posterior density (lowest cost) first; empty only for no poses.

    The first is the maximum a posteriori: Laplace weights of minima inside one rough basin are too unsure to lead.
    """
    settings = settings or ModeSettings()
    finite = np.isfinite(alignment.costs)
    order = np.argsort(np.where(finite, alignment.costs, np.inf), kind="stable")[: int(finite.sum())]
    if len(order) == 0:
        return ()
    best = alignment.costs[order[0]]
    order = order[alignment.costs[order] <= best + settings.cost_margin]
    kept: list[int] = []
    merged: list[tuple[NDArray[np.intp], Array]] = []
    hessians = np.ascontiguousarray(alignment.hessians, dtype=np.float64)
    pending = order[:400]
    while len(pending) and len(kept) < settings.most:
        lead = pending[0]
        kept.append(int(lead))
        rest = pending[1:]
        if not len(rest):
            merged.append((rest, np.zeros((0, 6))))
            break
        equivalents = model.symmetries.nearest(alignment.poses[rest], alignment.poses[lead])
        delta = se3.difference(equivalents, alignment.poses[lead], model.centroid)
        same = np.zeros(len(rest), dtype=bool)
        apart = settings.merge_share * model.radius
        are_one(delta, hessians[lead], hessians[rest], model.radius, apart, float(settings.merge_sigmas), same)
        merged.append((rest[same], delta[same]))
        pending = rest[~same]
    covariances = covariance_of(model, alignment.hessians[kept], settings)
    weights = _weights(alignment.costs[kept], covariances, settings)
    if settings.scatter > 0.0:
        for k, (lead, (others, off)) in enumerate(zip(kept, merged)):
            covariances[k] += settings.scatter * _scatter(model, alignment, lead, others, off, settings)
    return tuple(
        Mode(alignment.poses[i], float(w), float(alignment.costs[i]), c) for i, w, c in zip(kept, weights, covariances)
    )
