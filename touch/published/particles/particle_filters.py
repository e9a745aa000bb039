"""The plain and the annealed particle filter over contacts: what the unscented ones are compared with (T2 section 4.1).

Plain: bootstrap filter on the static pose with artificial motion (T2 eq. 4.12), one contact after another.
Annealed: all contacts at once, the likelihood raised from nearly flat to its full power while the motion shrinks
(Deutscher, Reid: Articulated Body Motion Capture by Stochastic Search, IJCV 2005, as Petrovskaya and Corcoran use it
for touch). Contacts' frame, metres.
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
from touch.published.particles.resampling import from_prior, systematic

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ParticleFilterSettings:
    """Both filters. Values by judgement where no source is named."""

    # Particles. T2 estimates a million for the plain filter; this many show what fewer do.
    particles: int = 5000
    # Sigma of a contact as the filter believes it, metres (T2 table 4.1).
    sigma: float = 0.01
    # Artificial motion per contact, rad and m per axis (Q of T2 table 4.1).
    motion_angle: float = 0.01
    motion_distance: float = 0.0032
    # Layers of the annealed filter; motion and tempering of the first one: rad, shares of the radius, sigmas.
    layers: int = 24
    first_angle: float = 0.5
    first_share: float = 0.25
    first_temper: float = 400.0
    # First centroid: standard deviation around the first contact, metres (P_0).
    start_distance: float = 0.2


def _start(
    model: ObjectModel, around: Array, prior: Prior | None, settings: ParticleFilterSettings, rng: np.random.Generator
) -> Array:
    n = settings.particles
    if prior is not None:
        return from_prior(model, prior, n, rng)
    rotations = se3.random_rotations(n, rng)
    middles = around + settings.start_distance * rng.normal(size=(n, 3))
    return se3.make_poses(rotations, middles - rotations @ model.centroid)


def _moved(model: ObjectModel, particles: Array, angle: float, distance: float, rng: np.random.Generator) -> Array:
    delta = rng.normal(size=(len(particles), 6)) * ([angle] * 3 + [distance] * 3)
    return se3.perturb(particles, delta, model.centroid)


def plain(
    model: ObjectModel,
    contacts: Contacts,
    seed: int = 0,
    prior: Prior | None = None,
    extra: Evidence | None = None,
    settings: ParticleFilterSettings | None = None,
) -> Localization:
    """Localise by the bootstrap particle filter, contacts in their order; see touch.localization."""
    settings = settings or ParticleFilterSettings()
    model.field  # noqa: B018  (building the lattice is not part of the search's time)
    begin = time.perf_counter()
    rng = np.random.default_rng(seed)
    rows = tables.from_contacts(contacts).with_sigma(settings.sigma, tables.TOUCH)
    particles = _start(model, contacts.points[0], prior, settings, rng)
    for n in range(len(contacts)):
        particles = _moved(model, particles, settings.motion_angle, settings.motion_distance, rng)
        cost = costs(model, rows.take([n]), particles)
        if extra is not None and n == 0:
            cost = cost + costs(model, extra, particles)
        particles = particles[systematic(-cost, len(particles), rng)]
    final = costs(model, rows, particles)
    pose = particles[int(np.argmin(final))]
    return localization(model, contacts, pose, particles, settings.sigma, begin, "particle-filter", prior, extra)


def annealed(
    model: ObjectModel,
    contacts: Contacts,
    seed: int = 0,
    prior: Prior | None = None,
    extra: Evidence | None = None,
    settings: ParticleFilterSettings | None = None,
) -> Localization:
    """Localise by the annealed particle filter, all contacts at once; see touch.localization."""
    settings = settings or ParticleFilterSettings()
    model.field  # noqa: B018  (building the lattice is not part of the search's time)
    begin = time.perf_counter()
    rng = np.random.default_rng(seed)
    rows = tables.from_contacts(contacts).with_sigma(settings.sigma, tables.TOUCH)
    if extra is not None:
        rows = tables.stack(rows, extra)
    particles = _start(model, contacts.points.mean(axis=0), prior, settings, rng)
    cost = costs(model, rows, particles, prior)
    best, lowest = particles[int(np.argmin(cost))], float(cost.min())
    for layer in range(settings.layers):
        # geometric schedules: tempering falls to 1, motion with its root, as a posterior's width does
        temper = settings.first_temper ** (1.0 - (layer + 1) / settings.layers)
        share = np.sqrt(temper / settings.first_temper)
        particles = particles[systematic(-cost / temper, len(particles), rng)]
        angle, distance = settings.first_angle * share, settings.first_share * model.radius * share
        particles = _moved(model, particles, float(angle), float(distance), rng)
        cost = costs(model, rows, particles, prior)
        if cost.min() < lowest:
            best, lowest = particles[int(np.argmin(cost))], float(cost.min())
    return localization(
        model, contacts, best, particles, settings.sigma, begin, "annealed-particle-filter", prior, extra
    )
