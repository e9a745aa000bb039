"""Which of several known objects was touched (T1 section 6.2.1, T2 chapter 5).

Every candidate is searched for in batches; those that fit far worse than the best are given up early. Two likelihoods
are told: the published one, 1/G normalised, and the marginal likelihood over the pose (Laplace, all modes) and over the
unknown scale of the noise, in which contacts that err alike count once. What the best candidate leaves over is judged,
too: a smooth misfit speaks for none of them (touch.misfit), and only a decisive lack of it lets an answer be `ok`.
Contacts' frame, metres.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.evidence import table as tables
from scenes.evidence.align import Alignment, AlignSettings, align, costs, terms
from scenes.evidence.modes import covariance_of, distinct_modes
from scenes.evidence.search import SearchStage, distinct_first, search
from scenes.evidence.table import Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from touch.misfit import MisfitSettings, log_odds_of_another
from touch.multistart import contact_starts

Array = NDArray[np.float64]

# Sigmas that no residual has: all rows count in full.
NO_LIMIT = 1e9


@dataclass(frozen=True)
class RecognitionSettings:
    """The search of every candidate, and what its fit is worth. Values by judgement."""

    # Starts of every candidate, and again of those still in play.
    starts: int = 1000
    more_starts: int = 1000
    # Contacts looked at by the first passes, also of those still in play, and by the last ones, evenly chosen.
    few_contacts: int = 36
    more_contacts: int = 60
    most_contacts: int = 150
    # Poses kept after the passes, and of those still in play: where a fifth of few contacts is false the right pose may
    # be far down after the first, and twice as many starts do not help it (tried: 4 times as many, same answer).
    keep: tuple[int, int] = (250, 50)
    more_keep: tuple[int, int] = (500, 150)
    # A candidate whose index is this many times the best's, and this much (m) above it, is given up.
    hopeless_ratio: float = 2.5
    hopeless_above: float = 1.5e-3
    # Noise of a contact, metres: no mesh is truer than the first, no finger worse than the second. The scale between
    # them is integrated over with equal weight per factor.
    least_noise: float = 0.5e-3
    largest_noise: float = 0.015
    # Shares of false contacts that are thought possible, and how far off the surface one lies at most (m).
    false_shares: tuple[float, ...] = (0.02, 0.1, 0.2, 0.35, 0.5)
    false_reach: float = 0.1
    # Share of contacts far off the best object from which on no answer is sure.
    most_elsewhere: float = 0.35
    # Residuals beyond this many sigmas (or blurs) count linearly while poses are refined: false contacts pull little.
    huber: float = 0.5
    # Poses of a candidate that are judged by the full likelihood.
    judged: int = 12
    # Contacts that any shape can meet, one for each freedom of a pose; and the share of few contacts that still counts.
    freedoms: float = 6.0
    least_share: float = 0.25
    # Contacts count at most for this many independent ones: errors of the mesh and of the calibration are shared.
    most_independent: float = 25.0
    # Share of the likelihood at which the answer is sure.
    sure: float = 0.99
    # Share of touched things that are none of the candidates, before anything is felt.
    strangers: float = 0.005
    # Nats by which what the best leaves over must speak for it and against all that is plainly another object,
    # candidate or not: a thousand to one. A hundred is decisive (Jeffreys 1961) between two that both are what they are
    # said to be; a relative is nearer than a Gaussian field has it, and of 108 draws in which one was named for want of
    # the tool itself, two reached 6.0. Fewer independent contacts than these cannot tell: twice what a pose can fit.
    decisive: float = 6.9
    least_independent: float = 12.0
    misfit: MisfitSettings = field(default_factory=MisfitSettings)


@dataclass(frozen=True)
class Candidate:
    """One object: index, mean |distance| of all contacts at its best pose (m); likelihood, share of the marginal
    likelihood; inverse_cost, share of 1/G (T1 section 6.2.1); pose (4, 4) contacts_frame_from_object; given_up: the
    search ended early because nothing near the best was in sight.
    """

    name: str
    index: float
    likelihood: float
    inverse_cost: float
    pose: Array
    given_up: bool


@dataclass(frozen=True)
class Identification:
    """candidates, the likeliest first; best, its name; none: likelihood that it is none of them, with theirs 1 in all.

    verdict: ok, ambiguous, or lost when nothing fits to within any noise; margin: log of the best's likelihood over the
    next one's; sigma, inferred noise of a contact (m); independent: how many contacts count.
    """

    best: str
    verdict: str
    candidates: tuple[Candidate, ...]
    none: float
    margin: float
    sigma: float
    independent: float
    time_s: float


def identify(
    models: Sequence[ObjectModel],
    contacts: Contacts,
    seed: int = 0,
    extra: Evidence | None = None,
    settings: RecognitionSettings | None = None,
) -> Identification:
    """Tell which of the models (their names must differ) the contacts lie on.

    contacts in any frame, metres; normals are used where known. extra: more rows of evidence in the same frame, such as
    regions felt to be empty. Raises InputError for no contacts, no model, or a name that comes twice.
    """
    settings = settings or RecognitionSettings()
    names = [model.name for model in models]
    if not names or len(set(names)) < len(names):
        raise InputError(f"identify: expected models of different names, got {', '.join(names) or 'none'}")
    if len(contacts) == 0:
        raise InputError("identify: expected at least one contact, got none")
    for model in models:
        model.field, model.surface  # noqa: B018  (built before anything is timed)
    begin = time.perf_counter()
    rng = np.random.default_rng(seed)
    few, more, many = (
        _evenly(contacts, most) for most in (settings.few_contacts, settings.more_contacts, settings.most_contacts)
    )
    first, again = (settings.starts, settings.keep), (settings.more_starts, settings.more_keep)
    streams = rng.spawn(len(models))
    found = [_look(model, few, many, extra, first, settings, s) for model, s in zip(models, streams)]
    index = np.array([_index(model, contacts, one.poses[0]) for model, one in zip(models, found)])
    limit = max(settings.hopeless_ratio * index.min(), index.min() + settings.hopeless_above)
    given_up = index > limit
    for k in map(int, np.flatnonzero(~given_up)):
        found[k] = _merged(found[k], _look(models[k], more, many, extra, again, settings, streams[k]))
    sigma, aligned, volumes = _finished(models, many, extra, found, given_up, settings)
    near = int(np.argmin([_index(model, contacts, one.poses[0]) for model, one in zip(models, aligned)]))
    independent = _independent(models[near], contacts, aligned[near].poses[0], settings)
    judged = [_judged(m, contacts, extra, one, sigma, independent, settings) for m, one in zip(models, aligned)]
    fits, poses = np.array([fit for fit, _ in judged]), [pose for _, pose in judged]
    index = np.array([_index(model, contacts, pose) for model, pose in zip(models, poses)])
    fit_share, likelihood = _shares(fits), _shares(fits + volumes)
    inverse = 1.0 / np.maximum(index, 1e-9)
    order = np.argsort(-likelihood, kind="stable")
    best = int(order[0])
    another, plainly = _another(models[best], contacts, poses[best], settings)
    prior = np.log(settings.strangers) - np.log1p(-settings.strangers)
    none = float(0.5 * (1.0 + np.tanh(0.5 * (another + prior))))
    likelihood = likelihood * (1.0 - none)
    # the width of a mode alone never decides: it knows only how many poses would do, not which object it is
    sure = min(fit_share[best], likelihood[best]) >= settings.sure
    # when nearly half of the contacts are elsewhere, they may as well be the true ones
    sure = sure and independent >= settings.least_independent and plainly <= -settings.decisive
    sure = sure and _elsewhere(models[best], contacts, poses[best], settings) <= settings.most_elsewhere
    verdict = "ok" if sure else "ambiguous"
    if index.min() > settings.largest_noise:
        verdict = "lost"
    logs = np.sort(fits + volumes)[::-1]
    candidates = tuple(
        Candidate(
            names[k],
            float(index[k]),
            float(likelihood[k]),
            float(inverse[k] / inverse.sum()),
            poses[k],
            bool(given_up[k]),
        )
        for k in order
    )
    margin = float(logs[0] - logs[1]) if len(logs) > 1 else np.inf
    return Identification(
        names[best], verdict, candidates, none, margin, sigma, independent, time.perf_counter() - begin
    )


def _evenly(contacts: Contacts, most: int) -> Contacts:
    if len(contacts) <= most:
        return contacts
    return contacts.take(np.linspace(0, len(contacts) - 1, most).astype(int))


def _index(model: ObjectModel, contacts: Contacts, pose: Array) -> float:
    """Mean |distance| (m), through the lattice: T2 eq. 5.1."""
    return float(np.abs(_residuals(model, contacts, pose)).mean())


def _residuals(model: ObjectModel, contacts: Contacts, pose: Array) -> Array:
    """Signed distances (n,) of the contacts, metres, through the lattice."""
    return model.field.distance(se3.apply(se3.inverse(pose), contacts.points))


def _rows(contacts: Contacts, extra: Evidence | None) -> Evidence:
    rows = tables.from_contacts(contacts)
    return rows if extra is None else tables.stack(rows, extra)


def _look(
    model: ObjectModel,
    few: Contacts,
    many: Contacts,
    extra: Evidence | None,
    asked: tuple[int, tuple[int, int]],
    settings: RecognitionSettings,
    rng: np.random.Generator,
) -> Alignment:
    """Search one candidate: two blurred passes over few contacts, one sharp pass over many. asked: how many starts, and
    poses kept after the passes.
    """
    starts, keep = asked
    wide = 0.25 * model.radius
    stages = (
        SearchStage(wide, 0.6, 10**9, 6, keep[0]),
        SearchStage(wide / 5, 0.2, 10**9, 10, keep[1]),
    )
    robust = AlignSettings(huber=settings.huber)
    found = search(model, _rows(few, extra), contact_starts(model, few, starts, rng), stages, settings=robust)
    sharp = AlignSettings(blur=0.01 * model.radius, blur_normal=0.05, huber=settings.huber, iterations=12)
    result = align(model, _rows(many, extra), found.poses, settings=sharp)
    return result.take(np.argsort(result.costs, kind="stable"))


def _merged(a: Alignment, b: Alignment) -> Alignment:
    both = Alignment(
        *(np.concatenate([getattr(a, f), getattr(b, f)]) for f in ("poses", "costs", "hessians", "iterations"))
    )
    return both.take(np.argsort(both.costs, kind="stable"))


def _finished(
    models: Sequence[ObjectModel],
    many: Contacts,
    extra: Evidence | None,
    found: list[Alignment],
    given_up: NDArray[np.bool_],
    settings: RecognitionSettings,
) -> tuple[float, list[Alignment], Array]:
    """Noise (m) that the best candidate speaks of; every candidate's poses under it, the best first; log volume of its
    modes.
    """
    n = len(many)
    sigma = float(np.sqrt(np.mean(many.sigma_point**2)))
    if not many.sigma_known and n > 6:
        # the median forgives false contacts; 1.48 of it is the sigma of a Gaussian
        medians = [float(np.median(np.abs(_residuals(m, many, one.poses[0])))) for m, one in zip(models, found)]
        sigma = float(np.clip(1.48 * min(medians) * n / (n - 6), settings.least_noise, settings.largest_noise))
    # all together count no more than their independent part, or modes would look sharper than they are
    rows = tables.from_contacts(many).with_sigma(sigma, tables.TOUCH)
    rows = rows.reweighted(min(1.0, settings.most_independent / n))
    if extra is not None:
        rows = tables.stack(rows, extra)
    aligned, volumes = [], np.zeros(len(models))
    plain = AlignSettings(huber=NO_LIMIT)
    for k, (model, one) in enumerate(zip(models, found)):
        start = one.take(np.arange(min(1 if given_up[k] else 40, len(one.costs))))
        steps = 5 if given_up[k] else 20
        result = align(model, rows, start.poses, settings=AlignSettings(huber=settings.huber, iterations=steps))
        result = result.take(distinct_first(model, result, settings.judged))
        modes = distinct_modes(model, result)
        # what fits badly has no wider a mode for it: how much noise there is, the likelihood integrates over
        wide = [covariance_of(model, terms(model, rows, m.pose, settings=plain)[2]) for m in modes]
        logs = np.array([modes[0].cost - m.cost + 0.5 * np.linalg.slogdet(w)[1] for m, w in zip(modes, wide)])
        volumes[k] = np.logaddexp.reduce(logs)
        aligned.append(result)
    return sigma, aligned, volumes


def _elsewhere(model: ObjectModel, contacts: Contacts, pose: Array, settings: RecognitionSettings) -> float:
    """Share of contacts farther than four sigmas off, sigma from the nearest quarter: right with half of them false."""
    size = np.abs(_residuals(model, contacts, pose))
    sigma = max(float(np.quantile(size, 0.25)) / 0.32, settings.least_noise)
    return float((size > 4 * sigma).mean())


def _another(model: ObjectModel, contacts: Contacts, pose: Array, settings: RecognitionSettings) -> tuple[float, float]:
    """Log Bayes factors that contacts were made on another object, any and plainly, from what the best leaves over."""
    some = _evenly(contacts, settings.most_contacts)
    local = se3.apply(se3.inverse(pose), some.points)
    distance, gradient = model.field.distance_and_gradient(local)
    normals = model.field.normals(local - distance[:, None] * gradient)
    least, most = settings.misfit.least_noise, settings.largest_noise
    if contacts.sigma_known:
        sigma = float(np.sqrt(np.mean(contacts.sigma_point**2)))
        least, most = max(least, 0.8 * sigma), max(least, min(most, 1.5 * sigma))
    return log_odds_of_another(
        local - model.centroid, normals, distance, model.diameter, (least, most), settings.misfit
    )


def _independent(model: ObjectModel, contacts: Contacts, pose: Array, settings: RecognitionSettings) -> float:
    """How many independent contacts these are worth: neighbours whose residuals agree say one thing together.

    The correlation of each residual with its nearest neighbour's, as in a first-order chain: n (1 - c) / (1 + c).
    Residuals have the least noise beside what they show: what a lattice leaves over of exact contacts is no misfit.
    """
    from scipy.spatial import cKDTree

    n = len(contacts)
    if n < 8:
        return float(n)
    residual = _residuals(model, contacts, pose)
    neighbour = cKDTree(contacts.points).query(contacts.points, k=2)[1][:, 1]
    correlation = float(residual @ residual[neighbour] / (residual @ residual + n * settings.least_noise**2))
    correlation = float(np.clip(correlation, 0.0, 0.98))
    return float(np.clip(n * (1 - correlation) / (1 + correlation), 1.0, settings.most_independent))


def _judged(
    model: ObjectModel,
    contacts: Contacts,
    extra: Evidence | None,
    aligned: Alignment,
    sigma: float,
    independent: float,
    settings: RecognitionSettings,
) -> tuple[float, Array]:
    """Log likelihood of the contacts at the candidate's likeliest pose, and that pose (4, 4).

    A contact is off the surface by exponential noise of an unknown scale, or false, anywhere within reach, with an
    unknown probability; both unknowns are integrated out over a grid. Known sigmas bound the scale from both sides.
    Contacts that merely fix the pose tell nothing about the object. Normals and extra rows add their own costs.
    """
    low, high = settings.least_noise, settings.largest_noise
    if contacts.sigma_known:
        low = max(low, 0.8 * sigma)
        high = max(low, min(high, 1.5 * sigma))
    scales = np.geomspace(low, max(high, 1.001 * low), 24)[:, None, None]
    false = np.array(settings.false_shares)[None, :, None]
    worth = max(independent - settings.freedoms, settings.least_share * independent)
    step = max(1, len(contacts) // settings.most_contacts)
    fits = np.zeros(len(aligned.poses))
    for i, pose in enumerate(aligned.poses):
        size = np.abs(_residuals(model, contacts, pose))[::step]
        density = (1 - false) * np.exp(-size / scales) / scales + false / settings.false_reach
        mean = np.log(density).mean(axis=2)
        fits[i] = np.logaddexp.reduce(worth * mean, axis=None) - np.log(mean.size)
    if contacts.has_normal.any():
        share = min(1.0, independent / len(contacts))
        with_normals = tables.from_contacts(contacts).with_sigma(sigma, tables.TOUCH)
        without = tables.from_contacts(contacts, use_normals=False).with_sigma(sigma, tables.TOUCH)
        robust = AlignSettings(huber=3.0)
        added = costs(model, with_normals, aligned.poses, settings=robust)
        fits -= share * (added - costs(model, without, aligned.poses, settings=robust))
    if extra is not None:
        fits -= costs(model, extra, aligned.poses)
    best = int(np.argmax(fits))
    return float(fits[best]), aligned.poses[best]


def _shares(logs: Array) -> Array:
    shares = np.exp(logs - logs.max())
    return shares / shares.sum()
