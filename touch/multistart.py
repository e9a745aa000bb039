"""The default method on touch alone: a batched multi-start.

Many starts, each refined by Levenberg-Marquardt on distance and normal (T1 eqs. 3.3, 3.5 with an analytic Jacobian),
blur falling from a share of the object's size to the noise of the contacts; all distinct minima are kept. Where starts
come from depends on what is known: a narrow prior is drawn from; contacts with normals suggest poses pair by pair; bare
points are tried everywhere. Contacts that cannot all be met to within the noise they claim are explained in one of two
ways: some of them are false, when most others agree to within their claim; else all are noisier than that, and how much
is inferred from their residuals.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scenes.evidence import table as tables
from scenes.evidence.align import Alignment, AlignSettings, Prior, align, costs
from scenes.evidence.modes import Mode, ModeSettings, covariance_of, distinct_modes
from scenes.evidence.point_pairs import built_pair_table, pair_table
from scenes.evidence.search import SearchStage, first_of_cells, rotation_grid, search
from scenes.evidence.table import Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from touch.answers import Localization, LocalizeSettings, contact_index, noise_at, verdict_of
from touch.polish import polish
from touch.thinning import Whole, cells_of, informative

Array = NDArray[np.float64]

# Contacts alone are searched in the lattice as it is.
FINELY = AlignSettings(coarsely=False)
# Points of the surface, even over its area, of which a start lays one on a contact.
SAMPLES = 4000


def contact_starts(model: ObjectModel, contacts: Contacts, count: int, rng: np.random.Generator) -> Array:
    """(count, 4, 4) starts: even rotations; one contact, chosen at random, lies on the surface where its normal fits.

    Half of the starts put the contacts' mean onto the object's centroid instead, which suits contacts all around it.
    """
    rotations = rotation_grid(count, rng)
    poses = np.tile(np.eye(4), (count, 1, 1))
    middle = contacts.points.mean(axis=0)
    spread = 0.3 * model.radius
    poses[:, :3, :3] = rotations
    offsets = rng.normal(size=(count, 3)) * spread
    poses[:, :3, 3] = middle + offsets - rotations @ model.centroid
    seed, half = int(rng.integers(2**31)), np.arange(1, count, 2)
    contact = rng.integers(len(contacts), size=len(half))
    points, normals = model.sample_surface(SAMPLES, seed, rng.integers(SAMPLES, size=len(half)))
    known = contacts.has_normal[contact]
    if known.any():
        # turn the start so that the surface's normal meets the contact's, the shortest way
        source = np.einsum("nij,nj->ni", rotations[half], normals)
        target = np.where(known[:, None], contacts.normals[contact], source)
        poses[half, :3, :3] = shortest_turn(source, target) @ rotations[half]
    placed = np.einsum("nij,nj->ni", poses[half, :3, :3], points)
    poses[half, :3, 3] = contacts.points[contact] - placed
    return poses


def shortest_turn(source: Array, target: Array) -> Array:
    """(n, 3, 3) rotations that take unit vectors source to target."""
    axis = np.cross(source, target)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, np.einsum("ni,ni->n", source, target))
    other = np.cross(source, np.eye(3)[np.argmin(np.abs(source), axis=1)])
    axis = np.where(sine[:, None] > 1e-9, axis, other)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    return se3.exp_rotation(axis * angle[:, None])


def contact_stages(model: ObjectModel, rows: int, settings: LocalizeSettings) -> tuple[int, tuple[SearchStage, ...]]:
    """How many starts and which passes the budget allows for so many rows."""
    steps = (6, 10, 14)
    affordable = int(settings.budget_rows / (max(rows, 1) * steps[0]))
    starts = int(np.clip(affordable, 300, settings.starts))
    share = starts / settings.starts
    wide = settings.widest_blur * model.radius
    blurs = (wide, wide / 4, wide / 16)
    angles = (settings.widest_blur_normal, settings.widest_blur_normal / 3, settings.widest_blur_normal / 9)
    keeps = [max(60, int(k * share)) for k in settings.keep]
    return starts, tuple(SearchStage(b, a, 10**9, i, k) for b, a, i, k in zip(blurs, angles, steps, keeps))


def find_candidates(
    model: ObjectModel,
    contacts: Contacts,
    rows: Evidence,
    rng: np.random.Generator,
    prior: Prior | None,
    settings: LocalizeSettings,
) -> Alignment:
    """Roughly refined poses, best first, from the starts that suit what is known (see the top of this file).

    rows: the contacts' own first, then any others.
    """
    if prior is not None:
        covariance = covariance_of(model, prior.information)
        widths = np.sqrt(np.diag(covariance))
        if widths[:3].max() < settings.narrow_angle and widths[3:].max() < settings.narrow_share * model.radius:
            delta = rng.normal(size=(settings.draws, 6)) @ np.linalg.cholesky(covariance).T
            delta[0] = 0.0
            starts = se3.perturb(prior.pose, delta, model.centroid)
            return search(model, rows, starts, _passes(model, settings.draw_passes), prior, FINELY)
    if int(contacts.has_normal.sum()) >= settings.least_normals:
        count = int(np.clip(settings.budget_rank // len(contacts), 1000, settings.hypotheses))
        rotations, origins = pair_table(model).hypotheses(contacts, count)
        if len(rotations):
            starts = se3.make_poses(rotations, origins)
            blur, blur_normal = settings.rank_blur
            rough = replace(FINELY, blur=blur * model.radius, blur_normal=blur_normal)
            merits = costs(model, rows.take(np.arange(len(contacts))), starts, prior, rough)
            keep = int(np.clip(settings.budget_ranked // (8 * len(rows)), 60, settings.ranked))
            order = np.argsort(merits, kind="stable")[: settings.looked_through * keep]
            starts = starts[first_of_cells(model, starts, order, settings.jitter, settings.jitter)[:keep]]
            widths = np.repeat([settings.jitter, settings.jitter * model.radius], 3)
            starts = se3.perturb(starts, widths * rng.normal(size=(len(starts), 6)), model.centroid)
            if prior is not None:
                starts = np.concatenate([starts, prior.pose[None]])
            return search(model, rows, starts, _passes(model, (settings.pair_pass,)), prior, FINELY)
    count, stages = contact_stages(model, len(rows), settings)
    return search(model, rows, contact_starts(model, contacts, count, rng), stages, prior, FINELY)


def _passes(model: ObjectModel, passes: tuple[tuple[float, float, int, int], ...]) -> tuple[SearchStage, ...]:
    """Stages from (blur as a share of the radius, blur of normals in rad, steps, survivors)."""
    return tuple(SearchStage(blur * model.radius, angle, 10**9, steps, keep) for blur, angle, steps, keep in passes)


def refine_contacts(
    model: ObjectModel, contacts: Contacts, starts: Array, prior: Prior | None = None, use_normals: bool = True
) -> Alignment:
    """Local refinement by distance and normal of every start (b, 4, 4): wide blur, then the contacts' own noise."""
    rows = tables.from_contacts(contacts, use_normals=use_normals)
    rough = replace(FINELY, blur=0.1 * model.radius, blur_normal=0.4, iterations=12)
    result = align(model, rows, starts, prior, rough)
    return align(model, rows, result.poses, prior, AlignSettings())


