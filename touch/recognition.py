"""Which of several known objects was touched (T1 section 6.2.1, T2 chapter 5).

Every candidate is searched for in batches; those that fit far worse than the best are given up early. Two likelihoods
are told: the published one, 1/G normalised, and the evidence, summed over all poses and over the unknown noise of
points and normals (touch.identity), in which contacts that err alike count once. What the best candidate leaves over is
judged, too: a smooth misfit speaks for none of them (touch.misfit), and only a decisive lack of it lets an answer be
`ok`.
Points alone decide who is given up, and whether normals point outward: a driver's convention must hide no object.
Contacts' frame, metres.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.evidence import table as tables
from scenes.evidence.align import Alignment, AlignSettings, align
from scenes.evidence.search import SearchStage, distinct_first, search
from scenes.evidence.table import Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.checking.validation import check_are_contacts, check_is_model, check_seed
from scenes.recordings.frames import Contacts
from touch.identity.evidence import EvidenceSettings, likelihoods, log_evidence
from touch.identity.noise import Noise
from touch.misfit import MisfitSettings, log_odds_of_another
from touch.multistart import contact_starts
from touch.posterior import normalised

Array = NDArray[np.float64]


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
    # Share of contacts far off the best object from which on no answer is sure.
    most_elsewhere: float = 0.35
    # Residuals beyond this many sigmas (or blurs) count linearly while poses are refined: false contacts pull little.
    huber: float = 0.5
    # Minima of a candidate about which poses are drawn, and how many are refined of one that is given up.
    minima: int = 100
    minima_given_up: int = 5
    # Normals are looked up at no less than this (rad, 10 degrees) while poses are refined: what they claim is seldom
    # so, and fingers press edges.
    least_turned: float = 0.17
    # Normals all point inward where that is likelier by so many nats: twenty to one, as few sensors have it so.
    inward: float = 3.0
    # Contacts count at most for this many independent ones: errors of the mesh and of the calibration are shared.
    most_independent: float = 25.0
    # Share of the likelihood at which the answer is sure: among the candidates, and with none of them.
    sure: float = 0.99
    sure_of_all: float = 0.9
    # Noise that a misfit is held against, in sigmas that contacts tell: claims are wrong by two.
    told: tuple[float, float] = (0.5, 2.2)
    # Share of touched things that are none of the candidates, before anything is felt.
    strangers: float = 0.05
    # Nats that each contact, beyond those that a pose can meet, speaks for another object at most: it may be false.
    most_each: float = 1.0
    freedoms: float = 6.0
    # Nats by which what the best leaves over must speak for it and against all that is plainly another object,
    # candidate or not: 1100 to one. A hundred is decisive (Jeffreys 1961) between two that both are what they are said
    # to be; a relative is nearer than a Gaussian field has it, and of 54 draws in which a tool was not among the
    # candidates one reached 6.4. Fewer independent contacts than these cannot tell: twice what a pose can fit.
    decisive: float = 7.0
    least_independent: float = 12.0
    evidence: EvidenceSettings = field(default_factory=EvidenceSettings)
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
    next one's; sigma, inferred noise of a contact (m); independent: how many contacts count. notes: in words, why a
    verdict is ambiguous.
    """

    best: str
    verdict: str
    candidates: tuple[Candidate, ...]
    none: float
    margin: float
    sigma: float
    independent: float
    time_s: float
    notes: tuple[str, ...] = ()


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
    if not isinstance(models, Iterable) or isinstance(models, str):
        raise InputError(f"models: expected a list of ObjectModel, got {type(models).__name__}")
    models = list(models)
    for model in models:
        check_is_model(model)
    check_are_contacts(contacts)
    check_seed(seed)
    names = [model.name for model in models]
    if not names or len(set(names)) < len(names):
        raise InputError(f"identify: expected models of different names, got {', '.join(names) or 'none'}")
    if len(contacts) == 0:
        raise InputError("identify: expected at least one contact, got none")
    for model in models:
        model.field, model.surface  # noqa: B018  (built before anything is timed)
    begin = time.perf_counter()
    bare = _with(contacts, None)
    first, again = (settings.starts, settings.keep), (settings.more_starts, settings.more_keep)
    # of its own for each: what is told of one depends neither on their order nor on which others there are
    streams = [np.random.default_rng([seed, crc32(name.encode())]) for name in names]
    few, many = _evenly(bare, settings.few_contacts), _evenly(bare, settings.most_contacts)
    found = [_look(model, few, many, extra, first, settings, s) for model, s in zip(models, streams)]
    index = np.array([_index(model, contacts, one.poses[0]) for model, one in zip(models, found)])
    limit = max(settings.hopeless_ratio * index.min(), index.min() + settings.hopeless_above)
    given_up = index > limit
    playing = [int(k) for k in np.flatnonzero(~given_up)]
    contacts = _outward(models, contacts, found, playing, settings)
    more, many = _evenly(contacts, settings.more_contacts), _evenly(contacts, settings.most_contacts)
    for k in playing:
        found[k] = _merged(found[k], _look(models[k], more, many, extra, again, settings, streams[k]))
    sigma = _sigma(models, many, found, settings)
    near = int(np.argmin([_index(model, contacts, one.poses[0]) for model, one in zip(models, found)]))
    independent = _independent(models[near], contacts, found[near].poses[0], settings)
    noise = Noise(many, min(1.0, independent / len(many)), settings.evidence.noise)
    logs, poses = np.zeros(len(models)), []
    for k, (model, one, stream) in enumerate(zip(models, found, streams)):
        aligned = _aligned(model, noise, extra, one, sigma, bool(given_up[k]), settings)
        poses.append(aligned.poses[int(np.argmax(likelihoods(model, noise, aligned.poses, extra)))])
        logs[k] = log_evidence(model, noise, aligned, stream, extra, settings.evidence)
    index = np.array([_index(model, contacts, pose) for model, pose in zip(models, poses)])
    likelihood = normalised(logs)
    inverse = 1.0 / np.maximum(index, 1e-9)
    order = np.argsort(-likelihood, kind="stable")
    best = int(order[0])
    another, plainly = _another(models[best], contacts, poses[best], settings)
    another = min(another, settings.most_each * max(len(contacts) - settings.freedoms, 0.0))
    prior = np.log(settings.strangers) - np.log1p(-settings.strangers)
    none = float(0.5 * (1.0 + np.tanh(0.5 * (another + prior))))
    share, likelihood = float(likelihood[best]), likelihood * (1.0 - none)
    elsewhere = _elsewhere(models[best], contacts, poses[best], settings)
    asked = (
        (share >= settings.sure, f"another candidate fits, too: {names[best]} has {share:.0%} among them"),
        (likelihood[best] >= settings.sure_of_all, f"{names[best]} has {likelihood[best]:.0%} with none of them"),
        (
            independent >= settings.least_independent,
            f"{independent:.1f} independent contacts, of {settings.least_independent:g} that a name takes: touch more",
        ),
        (plainly <= -settings.decisive, "plainly another object is not ruled out: touch more, or more exactly"),
        # when nearly half of the contacts are elsewhere, they may as well be the true ones
        (elsewhere <= settings.most_elsewhere, f"{elsewhere:.0%} of the contacts lie elsewhere"),
    )
    notes = tuple(doubt for fine, doubt in asked if not fine)
    verdict = "ambiguous" if notes else "ok"
    if index.min() > settings.evidence.noise.largest:
        verdict = "lost"
    logs = np.sort(logs)[::-1]
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
        names[best], verdict, candidates, none, margin, sigma, independent, time.perf_counter() - begin, notes
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


