"""Touch alone: where is the object, given points (and perhaps normals) on its surface? Every method, by its name."""

from __future__ import annotations

import time
from dataclasses import replace
from importlib import import_module

import numpy as np

from scenes.errors import InputError, unknown
from scenes.evidence.align import Prior, check_prior
from scenes.evidence.table import Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.checking.validation import check_are_contacts, check_is_model, check_scale, check_seed
from scenes.recordings.frames import Contacts, Frame
from touch.answers import Localization, LocalizeSettings
from touch.confidence import DRAWING, asked, judged, posterior_about, worth_a_look
from touch.multistart import multistart
from touch.posterior import posterior_of

# The sigma of a Gaussian in medians of its sizes.
GAUSSIAN = 1.48
# Every method by name -> module:function(model, contacts, seed, prior, extra) -> Localization, imported when asked for.
METHODS = {
    "multistart": "touch.multistart:multistart",
    "gradient-descent": "touch.published.optimisers.gradient_descent:localize",
    "levenberg-marquardt": "touch.published.optimisers.levenberg_marquardt:localize",
    "monte-carlo": "touch.published.optimisers.monte_carlo:localize",
    "direct": "touch.published.optimisers.direct:localize",
    "annealing": "touch.published.optimisers.annealing:localize",
    "mupf": "touch.published.particles.memory_unscented_particle_filter:localize",
    "upf": "touch.published.particles.memory_unscented_particle_filter:upf",
    "particle-filter": "touch.published.particles.particle_filters:plain",
    "annealed-particle-filter": "touch.published.particles.particle_filters:annealed",
    "scaling-series": "touch.published.particles.scaling_series:localize",
    "icp": "touch.published.contact_icp:localize",
}

# Contacts that spread over so many diameters of the object, most of them too, are not in metres: cm read as m make 100
# of one, noise of a metre some 45 of a mug. Fewer diameters may be noise, which is a verdict.
NOT_METRES = 60.0


def localize(
    model: ObjectModel,
    contacts: Contacts,
    seed: int = 0,
    method: str = "multistart",
    prior: Prior | None = None,
    extra: Evidence | None = None,
    settings: LocalizeSettings | None = None,
    sure_within: float | None = None,
) -> Localization:
    """Find the object from contacts alone.

    contacts in any frame, metres; the answer is contacts_frame_from_object. extra: more rows of evidence in the same
    frame (regions felt to be empty, links). prior: a Gaussian on the pose; local methods start at its mean.
    method: one of METHODS; settings are those of the default. sure_within (m): the answer's confidence is the
    probability that its ADD-S is below; default 5 mm. Whatever the method, what is drawn from the posterior tells.
    Raises InputError for no contacts, a prior that is no Gaussian, or a sure_within that is not above 0, CaptureError
    for contacts of a hundred times the model's size and more (cm or mm read as m): these spread over NOT_METRES of its
    diameters. What is nearer and fits nowhere is `lost`.
    """
    if method not in METHODS:
        raise unknown("method", method, METHODS)
    check_is_model(model)
    check_are_contacts(contacts)
    check_seed(seed)
    if prior is not None:
        check_prior(prior)
    if len(contacts) == 0:
        raise InputError("localize: expected at least one contact, got none")
    spread = float(np.ptp(contacts.points, axis=0).max()) if len(contacts) > 1 else 0.0
    if spread > NOT_METRES * model.diameter:
        check_scale(Frame(0, where="contacts", contacts=contacts), model)
    if settings is not None and method != "multistart":
        raise InputError(f"settings: expected none with method {method!r}, they are the default method's")
    how = asked(settings or LocalizeSettings(), sure_within, model)
    if method == "multistart":
        found = multistart(model, contacts, seed, prior, extra, settings)
    else:
        module, _, function = METHODS[method].partition(":")
        found = getattr(import_module(module), function)(model, contacts, seed, prior, extra)
    return _sure(model, contacts, _explained(model, contacts, found, settings), seed, prior, extra, how)


def _sure(
    model: ObjectModel,
    contacts: Contacts,
    found: Localization,
    seed: int,
    prior: Prior | None,
    extra: Evidence | None,
    settings: LocalizeSettings,
) -> Localization:
    """The answer with its confidence, if that is asked for, by draws from the posterior about all that a search finds:
    the method's own, or of a published one, which may know a single minimum, that of the default method.
    """
    begin = time.perf_counter()
    if not settings.drawn:
        return replace(found, candidates=None)
    rng = np.random.default_rng([seed, DRAWING])
    if found.candidates is None:
        own = np.array([mode.pose for mode in found.modes])
        posterior = posterior_about(model, contacts, own, found.sigma, rng, prior, extra, settings)
    else:
        few = worth_a_look(contacts, settings)
        posterior = posterior_of(model, few, found.candidates, found.sigma, rng, prior, extra, settings.posterior)
    spent = time.perf_counter() - begin if found.candidates is not None else 0.0
    return replace(judged(model, found, posterior, settings), time_s=found.time_s + spent, candidates=None)


def _explained(
    model: ObjectModel, contacts: Contacts, found: Localization, settings: LocalizeSettings | None
) -> Localization:
    """The answer; lost where contacts lie off its surface as no finger is noisy: on average, as `identify` judges it,
    and at their median, because a fifth of false ones moves an average by centimetres.
    """
    largest = (settings or LocalizeSettings()).largest_noise
    if contacts.sigma_known:
        largest = max(largest, float(np.sqrt(np.mean(contacts.sigma_point**2))))
    if found.index <= largest:
        return found
    away, _, _ = model.surface.closest(se3.apply(se3.inverse(found.pose), contacts.points))
    median = float(np.median(np.abs(away)))
    if GAUSSIAN * median <= largest:
        return found
    why = f"no pose explains the contacts: half of them are {1e3 * median:.1f} mm and more off the surface"
    return replace(found, verdict="lost", notes=(*found.notes, why))