def multistart(
    model: ObjectModel,
    contacts: Contacts,
    seed: int = 0,
    prior: Prior | None = None,
    extra: Evidence | None = None,
    settings: LocalizeSettings | None = None,
) -> Localization:
    """The default method; arguments as in `localize`."""
    settings = settings or LocalizeSettings()
    model.field  # noqa: B018  (building the lattice is not part of the search's time, nor is the table of pairs)
    if int(contacts.has_normal.sum()) >= settings.least_normals:
        built_pair_table(model)
    begin = time.perf_counter()
    rng = np.random.default_rng(seed)
    few = contacts
    if len(contacts) > settings.most_contacts:
        cells = cells_of(contacts, settings.most_contacts)
        few = contacts.take(informative(contacts, cells, settings.most_contacts))
    rows = tables.from_contacts(few)
    if extra is not None:
        rows = tables.stack(rows, extra)
    found = find_candidates(model, few, rows, rng, prior, settings)
    result = align(model, rows, found.poses, prior)
    claimed = sigma = float(np.sqrt(np.mean(contacts.sigma_point**2)))
    inferred = _inferred_noise(model, few, result, settings)
    some_false = None
    if inferred is not None and contacts.sigma_known:
        some_false = _some_false(model, few, extra, rng, prior, settings)
    if some_false is not None:
        result, inferred = some_false, None
    last = AlignSettings()
    if inferred is not None:
        sigma = inferred
        rows = rows.with_sigma(sigma, tables.TOUCH)
        last = AlignSettings(huber=settings.huber)
        result = align(model, rows, np.concatenate([found.poses, result.poses]), prior, last)
    modes = distinct_modes(model, result, ModeSettings())
    notes: tuple[str, ...] = ()
    exact = sigma < settings.exact_below * model.field.spacing and extra is None and prior is None
    if exact and some_false is None:
        modes = polish(model, few, modes, sigma, settings.huber if inferred is not None else 0.0)
        if few is not contacts:
            notes = (f"{len(few)} of {len(contacts)} contacts used: the others would tell less than the mesh can",)
    elif few is not contacts:
        gate = tables.NO_GATE if some_false is None else settings.false_gate
        whole = Whole(model, contacts, cells, prior, extra, last, None if inferred is None else sigma, gate)
        poses = np.array([mode.pose for mode in modes[: settings.settled_modes]])
        settled = whole.settle(poses, settings.settling_steps)
        modes = distinct_modes(model, settled, ModeSettings())
        notes = (f"searched with {len(few)} of {len(contacts)} contacts, settled with all",)
    if not contacts.sigma_known and inferred is None:
        usual = f"{1e3 * sigma:.1f} mm and {np.rad2deg(contacts.sigma_normal[0]):.0f} degrees"
        notes += (f"the contacts say no sigma, and so few do not tell: {usual} believed of each",)
    pose, verdict, contradicted = modes[0].pose, verdict_of(modes, model, settings), False
    # what is claimed to be finer than the lattice leaves over the lattice's own errors
    believed = inferred is None and some_false is None and few is contacts and not exact
    unlike = exact and inferred is None and some_false is None and _unlike(model, modes[0], contacts, settings)
    if unlike or (believed and _contradicted(model, modes[0], contacts, prior, settings)):
        # no noise was inferred that would explain it, and no contact was called false
        verdict, contradicted = "ambiguous", True
        notes += ("the contacts contradict every pose: another mesh, or worse contacts than they say",)
    if some_false is not None and _rivalled(model, modes, few, rng, prior, settings):
        verdict, contradicted = "ambiguous", True
        notes += ("some contacts speak for one place, others for another: has the object moved between them?",)
    if inferred is not None and contacts.sigma_known and inferred > settings.misclaimed * claimed:
        verdict, contradicted = "ambiguous", True
        sizes = f"their noise would be {1e3 * inferred:.1f} mm, and they say {1e3 * claimed:.1f}"
        notes += (f"the contacts contradict every pose, {sizes}: another mesh, or has the object moved?",)
    return Localization(
        pose,
        modes,
        contact_index(model, contacts, pose),
        sigma,
        verdict,
        time.perf_counter() - begin,
        notes=notes,
        contradicted=contradicted,
        candidates=np.concatenate([np.array([mode.pose for mode in modes]), result.poses]),
    )


