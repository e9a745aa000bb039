"""Filters on recorded contacts: MUPF, UPF, Scaling Series, particle filters, ICP and the default, at several budgets.

The sets are those of `bench filters`. They have no true pose: the error is the mean distance of the contacts to the
surface (the index of T2) above the lowest that any method of this run reached on that set, and a success is within 5 mm
of it. So there is no Cramér-Rao bound either.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.contacts.filters import SUCCESS
from fusion.benchmarks.contacts.sets import SETS, read_set
from fusion.benchmarks.peers.pareto import Method, Point, measure, swept
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from touch.answers import Localization, LocalizeSettings
from touch.localization import localize

Array = NDArray[np.float64]
Search = Callable[[ObjectModel, Contacts, int], Localization]

# An error below this is drawn there (mm): a logarithmic axis has no zero.
LEAST = 0.001


@dataclass(frozen=True)
class Case:
    """A recorded set, and the seed of a trial on it."""

    name: str
    model: ObjectModel
    contacts: Contacts
    trial: int


Peer = Method[Case, Localization]


def cases(count: int, quick: bool = False) -> list[Case]:
    """`count` trials of each set; of two sets when in a hurry. Raises InputError when the sets are not there."""
    sets = [(one.name, *read_set(one)) for one in (SETS[:2] if quick else SETS)]
    return [Case(*one, trial) for trial in range(count) for one in sets]


def peers(quick: bool = False) -> Sequence[Peer]:
    """Every filter at its budgets; when in a hurry the smallest of each."""
    return swept([*_ours(), *_unscented(), *_others()], quick)


def _peer(name: str, budget: str, search: Search) -> Peer:
    return Method(name, budget, lambda case, seed: search(case.model, case.contacts, seed + case.trial))


def _ours() -> Iterator[Peer]:
    for starts in (100, 300, 1000, 3000):
        settings = replace(LocalizeSettings(), starts=starts, drawn=False)  # no other says how sure it is
        yield _peer(
            "palpate",
            f"{starts} starts",
            lambda model, contacts, seed, settings=settings: (  # type: ignore[misc]
                localize(model, contacts, seed, settings=settings)
            ),
        )


def _unscented() -> Iterator[Peer]:
    from touch.published.particles import memory_unscented_particle_filter as unscented

    for name, window in (("MUPF (T2)", None), ("UPF", 1)):
        for particles in (100, 300, 700, 2000):
            settings = unscented.UnscentedSettings(particles=particles, window=window)
            yield _peer(
                name,
                f"{particles} particles",
                lambda model, contacts, seed, settings=settings: (  # type: ignore[misc]
                    unscented.localize(model, contacts, seed, settings=settings)
                ),
            )


def _others() -> Iterator[Peer]:
    from touch.published import contact_icp
    from touch.published.particles import particle_filters, scaling_series

    for most in (1000, 8000):
        scaling = scaling_series.ScalingSettings(fewest=most // 2, most=most)
        yield _peer(
            "Scaling Series",
            f"{most} particles",
            lambda model, contacts, seed, scaling=scaling: (  # type: ignore[misc]
                scaling_series.localize(model, contacts, seed, settings=scaling)
            ),
        )
    for name, run in (("particle filter", particle_filters.plain), ("annealed filter", particle_filters.annealed)):
        for particles in (500, 5000):
            layers = particle_filters.ParticleFilterSettings(particles=particles)
            yield _peer(
                name,
                f"{particles} particles",
                lambda model, contacts, seed, run=run, layers=layers: (  # type: ignore[misc]
                    run(model, contacts, seed, settings=layers)
                ),
            )
    for steps in (10, 100):
        closest = contact_icp.ContactIcpSettings(iterations=steps)
        yield _peer(
            "ICP of the contacts",
            f"{steps} steps",
            lambda model, contacts, seed, closest=closest: (  # type: ignore[misc]
                contact_icp.localize(model, contacts, seed, settings=closest)
            ),
        )


def front(
    chosen: Sequence[Peer], done_on: Sequence[Case], seed: int, progress: Callable[..., Iterator[object]], what: str
) -> list[Point]:
    """Every filter on every trial; errors above each set's floor, which is known when all are done."""
    points = measure(
        chosen, done_on, lambda case: case.name, lambda case, found: (1e3 * found.index, True), seed, progress, what
    )
    names = np.array([case.name for case in done_on])
    index = np.array([point.error for point in points])
    floors = {name: float(index[:, names == name].min()) for name in set(names)}
    floor = np.array([floors[name] for name in names])
    return [
        replace(point, error=np.maximum(above, LEAST), success=above <= 1e3 * SUCCESS)
        for point, above in zip(points, index - floor, strict=True)
    ]
