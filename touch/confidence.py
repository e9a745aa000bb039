"""How sure an answer by touch alone is: the probability that its ADD-S is below a tolerance, and what to call it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.evidence import table as tables
from scenes.evidence.align import Prior, align
from scenes.evidence.modes import Mode, displaced
from scenes.evidence.symmetry.alike import alike
from scenes.evidence.table import Evidence
from scenes.geometry.objects import ObjectModel
from scenes.recordings.checking.validation import check_below_object
from scenes.recordings.frames import Contacts
from touch.answers import Localization, LocalizeSettings
from touch.multistart import find_candidates
from touch.posterior import Posterior, posterior_of
from touch.thinning import cells_of, informative

Array = NDArray[np.float64]

# Beside the seed, so that what is drawn from the posterior is no part of the search's own stream.
DRAWING = 1


def asked(settings: LocalizeSettings, sure_within: float | None, model: ObjectModel) -> LocalizeSettings:
    """The settings with another tolerance (ADD-S, m) of the confidence; None leaves theirs. Raises InputError for none
    above 0 and for one beyond the object's diameter.
    """
    if sure_within is None:
        check_below_object("sure_within", settings.sure_within, model)
        return settings
    if not (np.isfinite(sure_within) and sure_within > 0):
        raise InputError(f"sure_within: expected metres above 0, got {sure_within}")
    check_below_object("sure_within", float(sure_within), model)
    return replace(settings, sure_within=float(sure_within))


def posterior_about(
    model: ObjectModel,
    contacts: Contacts,
    known: Array,
    sigma: float,
    rng: np.random.Generator,
    prior: Prior | None = None,
    extra: Evidence | None = None,
    settings: LocalizeSettings | None = None,
) -> Posterior:
    """Draws from what contacts, prior and extra rows say of the pose, about poses `known` (k, 4, 4) and all that the
    default method's search finds. sigma (m): the contacts' noise, as an answer has it. Contacts' frame, metres.
    """
    s, few = settings or LocalizeSettings(), worth_a_look(contacts, settings)
    rows = tables.from_contacts(few) if extra is None else tables.stack(tables.from_contacts(few), extra)
    searched = find_candidates(model, few, rows, rng, prior, s)
    candidates = np.concatenate([known, align(model, rows, searched.poses, prior).poses])
    return posterior_of(model, few, candidates, sigma, rng, prior, extra, s.posterior)


def worth_a_look(contacts: Contacts, settings: LocalizeSettings | None = None) -> Contacts:
    """At most `most_contacts` of them, chosen by what they tell."""
    most = (settings or LocalizeSettings()).most_contacts
    return contacts if len(contacts) <= most else contacts.take(informative(contacts, cells_of(contacts, most), most))


def judged(
    model: ObjectModel, found: Localization, posterior: Posterior, settings: LocalizeSettings | None = None
) -> Localization:
    """The answer with its confidence, covariance and verdict.

    `lost` stays: no pose explains the contacts, and the confidence is 0. An answer that the contacts contradict has
    `doubted` at most: what is believed of them is wrong, and the posterior rests on it. The covariance of an `ok`
    answer is that of the draws nearest to its first mode, where these are nearly all of them; else of all draws.
    """
    s = settings or LocalizeSettings()
    sure = posterior.within(model, found.pose, s.sure_within, s.posterior)
    if found.contradicted:
        sure = min(sure, s.doubted)
    notes = found.notes
    word = "ok" if sure >= s.sure else "ambiguous"
    if found.verdict == "lost":
        word, sure = "lost", 0.0
    elif word == "ok" and found.modes[0].weight < s.sure_share:
        same = alike(model, found.modes, s.sure_within)
        if s.way_round:
            word = "ambiguous"
        if len(same.near) > 1:
            far = f"{len(same.near)} poses the surface is where it is to {1e3 * s.sure_within:.3g} mm"
            notes = (*notes, f"which way round is not known: in {far}")
    near = nearest_first(model, posterior, found.modes) if word == "ok" else None
    if near is not None and posterior.weights[near].sum() < 1.0 - s.left_out:
        near = None
    covariance = s.widening * posterior.covariance_about(model, found.pose, near)
    return replace(
        found,
        verdict=word,
        notes=notes,
        confidence=sure,
        sure_within=s.sure_within,
        posterior_covariance=covariance,
    )


def nearest_first(model: ObjectModel, posterior: Posterior, modes: tuple[Mode, ...]) -> NDArray[np.bool_]:
    """(n,) whether a draw is nearer to the first mode than to any other, by how far a point at the radius moves."""
    away = np.array([displaced(model, posterior.poses, mode.pose) for mode in modes])
    return np.asarray(away.argmin(axis=0) == 0)