def _contradicted(
    model: ObjectModel, mode: Mode, contacts: Contacts, prior: Prior | None, settings: LocalizeSettings
) -> bool:
    """Whether contacts leave over more than their own sigmas do by chance: the mode's cost (nats) is half a chi-square
    of their numbers and the prior's, less those that a pose fits (Wilson and Hilferty 1931). Rows beyond them are met,
    and cost nothing, or contradict it, too.
    """
    fitted = int(np.linalg.matrix_rank(model.symmetries.quotient(mode.pose[:3, :3], model.centroid)))
    free = len(contacts) + 2 * int(contacts.has_normal.sum()) + (6 if prior is not None else 0) - fitted
    if free < 1:
        return False
    spread = 2.0 / (9.0 * free)
    return bool(2.0 * mode.cost > free * (1.0 - spread + settings.contradicted_sigmas * np.sqrt(spread)) ** 3)


def _unlike(model: ObjectModel, mode: Mode, contacts: Contacts, settings: LocalizeSettings) -> bool:
    """Whether contacts that claim to be finer than the lattice disagree with a pose by more than the lattice is off."""
    agree = _agreeing(model, contacts, mode.pose, model.field.spacing)
    return bool((~agree).sum() > settings.unlike_share * len(contacts))


def _some_false(
    model: ObjectModel,
    contacts: Contacts,
    extra: Evidence | None,
    rng: np.random.Generator,
    prior: Prior | None,
    settings: LocalizeSettings,
) -> Alignment | None:
    """Poses that some of the contacts speak for as they claim, and the others not at all; None when too few agree."""
    rows = tables.from_contacts(contacts, gate=settings.false_gate)
    if extra is not None:
        rows = tables.stack(rows, extra)
    found = find_candidates(model, contacts, rows, rng, prior, settings)
    result = align(model, rows, found.poses, prior)
    agree = _agreeing(model, contacts, result.poses[int(np.argmin(result.costs))])
    needed = max(settings.agreeing_least, settings.agreeing_share * len(contacts))
    return result if agree.sum() >= needed else None