def _with(contacts: Contacts, normals: Array | None) -> Contacts:
    """The contacts with other normals (n, 3), or none."""
    c = contacts
    return Contacts(c.points, normals, c.sigma_point, c.sigma_normal, c.sensors, c.forces, c.sigma_told)


def _outward(
    models: Sequence[ObjectModel],
    contacts: Contacts,
    found: list[Alignment],
    playing: list[int],
    settings: RecognitionSettings,
) -> Contacts:
    """The contacts, their normals turned round where poses that the points alone have found say that all point in."""
    if not contacts.has_normal.any():
        return contacts
    there = _evenly(contacts, settings.more_contacts)
    back = _with(there, -there.normals)
    s = replace(settings.evidence.noise, inward=0.0)
    told = [
        [Noise(some, 1.0, s).at(models[k], found[k].poses[: settings.minima_given_up]) for k in playing]
        for some in (there, back)
    ]
    out, into = (float(np.logaddexp.reduce(np.concatenate(logs))) for logs in told)
    return _with(contacts, -contacts.normals) if into - out > settings.inward else contacts


def _sigma(
    models: Sequence[ObjectModel], many: Contacts, found: list[Alignment], settings: RecognitionSettings
) -> float:
    """Noise (m) that the best candidate speaks of, where none is told."""
    n = len(many)
    if many.sigma_known or n <= 6:
        return float(np.sqrt(np.mean(many.sigma_point**2)))
    # the median forgives false contacts; 1.48 of it is the sigma of a Gaussian
    medians = [float(np.median(np.abs(_residuals(m, many, one.poses[0])))) for m, one in zip(models, found)]
    s = settings.evidence.noise
    return float(np.clip(1.48 * min(medians) * n / (n - 6), s.least, s.largest))


