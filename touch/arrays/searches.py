"""Searches for the pose over any array cost: DIRECT, annealing, Monte-Carlo and multi-start (T1 table 5.2), and ours.

The published ones look for the minimum of a cost in a box of rotation vectors and displacements about the object's
centroid. Ours starts from rows of evidence in the compiled alignment and finishes on the likelihood of the pressures.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.evidence.align import Alignment, Prior, align
from scenes.evidence.modes import Mode, distinct_modes
from scenes.geometry import poses as se3
from touch.answers import LocalizeSettings, verdict_of
from touch.arrays import kernels
from touch.arrays.costs import COSTS, ArrayProblem
from touch.arrays.ranking import RankingSettings, pattern_costs, reweighted
from touch.arrays.rows import ArrayRowSettings, array_contacts, array_rows
from touch.multistart import find_candidates

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Box:
    """start (4, 4) frame_from_object in its middle; half widths (6,): rotation vector (rad), displacement of the
    centroid (m), frame axes.
    """

    start: Array
    half: Array

    @staticmethod
    def around(start: Array, angle: float, distance: float) -> Box:
        """The same half width on every axis of rotation (rad) and of displacement (m)."""
        return Box(start, np.array([angle] * 3 + [distance] * 3))


@dataclass(frozen=True)
class BoxMinimum:
    """pose (4, 4) of least cost among `evaluations`; seconds: wall time; cpu: of all threads (s)."""

    pose: Array
    cost: float
    evaluations: int
    seconds: float
    cpu: float


@dataclass(frozen=True)
class ArraySearchSettings:
    """Work of the published searches. Values by judgement, on generated grasps."""

    # Evaluations in a box around an estimate.
    evaluations: int = 4000
    # Monte-Carlo (T1 chapter 4, in generations so that they can be spread over threads): particles of a generation,
    # share drawn at random at first, preference of the best as T1's p_p (on costs above the best, in units of their
    # median), first noise (share of the box) and its decay.
    generation: int = 250
    initial: float = 0.3
    preference: float = 80.0
    noise: float = 0.4
    decay: float = 2.0
    # Multi-start: share of the evaluations that are starts, starts refined, and tries of each at one step size.
    starts: float = 0.3
    refined: int = 10
    tries: int = 12


def direct(problem: ArrayProblem, cost: str, box: Box, evaluations: int, seed: int = 0) -> BoxMinimum:
    """DIRECT (Jones 1993) by scipy; deterministic, the seed changes nothing."""
    from scipy.optimize import direct as minimise

    begin, cpu = time.perf_counter(), time.process_time()
    scalar = _scalar(problem, cost, box)
    bounds = [(-h, h) for h in box.half]
    found = minimise(scalar, bounds, maxfun=evaluations, maxiter=evaluations, vol_tol=0.0, locally_biased=True)
    return _found(problem, cost, box, found.x, int(found.nfev), begin, cpu)


def annealing(problem: ArrayProblem, cost: str, box: Box, evaluations: int, seed: int = 0) -> BoxMinimum:
    """Generalised simulated annealing (Xiang 1997) by scipy, without its local search."""
    from scipy.optimize import dual_annealing

    begin, cpu = time.perf_counter(), time.process_time()
    found = dual_annealing(
        _scalar(problem, cost, box),
        [(-h, h) for h in box.half],
        maxfun=evaluations,
        maxiter=evaluations,
        no_local_search=True,
        rng=np.random.default_rng(seed),
    )
    return _found(problem, cost, box, found.x, int(found.nfev), begin, cpu)


def monte_carlo(
    problem: ArrayProblem,
    cost: str,
    box: Box,
    evaluations: int,
    seed: int = 0,
    settings: ArraySearchSettings | None = None,
) -> BoxMinimum:
    """T1 chapter 4 in generations: each particle copies one of all that ever were, moved by noise that shrinks."""
    settings = settings or ArraySearchSettings()
    begin, cpu = time.perf_counter(), time.process_time()
    rng, evaluate = np.random.default_rng(seed), problem.cost(cost)
    x = np.zeros((evaluations, 6))
    costs = np.full(evaluations, np.inf)
    made = max(1, int(settings.initial * evaluations))
    x[:made] = box.half * rng.uniform(-1.0, 1.0, size=(made, 6))
    x[0] = 0.0
    costs[:made] = evaluate(_poses(problem, x[:made], box))
    while made < evaluations:
        count = min(settings.generation, evaluations - made)
        scale = max(float(np.median(costs[:made])), 1e-12)
        relative = (costs[:made] - costs[:made].min()) / scale
        weights = (1.0 + 1.0 / (1.0 + relative)) ** settings.preference
        parents = rng.choice(made, size=count, p=weights / weights.sum())
        sigma = settings.noise * (1.0 - made / evaluations) ** settings.decay
        moved = x[parents] + sigma * box.half * rng.normal(size=(count, 6))
        x[made : made + count] = np.clip(moved, -box.half, box.half)
        costs[made : made + count] = evaluate(_poses(problem, x[made : made + count], box))
        made += count
    return _found(problem, cost, box, x[int(np.argmin(costs))], evaluations, begin, cpu)


def multistart(
    problem: ArrayProblem,
    cost: str,
    box: Box,
    evaluations: int,
    seed: int = 0,
    settings: ArraySearchSettings | None = None,
) -> BoxMinimum:
    """Many starts, the best of them refined by random steps, longer after a success and shorter after none.

    A step rule for costs without gradients (Schumer and Steiglitz 1968, one fifth of the tries should succeed).
    """
    settings = settings or ArraySearchSettings()
    begin, cpu = time.perf_counter(), time.process_time()
    rng, evaluate = np.random.default_rng(seed), problem.cost(cost)
    count = max(settings.refined, int(settings.starts * evaluations))
    x = box.half * rng.uniform(-1.0, 1.0, size=(count, 6))
    x[0] = 0.0
    costs = evaluate(_poses(problem, x, box))
    order = np.argsort(costs, kind="stable")[: settings.refined]
    x, costs = x[order], costs[order]
    step = np.full(len(x), 0.25)
    rows = np.arange(len(x))
    for _ in range((evaluations - count) // (settings.tries * len(x))):
        noise = rng.normal(size=(len(x), settings.tries, 6))
        tried = np.clip(x[:, None] + step[:, None, None] * box.half * noise, -box.half, box.half)
        found = evaluate(_poses(problem, tried.reshape(-1, 6), box)).reshape(len(x), -1)
        best = np.argmin(found, axis=1)
        better = found[rows, best] < costs
        share = (found < costs[:, None]).mean(axis=1)
        x[better], costs[better] = tried[rows, best][better], found[rows, best][better]
        step = np.clip(step * np.where(share > 0.2, 1.4, 0.75), 1e-4, 0.5)
    return _found(problem, cost, box, x[int(np.argmin(costs))], evaluations, begin, cpu)


SEARCHES = {"direct": direct, "annealing": annealing, "monte-carlo": monte_carlo, "multistart": multistart}


def minimise(
    problem: ArrayProblem,
    box: Box,
    cost: str = "covariance",
    search: str = "direct",
    evaluations: int | None = None,
    seed: int = 0,
) -> BoxMinimum:
    """The least of a cost ("covariance", "distance" or "forward") in a box by a search of SEARCHES.

    Raises InputError for another name.
    """
    if cost not in COSTS or search not in SEARCHES:
        raise InputError(f"arrays: expected a cost of {', '.join(COSTS)} and a search of {', '.join(SEARCHES)},"
                         f" got {cost!r} and {search!r}")  # fmt: skip
    evaluations = evaluations or ArraySearchSettings().evaluations
    return SEARCHES[search](problem, cost, box, evaluations, seed)


@dataclass(frozen=True)
class PressureSettings:
    """The default search over arrays. Values by judgement, on generated grasps."""

    localize: LocalizeSettings = field(default_factory=LocalizeSettings)
    rows: ArrayRowSettings = field(default_factory=ArrayRowSettings)
    # Candidates of the alignment that are finished on the pressures, and steps of that.
    finished: int = 24
    steps: int = 15
    # How the minima are then told apart: the pressures are in their costs already.
    ranking: RankingSettings = field(default_factory=lambda: RankingSettings(pressures=False))


@dataclass(frozen=True)
class ArrayLocalization:
    """modes (best first) with their weights, of which the first is the answer; verdict; seconds wall, cpu seconds."""

    modes: tuple[Mode, ...]
    verdict: str
    seconds: float
    cpu: float

    @property
    def pose(self) -> Array:
        """(4, 4) frame_from_object of the first mode."""
        return self.modes[0].pose

    @property
    def cost(self) -> float:
        """Negative log posterior density there, up to a constant: pressures, prior, and the patterns' covariances."""
        return self.modes[0].cost


