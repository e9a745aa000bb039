"""Touch alone: where is the object, given points (and perhaps normals) on its surface? Every method, by its name."""

from __future__ import annotations

from importlib import import_module

from scenes.errors import InputError, unknown
from scenes.evidence.align import Prior
from scenes.evidence.table import Evidence
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from touch.answers import Localization, LocalizeSettings
from touch.multistart import multistart

# Every method by name -> module:function(model, contacts, seed, prior, extra) -> Localization, imported when asked for.
METHODS = {
    "multistart": "touch.multistart:multistart",
    "gradient-descent": "touch.published.gradient_descent:localize",
    "levenberg-marquardt": "touch.published.levenberg_marquardt:localize",
    "monte-carlo": "touch.published.monte_carlo:localize",
    "direct": "touch.published.direct:localize",
    "annealing": "touch.published.annealing:localize",
    "mupf": "touch.published.memory_unscented_particle_filter:localize",
    "upf": "touch.published.memory_unscented_particle_filter:upf",
    "particle-filter": "touch.published.particle_filters:plain",
    "annealed-particle-filter": "touch.published.particle_filters:annealed",
    "scaling-series": "touch.published.scaling_series:localize",
    "icp": "touch.published.contact_icp:localize",
}


def localize(
    model: ObjectModel,
    contacts: Contacts,
    seed: int = 0,
    method: str = "multistart",
    prior: Prior | None = None,
    extra: Evidence | None = None,
    settings: LocalizeSettings | None = None,
) -> Localization:
    """Find the object from contacts alone.

    contacts in any frame, metres; the answer is contacts_frame_from_object. extra: more rows of evidence in the same
    frame (regions felt to be empty, links). prior: a Gaussian on the pose; local methods start at its mean.
    method: one of METHODS; settings are those of the default. Raises InputError for no contacts.
    """
    if method not in METHODS:
        raise unknown("method", method, METHODS)
    if len(contacts) == 0:
        raise InputError("localize: expected at least one contact, got none")
    if method == "multistart":
        return multistart(model, contacts, seed, prior, extra, settings)
    if settings is not None:
        raise InputError(f"settings: expected none with method {method!r}, they are the default method's")
    module, _, function = METHODS[method].partition(":")
    found: Localization = getattr(import_module(module), function)(model, contacts, seed, prior, extra)
    return found