def _aligned(
    model: ObjectModel,
    noise: Noise,
    extra: Evidence | None,
    found: Alignment,
    sigma: float,
    given_up: bool,
    settings: RecognitionSettings,
) -> Alignment:
    """The best poses of a candidate, refined under the noise that is inferred; their Hessians are of the likelihood."""
    rows = tables.from_contacts(noise.contacts).with_sigma(sigma, tables.TOUCH)
    turned = rows.rows[:, tables.SIGMA_NORMAL]
    rows.rows[:, tables.SIGMA_NORMAL] = np.where(turned > 0, np.maximum(turned, settings.least_turned), 0.0)
    # all together count no more than their independent part, or minima would look sharper than they are
    rows = rows.reweighted(noise.power)
    if extra is not None:
        rows = tables.stack(rows, extra)
    kept = settings.minima_given_up if given_up else settings.minima
    steps = AlignSettings(huber=settings.huber, iterations=20)
    result = align(model, rows, found.poses[:kept], settings=steps)
    return result.take(distinct_first(model, result, kept))


def _elsewhere(model: ObjectModel, contacts: Contacts, pose: Array, settings: RecognitionSettings) -> float:
    """Share of contacts farther than four sigmas off, sigma from the nearest quarter: right with half of them false."""
    size = np.abs(_residuals(model, contacts, pose))
    sigma = max(float(np.quantile(size, 0.25)) / 0.32, settings.evidence.noise.least)
    return float((size > 4 * sigma).mean())


def _another(model: ObjectModel, contacts: Contacts, pose: Array, settings: RecognitionSettings) -> tuple[float, float]:
    """Log Bayes factors that contacts were made on another object, any and plainly, from what the best leaves over."""
    some = _evenly(contacts, settings.most_contacts)
    local = se3.apply(se3.inverse(pose), some.points)
    distance, gradient = model.field.distance_and_gradient(local)
    # a misfit is a field on the surface: beside it, noise itself would be a smooth function of where a contact is
    feet = local - distance[:, None] * gradient
    normals = model.field.normals(feet)
    least, most = settings.misfit.least_noise, settings.evidence.noise.largest
    if contacts.sigma_known:
        sigma = float(np.sqrt(np.mean(contacts.sigma_point**2)))
        low, high = settings.told
        least, most = max(least, low * sigma), max(least, min(most, high * sigma))
    return log_odds_of_another(feet - model.centroid, normals, distance, model.diameter, (least, most), settings.misfit)


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
    # false contacts are no errors that neighbours share
    wild = max(4.5 * float(np.median(np.abs(residual))), settings.evidence.noise.least)
    residual = np.clip(residual, -wild, wild)
    neighbour = cKDTree(contacts.points).query(contacts.points, k=2)[1][:, 1]
    correlation = float(residual @ residual[neighbour] / (residual @ residual + n * settings.evidence.noise.least**2))
    correlation = float(np.clip(correlation, 0.0, 0.98))
    return float(np.clip(n * (1 - correlation) / (1 + correlation), 1.0, settings.most_independent))