def localize_arrays(
    problem: ArrayProblem, seed: int = 0, prior: Prior | None = None, settings: PressureSettings | None = None
) -> ArrayLocalization:
    """Where the object is, from arrays alone: rows of evidence find the minima, pressures rank and finish them, and the
    covariances of the patterns have a say in which is the first.

    prior: a Gaussian on the pose; None searches everywhere. Raises InputError when no array feels anything.
    """
    settings = settings or PressureSettings()
    if not problem.touching:
        raise InputError("arrays: expected at least one array that feels something, got none")
    begin, cpu = time.perf_counter(), time.process_time()
    model = problem.model
    contacts = array_contacts(problem.readings, settings.rows)
    rows = array_rows(problem.readings, settings.rows)
    rng = np.random.default_rng(seed)
    candidates = find_candidates(model, contacts, rows, rng, prior, settings.localize)
    aligned = align(model, rows, candidates.poses, prior)
    order = np.argsort(
        problem.forward(aligned.poses) + _prior_cost(model.centroid, aligned.poses, prior), kind="stable"
    )
    best = aligned.poses[order[: settings.finished]]
    finished = finish(problem, best, prior, settings.steps)
    modes = distinct_modes(model, finished)
    shapes = pattern_costs(model, problem.readings, np.array([mode.pose for mode in modes]), settings.ranking)
    modes = reweighted(modes, shapes)
    return ArrayLocalization(modes, verdict_of(modes, model), time.perf_counter() - begin, time.process_time() - cpu)