def _agreeing(model: ObjectModel, contacts: Contacts, pose: Array, least: float = 0.0) -> NDArray[np.bool_]:
    """Which contacts agree with a pose to within three of the sigmas that they claim; of points these are at least
    `least` (m).
    """
    residual, outward, _ = model.surface.closest(se3.apply(se3.inverse(pose), contacts.points))
    agree = np.abs(residual) < 3.0 * np.maximum(contacts.sigma_point, least)
    if contacts.has_normal.any():
        cosine = np.sum(outward * (contacts.normals @ pose[:3, :3]), axis=1)
        limit = np.minimum(3.0 * contacts.sigma_normal, np.pi)
        agree &= ~contacts.has_normal | (cosine > np.cos(limit))
    return np.asarray(agree)


def _rivalled(
    model: ObjectModel,
    modes: tuple[Mode, ...],
    contacts: Contacts,
    rng: np.random.Generator,
    prior: Prior | None,
    settings: LocalizeSettings,
) -> bool:
    """Whether another pose explains what the first mode calls false, as contacts that are wild alone do not; or might:
    without normals any pose meets some, and the rest that agree with the first are few beside those that do not.
    """
    theirs = contacts.take(np.flatnonzero(~_agreeing(model, contacts, modes[0].pose)))
    beyond = len(contacts) - len(theirs) - settings.met_anyway
    if not theirs.has_normal.any() and beyond <= settings.outnumbered * len(theirs):
        return True
    few = settings.rivals_normal if theirs.has_normal.any() else settings.rivals
    needed = max(few, settings.rivals_share * len(theirs))
    if len(theirs) < needed:
        return False
    rows = tables.from_contacts(theirs, gate=settings.false_gate)
    found = align(model, rows, find_candidates(model, theirs, rows, rng, prior, settings).poses, prior)
    best = found.poses[np.argsort(found.costs, kind="stable")[: settings.settled_modes]]
    poses = [*(mode.pose for mode in modes[1:]), *best]
    return any(int(_agreeing(model, theirs, pose).sum()) >= needed for pose in poses)


def _inferred_noise(
    model: ObjectModel, contacts: Contacts, result: Alignment, settings: LocalizeSettings
) -> float | None:
    """Sigma (m) that the residuals of the best pose speak of; None when the contacts' own claim holds."""
    if len(contacts) < 7:
        return None  # six contacts can always be met: their residuals tell nothing about noise
    best = int(np.argmin(result.costs))
    sigma, left = noise_at(model, contacts, result.poses[best], covariance_of(model, result.hessians[best]))
    sigma += 1e-6 * model.radius
    claimed = float(np.sqrt(np.mean(contacts.sigma_point**2)))
    # a mean |r| of so few scatters by this share of itself, sqrt(pi / 2 - 1): chance is no surprise
    chance = 0.756 / np.sqrt(max(left, 1.0))
    limit = max(settings.surprise, 1.0 + settings.surprise_sigmas * chance)
    if sigma > limit * claimed or not contacts.sigma_known:
        return sigma
    return None
