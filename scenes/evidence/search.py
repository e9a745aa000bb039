"""Coarse to fine over many starts: few rows and much blur for many candidates, all rows and none for few."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.evidence.align import Alignment, AlignSettings, Prior, align, costs
from scenes.evidence.leader_kernels import lead
from scenes.evidence.row_kernels import thin_rows
from scenes.evidence.table import TOUCH, Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]

# Odd numbers by whose multiples, modulo 2^64, rows of small integers spread over all of them (multiplicative hashing:
# Knuth, The Art of Computer Programming 3, section 6.4): powers of 2^64 over the golden ratio.
_SPREAD = np.array([pow(0x9E3779B97F4A7C15, k, 2**64) for k in range(1, 10)], dtype=np.uint64).view(np.int64)

# A step shorter than this share of a pass's blur may end a pose's work in that pass: where all that is found is refined
# afterwards.
SETTLED = 0.01


@dataclass(frozen=True)
class SearchStage:
    """One pass of the search."""

    # Blur of this pass: metres and radians (see AlignSettings).
    blur: float
    blur_normal: float
    # Rows looked at (see `thin`).
    rows: int
    # Steps per pose (0: only ranked where they are), and poses that go on to the next pass.
    iterations: int
    keep: int


def thin(evidence: Evidence, count: int) -> Evidence:
    """Every contact, and of the vision rows and of touch's OUTSIDE rows about `count` each, carrying the weight of all.

    Rows are taken evenly over the table; contacts are few and each tells another thing.
    """
    rows, senses = np.zeros_like(evidence.rows), np.zeros_like(evidence.sense)
    kept = thin_rows(np.ascontiguousarray(evidence.rows), evidence.sense, TOUCH, (count, count // 2), rows, senses)
    return evidence if kept == len(evidence) else Evidence(rows[:kept], senses[:kept])


def rotation_grid(count: int, rng: np.random.Generator | None = None) -> Array:
    """(count, 3, 3) rotations even over SO(3): super-Fibonacci spirals (Alexa, CVPR 2022), all turned at random."""
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    t = s / count
    d = 2 * np.pi * s
    r, q = np.sqrt(t), np.sqrt(1 - t)
    alpha, beta = d / phi, d / psi
    quaternions = np.stack([q * np.cos(beta), r * np.sin(alpha), r * np.cos(alpha), q * np.sin(beta)], axis=1)
    rotations = se3.from_quaternion(quaternions)
    if rng is not None:
        rotations = se3.random_rotations(1, rng)[0] @ rotations
    return rotations


def starts_around(
    model: ObjectModel, pose: Array, sigma_angle: float, sigma_distance: float, count: int, rng: np.random.Generator
) -> Array:
    """(count, 4, 4) draws from a Gaussian on the pose (rad and m per axis), the mean itself first."""
    delta = rng.normal(size=(count, 6)) * ([sigma_angle] * 3 + [sigma_distance] * 3)
    delta[:1] = 0.0
    return se3.perturb(pose, delta, model.centroid)


def starts_of_prior(
    model: ObjectModel, prior: Prior, count: int, widest_angle: float, widest_distance: float, rng: np.random.Generator
) -> Array:
    """(count, 4, 4) draws from a prior, its mean first, with all its correlations.

    Directions in which it is wider than widest_angle (rad) and widest_distance (m) are drawn as if they were so wide.
    """
    widest = np.repeat([widest_angle, widest_distance], 3)
    # in units of the widest, so that an information of nothing is no division by zero
    values, vectors = np.linalg.eigh(prior.information * widest * widest[:, None])
    covariance = (vectors / np.maximum(values, 1.0)) @ vectors.T * widest * widest[:, None]
    scale = np.sqrt(np.diag(covariance))
    factor = scale[:, None] * np.linalg.cholesky(covariance / scale / scale[:, None] + 1e-12 * np.eye(6))
    delta = rng.normal(size=(count, 6)) @ factor.T
    delta[:1] = 0.0
    return se3.perturb(prior.pose, delta, model.centroid)


def search(
    model: ObjectModel,
    evidence: Evidence,
    starts: Array,
    stages: tuple[SearchStage, ...],
    prior: Prior | None = None,
    settings: AlignSettings | None = None,
    rank: Callable[[Array, float], Array] | None = None,
    apart: float = 0.0,
    settled: float = 0.0,
) -> Alignment:
    """Run the stages; returns the last stage's survivors, best first, with their final costs and Hessians.

    rank(poses, blur) -> (n,) is added to the costs when survivors are chosen (not when poses move). apart: of poses
    that are nearer than this (m, see `leaders`) the best goes on; 0 tells only those apart that reached one minimum.
    settled: see SETTLED; 0 for none.
    """
    settings = settings or AlignSettings()
    poses = starts
    result = None
    for stage in stages:
        rows = thin(evidence, stage.rows)
        how = replace(
            settings,
            blur=stage.blur,
            blur_normal=stage.blur_normal,
            iterations=stage.iterations,
            tolerance_angle=max(settings.tolerance_angle, settled * stage.blur / model.radius),
            tolerance_distance=max(settings.tolerance_distance, settled * stage.blur),
        )
        if stage.iterations:
            result = align(model, rows, poses, prior, how)
            ranked = result.costs if rank is None else result.costs + rank(result.poses, stage.blur)
            result = result.take(distinct_first(model, replace(result, costs=ranked), stage.keep))
        else:
            known = np.zeros(len(poses)) if rank is None else rank(poses, stage.blur)
            fit, differ = partial(costs, model, rows, prior=prior, settings=how), partial(_distinct, model)
            best, at = best_that_differ(poses, known, fit, differ, stage.keep)
            result = Alignment(poses[best], at, np.zeros((len(best), 6, 6)), np.zeros(len(best), dtype=np.int64))
        if apart > 0.0:
            result = result.take(leaders(model, result.poses, apart)[0])
        poses = result.poses
    if result is None:
        raise InputError("search: expected at least one stage, got none")
    return result


def best_that_differ(
    poses: Array,
    known: Array,
    costly: Callable[[Array], Array],
    differ: Callable[[Array, Array], NDArray[np.intp]],
    keep: int,
) -> tuple[NDArray[np.intp], Array]:
    """The first `keep` of the indices differ(poses, known + costly(poses)), the best first, and what is costly of them.

    That is nowhere below 0, so that poses (n, 4, 4) of which known (n,) is more than the last of the best costs are not
    asked about.
    """
    found, is_asked = np.zeros(len(poses)), np.zeros(len(poses), dtype=bool)
    fresh = np.argsort(known, kind="stable")[: keep + keep // 2] if known.any() else np.arange(len(poses))
    while True:
        found[fresh] = costly(poses[fresh])
        is_asked[fresh] = True
        asked = np.flatnonzero(is_asked)
        best = asked[differ(poses[asked], found[asked] + known[asked])[:keep]]
        last = found[best[-1]] + known[best[-1]] if len(best) == keep else np.inf
        # rounding may have a loss a little below 0
        fresh = np.flatnonzero(~is_asked & (known <= last + 1e-6))
        if not len(fresh):
            return best, found[best]


def distinct_first(model: ObjectModel, result: Alignment, keep: int) -> NDArray[np.intp]:
    """Indices of the best `keep` poses, those that fell onto the same minimum counted once: starts that reached one
    agree far better than to a thousandth of the radius and a hundredth in rotation, and different minima almost never
    do.
    """
    return _distinct(model, result.poses, result.costs)[:keep]


def _distinct(model: ObjectModel, poses: Array, at: Array) -> NDArray[np.intp]:
    """`distinct_first` of poses (n, 4, 4) that cost so much, at (n,)."""
    return first_of_cells(model, poses, np.argsort(at, kind="stable"), 1e-3, 1e-2)


def first_of_cells(
    model: ObjectModel, poses: Array, order: NDArray[np.intp], width: float, angle: float
) -> NDArray[np.intp]:
    """Of the indices `order` (k,) of poses (n, 4, 4) the first in each cell of the pose space: of width (a share of the
    radius) for the centroid, and angle (rad, about) for the rotation; equivalents of a symmetric object are in one. Of
    all that turn a bottle about itself one goes on, and leaves the other places to other answers.
    """
    if not len(order):
        return order
    axes = model.symmetries.axes
    same = model.symmetries.nearest(poses[order], poses[order[0]])
    middles = same[:, :3, :3] @ model.centroid + same[:, :3, 3]
    # of an object that turns freely the axis alone says how it stands: of one that is turned over no turn is nearest
    turned = same[:, :3, :3] @ axes[0].direction if axes else same[:, :3, :2].reshape(len(same), 6)
    # cells count from the first place: those of an object far from the origin are as those of one at it
    parts = (middles - middles[0]) / (width * model.radius), turned / angle
    return order[first_of_each(np.round(np.concatenate(parts, axis=1)).astype(np.int64))]


def least_of(values: Array, count: int) -> NDArray[np.intp]:
    """Indices of the `count` least of values (n,), the least first and of equals the first: what a stable sort has
    first, without sorting the rest. What is no number is last.
    """
    if not 0 < count < len(values):
        return np.argsort(values, kind="stable")[: max(count, 0)]
    bound = np.partition(values, count - 1)[count - 1]
    near = np.flatnonzero(~(values > bound))
    return near[np.argsort(values[near], kind="stable")[:count]]


def first_of_each(keys: NDArray[np.int64]) -> NDArray[np.intp]:
    """Where in keys (n, k), k at most 9, each different row is for the first time, in order.

    One number for a row: two rows share it once in 2^64, and one number sorts ten times as fast as a row.
    """
    _, first = np.unique(keys @ _SPREAD[: keys.shape[1]], return_index=True)
    return np.sort(first)


def leaders(model: ObjectModel, poses: Array, apart: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Poses (n, 4, 4) that stand for those near them, modulo symmetry: their indices (k,), and of each pose the one in
    0..k-1 that stands for it.

    apart: metres by which a point at the object's radius moves at least between two that stand for others. Of poses
    nearer than that the first leads: give the best first.
    """
    symmetries, count = model.symmetries, len(poses)
    turns = 2 if symmetries.is_spherical else min(len(symmetries.axes), 1)
    axis = np.ascontiguousarray(symmetries.axes[0].direction, np.float64) if turns else np.zeros(3)
    rotations = np.ascontiguousarray(poses[:, :3, :3])
    middles = rotations @ model.centroid + poses[:, :3, 3]
    chosen, group = np.zeros((2, count), dtype=np.int64)
    discrete = np.ascontiguousarray(symmetries.discrete[:, :3, :3])
    leading = lead(rotations, middles, discrete, axis, turns, model.radius, float(apart), chosen, group)
    return chosen[:leading], group