def finish(problem: ArrayProblem, starts: Array, prior: Prior | None = None, steps: int = 15) -> Alignment:
    """Levenberg-Marquardt of poses (b, 4, 4) on the likelihood of the pressures; a pose's cost never rises."""
    model = problem.model
    poses = np.array(starts)
    cost, gradient, hessian = _with_prior(problem, poses, prior)
    damping = np.full(len(poses), 1e-3)
    scale = np.array([1.0] * 3 + [model.radius] * 3) ** -2.0
    for _ in range(steps):
        diagonal = np.einsum("mii->mi", hessian)
        damped = hessian + np.eye(6) * (damping[:, None] * diagonal + scale)[:, None]
        step = -np.linalg.solve(damped, gradient[..., None])[..., 0]
        length = np.linalg.norm(step[:, 3:], axis=1) + model.radius * np.linalg.norm(step[:, :3], axis=1)
        step *= np.minimum(1.0, 0.1 * model.radius / np.maximum(length, 1e-300))[:, None]
        tried = se3.perturb(poses, step, model.centroid)
        trial = _with_prior(problem, tried, prior)
        better = trial[0] <= cost
        poses = np.where(better[:, None, None], tried, poses)
        cost = np.where(better, trial[0], cost)
        gradient = np.where(better[:, None], trial[1], gradient)
        hessian = np.where(better[:, None, None], trial[2], hessian)
        damping = np.where(better, np.maximum(damping * 0.2, 1e-9), np.minimum(damping * 8.0, 1e8))
    poses[:, :3, :3] = se3.nearest_rotation(poses[:, :3, :3])
    return Alignment(poses, cost, hessian, np.full(len(poses), steps))


def _with_prior(problem: ArrayProblem, poses: Array, prior: Prior | None) -> tuple[Array, Array, Array]:
    cost, gradient, hessian = problem.forward_terms(poses)
    if prior is not None:
        delta = se3.difference(poses, prior.pose, problem.model.centroid)
        cost = cost + 0.5 * np.einsum("ni,ij,nj->n", delta, prior.information, delta)
        gradient = gradient + delta @ prior.information
        hessian = hessian + prior.information
    return cost, gradient, hessian


def _prior_cost(centroid: Array, poses: Array, prior: Prior | None) -> Array:
    if prior is None:
        return np.zeros(len(poses))
    delta = se3.difference(poses, prior.pose, centroid)
    return 0.5 * np.einsum("ni,ij,nj->n", delta, prior.information, delta)


def _poses(problem: ArrayProblem, x: Array, box: Box) -> Array:
    return se3.perturb(box.start, x, problem.model.centroid)


def _scalar(problem: ArrayProblem, cost: str, box: Box) -> Callable[[Array], float]:
    one = problem.scalar(cost)
    centroid = problem.model.centroid
    start = np.ascontiguousarray(box.start[:3, :3])
    middle = start @ centroid + box.start[:3, 3]
    rotations, translations = np.zeros((1, 3, 3)), np.zeros((1, 3))

    def value(x: Array) -> float:
        kernels.place(x, start, middle, centroid, rotations, translations)
        return one(rotations, translations)

    return value


def _found(problem: ArrayProblem, cost: str, box: Box, x: Array, count: int, begin: float, cpu: float) -> BoxMinimum:
    pose = _poses(problem, np.asarray(x)[None], box)
    value = float(problem.cost(cost)(pose)[0])
    return BoxMinimum(pose[0], value, count, time.perf_counter() - begin, time.process_time() - cpu)
