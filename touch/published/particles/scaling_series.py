"""Scaling Series: a global search whose precision grows step by step, particles where the posterior is.

Petrovskaya, Khatib: Global Localization of Objects via Touch (IEEE T-RO 2011), as compared in T2 section 4.4. Every
step covers the surviving region evenly with particles of half-width delta, weighs them by the likelihood tempered to
that width, and keeps what carries weight; delta shrinks so that a neighbourhood halves in volume. The original's
particle count grows without bound or runs out of particles; here it stays between two limits. Contacts' frame, metres.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.evidence import table as tables
from scenes.evidence.align import Prior, costs
from scenes.evidence.table import Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from touch.answers import Localization
from touch.published.answers import localization
from touch.published.particles.resampling import from_prior, normalised, systematic

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ScalingSettings:
    """Neighbourhoods are measured by the displacement of the object's surface, metres. The method is Petrovskaya
    and Khatib's (2011); values by judgement.
    """

    # Half-width of the first neighbourhood as a share of the object's radius, and of the last in sigmas of a contact.
    first_share: float = 1.0
    last_sigmas: float = 0.5
    # Shrinking of the half-width per step: the volume in six dimensions halves.
    zoom: float = 2.0 ** (-1.0 / 6.0)
    # Particles per neighbourhood (M of the paper).
    per_neighbourhood: int = 6
    # Particles of a step: at least (a step that starves loses modes) and at most (memory and time are bounded).
    fewest: int = 4000
    most: int = 8000
    # Share of the heaviest particle's weight under which a particle's neighbourhood is given up.
    pruned_below: float = 1e-4
    # Sigma of a contact that says none (m), and the least: finer than the object's mesh no search is.
    unknown_sigma: float = 0.002
    # Contacts weighed in a step, evenly chosen: hundreds of them repeat one another.
    most_contacts: int = 120
    # First centroid: this far around the contacts' mean, shares of the object's radius.
    reach: float = 1.0


def localize(
    model: ObjectModel,
    contacts: Contacts,
    seed: int = 0,
    prior: Prior | None = None,
    extra: Evidence | None = None,
    settings: ScalingSettings | None = None,
) -> Localization:
    """Localise by the Scaling Series; see touch.localization. Normals are used when the contacts have them."""
    settings = settings or ScalingSettings()
    model.field  # noqa: B018  (building the lattice is not part of the search's time)
    begin = time.perf_counter()
    rng = np.random.default_rng(seed)
    few = contacts.take(np.linspace(0, len(contacts) - 1, min(len(contacts), settings.most_contacts)).astype(int))
    rows = tables.from_contacts(few)
    sigma = float(np.sqrt(np.mean(few.sigma_point**2))) if contacts.sigma_known else settings.unknown_sigma
    rows = rows.with_sigma(sigma, tables.TOUCH)
    if extra is not None:
        rows = tables.stack(rows, extra)
    width, last = settings.first_share * model.radius, settings.last_sigmas * sigma
    particles = _first(model, contacts, prior, settings, rng)
    while True:
        # the likelihood tempered so that one neighbourhood is about one sigma wide
        temper = max(1.0, (width / sigma) ** 2)
        cost = costs(model, rows, particles, prior) / temper
        if width <= last:
            break
        survivors = _survivors(particles, -cost, settings, rng)
        width *= settings.zoom
        particles = _cover(model, survivors, width, settings, rng)
    pose = particles[int(np.argmin(cost))]
    others = particles[np.argsort(cost, kind="stable")]
    return localization(model, contacts, pose, others, max(sigma, 0.01), begin, "scaling-series", prior, extra)


def _first(
    model: ObjectModel, contacts: Contacts, prior: Prior | None, settings: ScalingSettings, rng: np.random.Generator
) -> Array:
    """(fewest, 4, 4) particles over all rotations and the ball where the object can be, or drawn from the prior."""
    count = settings.fewest
    if prior is not None:
        return from_prior(model, prior, count, rng)
    rotations = se3.random_rotations(count, rng)
    radius = settings.reach * model.radius * np.cbrt(rng.random((count, 1)))
    middles = contacts.points.mean(axis=0) + radius * se3.random_unit_vectors(count, rng)
    return se3.make_poses(rotations, middles - rotations @ model.centroid)


def _survivors(particles: Array, log_weights: Array, settings: ScalingSettings, rng: np.random.Generator) -> Array:
    """The particles whose neighbourhoods go on: those that carry weight, each once; a fair draw when too many."""
    weights = normalised(log_weights)
    heavy = np.flatnonzero(weights > settings.pruned_below * weights.max())
    most = settings.most // settings.per_neighbourhood
    if len(heavy) > most:
        heavy = np.unique(systematic(log_weights, most, rng))
    return particles[heavy]


def _cover(
    model: ObjectModel, centres: Array, width: float, settings: ScalingSettings, rng: np.random.Generator
) -> Array:
    """Particles drawn evenly over the neighbourhoods of `centres` (k, 4, 4), half-width (m); the centres stay too.

    A neighbourhood is the ball of six dimensions whose axes are surface displacements.
    """
    count = int(np.clip(settings.per_neighbourhood * len(centres), settings.fewest, settings.most)) - len(centres)
    origin = np.arange(count) % len(centres)
    direction = rng.normal(size=(count, 6))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    delta = direction * width * rng.random((count, 1)) ** (1.0 / 6.0)
    delta[:, :3] /= model.radius
    return np.concatenate([centres, se3.perturb(centres[origin], delta, model.centroid)])
