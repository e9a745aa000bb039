"""From the particles or poses that a published search ends with to a Localization: modes, noise, verdict."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.evidence import table as tables
from scenes.evidence.align import AlignSettings, Prior, align, terms
from scenes.evidence.modes import Mode, ModeSettings, covariance_of, displaced, distinct_modes
from scenes.evidence.table import Evidence
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from touch.answers import Localization, contact_index, noise_at, verdict_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AnswerSettings:
    """How the end of a stochastic search is read. Values by judgement."""

    # Particles looked at for other modes.
    looked_at: int = 300
    # A search that ends this many of its own sigmas (m) away from the contacts has found nothing.
    lost_sigmas: float = 3.0


def localization(
    model: ObjectModel,
    contacts: Contacts,
    pose: Array,
    others: Array,
    believed: float,
    begin: float,
    method: str,
    prior: Prior | None = None,
    extra: Evidence | None = None,
    settings: AnswerSettings | None = None,
) -> Localization:
    """The answer of a search that chose `pose` (4, 4) among `others` (n, 4, 4), contacts_frame_from_object.

    believed: sigma (m) that the search itself worked with; begin: perf_counter at its start. Poses stay exactly where
    the search left them; sigma and the modes' weights come from the noise that the chosen pose's residuals speak of.
    """
    settings = settings or AnswerSettings()
    elapsed = time.perf_counter() - begin
    index = contact_index(model, contacts, pose)
    sigma = float(np.sqrt(np.mean(contacts.sigma_point**2)))
    if len(contacts) > 6 and not contacts.sigma_known:
        _, _, information = terms(model, tables.from_contacts(contacts), pose, prior)
        sigma = max(sigma, noise_at(model, contacts, pose, covariance_of(model, information))[0])
    rows = tables.from_contacts(contacts).with_sigma(sigma, tables.TOUCH)
    if extra is not None:
        rows = tables.stack(rows, extra)
    step = max(1, len(others) // settings.looked_at)
    looked_at = np.concatenate([pose[None], others[::step]])
    judged = align(model, rows, looked_at, prior, AlignSettings(iterations=0))
    first = distinct_modes(model, judged.take(np.zeros(1, dtype=np.intp)))[0]
    # what lies where the chosen one does is that one, whichever of the two is cheaper
    apart = ModeSettings().merge_share * model.radius
    rest = (m for m in distinct_modes(model, judged) if displaced(model, m.pose[None], first.pose)[0] >= apart)
    modes = (first, *rest)
    modes = _weighed(modes)
    lost = index > settings.lost_sigmas * believed
    return Localization(pose, modes, index, sigma, "lost" if lost else verdict_of(modes), elapsed, method)


def conclude(
    model: ObjectModel,
    contacts: Contacts,
    found: Array,
    method: str,
    begin: float,
    prior: Prior | None = None,
    extra: Evidence | None = None,
) -> Localization:
    """A Localization of poses (b, 4, 4) exactly as a method left them: modes, covariances and verdict from the
    contacts' sigmas.
    """
    rows = tables.from_contacts(contacts)
    if extra is not None:
        rows = tables.stack(rows, extra)
    judged = align(model, rows, found, prior, AlignSettings(iterations=0))
    modes = distinct_modes(model, judged)
    elapsed = time.perf_counter() - begin
    pose = modes[0].pose
    sigma = float(np.sqrt(np.mean(contacts.sigma_point**2)))
    return Localization(
        pose, modes, contact_index(model, contacts, pose), sigma, verdict_of(modes, model), elapsed, method
    )


def _weighed(modes: tuple[Mode, ...]) -> tuple[Mode, ...]:
    """The modes with Laplace weights judged together."""
    logs = np.array([-m.cost + 0.5 * np.linalg.slogdet(m.covariance)[1] for m in modes])
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    return tuple(Mode(m.pose, float(w), m.cost, m.covariance) for m, w in zip(modes, weights))
