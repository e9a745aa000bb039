"""Monte-Carlo search over object poses, as published (T1 chapter 4, eqs. 4.1-4.13).

Particles are guesses with a cost. Each new one copies an older one, drawn by weight from *all* that ever were, and
moves it by noise that shrinks over the run. The search stops early when it is confident. From the last hundredth of the
particles the distinct poses are kept, those that put the object into the hand are dropped, and Levenberg-Marquardt
finishes the rest.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from scenes.evidence.align import Prior
from scenes.evidence.table import GATE_ABOVE, OFFSET, POINT, SIGMA, Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from scenes.threads import run_chunks
from touch.answers import Localization
from touch.multistart import refine_contacts
from touch.published.answers import conclude
from touch.published.optimisers.costs import pose_of, surface_cost

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MonteCarloSettings:
    """One use of the search; see `correction` and `everywhere`. The thesis names p_p, p_n, sigma_0 without values.
    Values by judgement.
    """

    # n_p: particles of a run, the initial ones included, and how many those are.
    particles: int = 15_000
    initial: int = 1000
    # Independent runs, spread over the threads; their last particles are judged together.
    runs: int = 1
    # ss_r: of quaternion components; ss_t: metres. Sigmas (correction) or half widths (global) of the search space.
    space_rotation: float = 0.13
    space_translation: float = 0.025
    # True: the whole space of rotations, the prior's place does not matter.
    everywhere: bool = False
    # p_p of eq. 4.9: how much the best are preferred. Costs are metres: a cost 1 cm higher halves the weight at 140.
    preference: float = 500.0
    # sigma_0 (share of the search space) and p_n of eq. 4.12.
    noise: float = 0.7
    decay: float = 2.0
    # w_n of eq. 4.1, metres: 0.9 mm weighs as much as 5 degrees at 0.1 (both have a mean of about 0.7 mm).
    normal_weight: float = 0.1
    # Confidence (eq. 4.13, 0 to 100) that ends a run, looked at every so many particles.
    confidence: float = 99.5
    look_every: int = 1000
    # Poses are distinct when quaternions or positions (m) differ by this much.
    distinct_quaternion: float = 0.13
    distinct_position: float = 0.010
    # As many distinct poses as are finished.
    most: int = 60
    # The hand may reach this deep (m) into the object before a pose is discarded, beyond 2 of its rows' sigmas.
    collision: float = 0.002

    @staticmethod
    def correction() -> MonteCarloSettings:
        """Around an estimate: angles below 45 degrees, 5 cm, aggressive (T1 section 4.3.1.1)."""
        return MonteCarloSettings()

    @staticmethod
    def global_search() -> MonteCarloSettings:
        """Nothing known: all rotations, positions around the contacts, a patient search (T1 section 4.3.1.2)."""
        return MonteCarloSettings(
            particles=120_000,
            initial=30_000,
            runs=2,
            space_rotation=0.5,
            space_translation=0.08,
            everywhere=True,
            preference=300.0,
            noise=0.5,
            decay=3.0,
        )


@numba.njit(cache=True, nogil=True)
def _gaussian_pair(rng: np.random.Generator, out: Array) -> None:
    """Two normal numbers by the polar Box-Muller transform (eqs. 4.2, 4.3)."""
    while True:
        a = 2.0 * rng.random() - 1.0
        b = 2.0 * rng.random() - 1.0
        s = a * a + b * b
        if 0.0 < s < 1.0:
            factor = math.sqrt(-2.0 * math.log(s) / s)
            out[0] = a * factor
            out[1] = b * factor
            return


@numba.njit(cache=True, nogil=True)
def _gaussians(rng: np.random.Generator, pair: Array, out: Array) -> None:
    for i in range(0, out.shape[0] - 1, 2):
        _gaussian_pair(rng, pair)
        out[i] = pair[0]
        out[i + 1] = pair[1]
    if out.shape[0] % 2:
        _gaussian_pair(rng, pair)
        out[-1] = pair[0]


@numba.njit(cache=True, nogil=True)
def _uniform_quaternion(rng: np.random.Generator, out: Array) -> None:
    """Marsaglia's point on the hypersphere (eqs. 4.6-4.8; R = sqrt((1 - s1) / s2))."""
    s1 = 2.0
    while s1 >= 1.0:
        out[0] = 2.0 * rng.random() - 1.0
        out[1] = 2.0 * rng.random() - 1.0
        s1 = out[0] * out[0] + out[1] * out[1]
    s2 = 2.0
    while s2 >= 1.0 or s2 == 0.0:
        out[2] = 2.0 * rng.random() - 1.0
        out[3] = 2.0 * rng.random() - 1.0
        s2 = out[2] * out[2] + out[3] * out[3]
    ratio = math.sqrt((1.0 - s1) / s2)
    out[2] *= ratio
    out[3] *= ratio


@numba.njit(cache=True, nogil=True)
def _straight_quaternion(rng: np.random.Generator, out: Array) -> None:
    """At most two elements are one, the others zero: turns of 0, 90 and 180 degrees."""
    out[:] = 0.0
    out[int(4 * rng.random())] = 1.0
    out[int(4 * rng.random())] = 1.0
    length = math.sqrt((out * out).sum())
    out /= length


@numba.njit(cache=True, nogil=True)
def _draw_from_end(weights: Array, count: int, wanted: float) -> int:
    """Roulette wheel, added up from the end of the array where the heavy particles are (T1 section 4.2.4)."""
    total = 0.0
    for d in range(count - 1, -1, -1):
        total += weights[d]
        if total > wanted:
            return d
    return 0


@numba.njit(cache=True, nogil=True)
def evolve(
    values: NDArray[np.float32],
    origin: Array,
    spacing: float,
    pivot: Array,
    contacts: Array,
    normals: Array,
    normal_weight: float,
    rng: np.random.Generator,
    initial: int,
    everywhere: bool,
    space_rotation: float,
    space_translation: float,
    preference: float,
    noise: float,
    decay: float,
    confidence: float,
    look_every: int,
    quaternions: Array,
    translations: Array,
    costs: Array,
) -> int:
    """One run: fills quaternions (n, 4), translations (n, 3) and costs (n,); returns how many were made.

    contacts (k, 3) relative to their pivot and normals (k, 3) as in `surface_cost`. rng: numpy Generator.
    """
    n = costs.shape[0]
    k = contacts.shape[0]
    weights = np.zeros(n)
    total, best = 0.0, math.inf
    pair, draws = np.zeros(2), np.zeros(7)
    for j in range(n):
        q, t = quaternions[j], translations[j]
        if j >= initial:
            parent = _draw_from_end(weights, j, rng.random() * total)
            sigma = noise * (1.0 - j / n) ** decay
            _gaussians(rng, pair, draws)
            for i in range(4):
                q[i] = quaternions[parent, i] + sigma * space_rotation * draws[i]
            for i in range(3):
                t[i] = translations[parent, i] + sigma * space_translation * draws[4 + i]
        elif everywhere:
            if j < 0.3 * initial:
                _straight_quaternion(rng, q)
            else:
                _uniform_quaternion(rng, q)
            for i in range(3):
                t[i] = space_translation * (2.0 * rng.random() - 1.0)
        else:
            _gaussians(rng, pair, draws)
            q[0] = 1.0 - draws[0] * space_rotation
            for i in range(3):
                q[1 + i] = draws[1 + i] * space_rotation
                t[i] = draws[4 + i] * space_translation
        length = math.sqrt((q * q).sum())
        q /= length
        cost = surface_cost(values, origin, spacing, pivot, contacts, normals, normal_weight, q, t)
        costs[j] = cost
        best = min(best, cost)
        weights[j] = (1.0 + 1.0 / (1.0 + cost)) ** preference
        total += weights[j]
        if (j + 1) % look_every == 0 and j >= initial:
            reached = 100.0 / (1.0 + 100.0 * best / (k * (1.0 + normal_weight)))
            if reached >= confidence:
                return j + 1
    return n


def search(
    model: ObjectModel,
    contacts: Contacts,
    seed: int = 0,
    start: Array | None = None,
    extra: Evidence | None = None,
    settings: MonteCarloSettings | None = None,
) -> tuple[Array, Array, int]:
    """Distinct poses (b, 4, 4) contacts_frame_from_object, costs (b,) (eq. 4.1, m), best first, and particles made.

    start (4, 4): the estimate to correct; None searches everywhere about the contacts' mean. extra: OUTSIDE rows (the
    hand) that a pose must not collide with; when all collide, the best stay.
    """
    if settings is None:
        settings = MonteCarloSettings.global_search() if start is None else MonteCarloSettings.correction()
    if start is None:
        start = se3.make_pose()
    local = contacts.moved(se3.inverse(start))
    contact_pivot = local.points.mean(axis=0) if settings.everywhere else model.centroid
    n = settings.particles
    quaternions, translations = np.zeros((settings.runs, n, 4)), np.zeros((settings.runs, n, 3))
    costs = np.full((settings.runs, n), np.inf)
    made = np.zeros(settings.runs, dtype=np.int64)
    generators = [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(settings.runs)]
    field = model.field
    points, normals = np.ascontiguousarray(local.points - contact_pivot), np.nan_to_num(local.normals)

    def work(part: slice) -> None:
        for run in range(settings.runs)[part]:
            made[run] = evolve(
                field.values,
                field.origin,
                field.spacing,
                model.centroid,
                points,
                normals,
                settings.normal_weight,
                generators[run],
                settings.initial,
                settings.everywhere,
                settings.space_rotation,
                settings.space_translation,
                settings.preference,
                settings.noise,
                settings.decay,
                settings.confidence,
                settings.look_every,
                quaternions[run],
                translations[run],
                costs[run],
            )

    run_chunks(work, settings.runs)
    pool_q, pool_t, pool_c = _pool(quaternions, translations, costs, made)
    chosen = _distinct(pool_q, pool_t, pool_c, settings)
    found = np.array([pose_of(pool_q[i], pool_t[i], model.centroid, contact_pivot, start) for i in chosen])
    keep = ~collides(model, found, extra, settings) if extra is not None else np.ones(len(found), dtype=bool)
    keep = keep if keep.any() else ~keep
    found = found[keep][: settings.most]
    return found, pool_c[chosen][keep][: settings.most], int(made.sum())


def _pool(quaternions: Array, translations: Array, costs: Array, made: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    """The best particle of every run and the last hundredth of it, cheapest first."""
    picks = []
    for run, count in enumerate(made):
        last = np.arange(count - max(1, count // 100), count)
        picks += [(run, i) for i in np.union1d(last, np.argmin(costs[run, :count]))]
    index = tuple(np.array(picks).T)
    order = np.argsort(costs[index], kind="stable")
    return quaternions[index][order], translations[index][order], costs[index][order]


def _distinct(quaternions: Array, translations: Array, costs: Array, settings: MonteCarloSettings) -> NDArray[np.intp]:
    """Greedy, cheapest first: |q1 - q2| (either sign) or |t1 - t2| above the thresholds (T1 section 4.2.7)."""
    kept: list[int] = []
    pending = np.arange(len(costs))
    while len(pending) and len(kept) < 4 * settings.most:
        lead = int(pending[0])
        kept.append(lead)
        apart = np.minimum(
            np.linalg.norm(quaternions[pending] - quaternions[lead], axis=1),
            np.linalg.norm(quaternions[pending] + quaternions[lead], axis=1),
        )
        moved = np.linalg.norm(translations[pending] - translations[lead], axis=1)
        pending = pending[(apart > settings.distinct_quaternion) | (moved > settings.distinct_position)]
    return np.array(kept, dtype=np.intp)


def collides(model: ObjectModel, candidates: Array, extra: Evidence, settings: MonteCarloSettings) -> NDArray[np.bool_]:
    """(b,) whether a pose puts any OUTSIDE row into the object (T1 figure 4.6, seen from the robot's points)."""
    rows = extra.rows[extra.rows[:, GATE_ABOVE] == 0.0]
    if not len(rows):
        return np.zeros(len(candidates), dtype=bool)
    local = se3.apply(se3.inverse(candidates), rows[:, POINT])
    distance = model.field.distance(local.reshape(-1, 3)).reshape(len(candidates), -1) - rows[:, OFFSET]
    hit: NDArray[np.bool_] = (distance < -(settings.collision + 2.0 * rows[:, SIGMA])).any(axis=1)
    return hit


def localize(
    model: ObjectModel, contacts: Contacts, seed: int, prior: Prior | None, extra: Evidence | None
) -> Localization:
    """The method behind `touch.localize(method="monte-carlo")`: correction about the prior's mean, else global."""
    model.field  # noqa: B018  (built before anything is timed)
    begin = time.perf_counter()
    found, _, _ = search(model, contacts, seed, None if prior is None else prior.pose, extra)
    polished = refine_contacts(model, contacts, found).poses
    if extra is not None:
        # polishing must not push the object into the hand
        bad = collides(model, polished, extra, MonteCarloSettings())
        polished = np.where(bad[:, None, None], found, polished)
    return conclude(model, contacts, polished, "monte-carlo", begin, None, extra)
