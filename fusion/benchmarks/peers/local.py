"""Peers on five contacts and a coarse start: the start of T1 section 4.3.1.1 mended by every local method.

Trials are those of `bench local` on its complex object. The default and scipy's DIRECT are told how far off the start
may be (a Gaussian, a box of three of its standard deviations); the published local methods only where it is. Errors are
displacements of the centroid modulo symmetry (mm); a success is T1's (1 cm, 15 degrees).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.contacts import trials as contact_trials
from fusion.benchmarks.contacts.local import COMPLEX
from fusion.benchmarks.contacts.trials import Trial, start_prior
from fusion.benchmarks.peers.contacts import NOISE, Case, Peer
from fusion.benchmarks.peers.pareto import Method, swept
from scenes.geometry.objects import ObjectModel
from scenes.synthesis import library
from touch.answers import LocalizeSettings
from touch.localization import localize
from touch.multistart import refine_contacts

Array = NDArray[np.float64]
Refine = Callable[[ObjectModel, Trial, int], Array]

CONTACTS = 5


def trials(count: int, seed: int) -> list[Case]:
    """`count` trials with their starts."""
    model = library.make(COMPLEX)
    return [(model, one) for one in contact_trials.trials(model, CONTACTS, contact_trials.NOISES[NOISE], count, seed)]


def peers(quick: bool = False) -> Sequence[Peer]:
    """Every method at its budgets; when in a hurry the smallest of each."""
    return swept([*_ours(), *_gradients(), *_searches()], quick)


def _peer(name: str, budget: str, refine: Refine) -> Peer:
    return Method(name, budget, lambda case, seed: refine(*case, seed))


def _ours() -> Iterator[Peer]:
    def refine(settings: LocalizeSettings) -> Refine:
        return lambda model, trial, seed: (
            localize(model, trial.contacts, seed, prior=start_prior(trial.start), settings=settings).pose
        )

    for draws in (1, 4, 15, 60, 240):
        yield _peer("palpate", f"{draws} starts", refine(replace(LocalizeSettings(), draws=draws, drawn=False)))
    yield _peer(
        "analytic LM, one start",
        "at most 62 steps",
        lambda model, trial, seed: refine_contacts(model, trial.contacts, trial.start[None]).poses[0],
    )


def _gradients() -> Iterator[Peer]:
    from touch.published import contact_icp
    from touch.published.optimisers import gradient_descent, levenberg_marquardt

    def descent(steps: int) -> Refine:
        settings = gradient_descent.GradientDescentSettings(iterations=steps)
        return lambda model, trial, seed: gradient_descent.refine(model, trial.contacts, trial.start, seed, settings)[0]

    def marquardt(steps: int) -> Refine:
        settings = levenberg_marquardt.LevenbergMarquardtSettings(iterations=steps)
        return lambda model, trial, seed: levenberg_marquardt.refine(
            model, trial.contacts, trial.start, seed, settings
        )[0]

    def closest(steps: int) -> Refine:
        settings = contact_icp.ContactIcpSettings(iterations=steps)
        return lambda model, trial, seed: contact_icp.refine(model, trial.contacts.points, trial.start, settings)[0]

    for steps in (5, 20, 200):
        yield _peer("gradient descent (T1)", f"{steps} steps", descent(steps))
        yield _peer("Levenberg-Marquardt (T1)", f"{steps} steps", marquardt(steps))
        yield _peer("ICP of the contacts", f"{steps} steps", closest(steps))


def _searches() -> Iterator[Peer]:
    from scipy.optimize import direct

    from touch.published.optimisers.direct import BoxSettings, objective
    from touch.published.optimisers.monte_carlo import MonteCarloSettings
    from touch.published.optimisers.monte_carlo import search as evolved

    def monte_carlo(runs: int, particles: int) -> Refine:
        usual = MonteCarloSettings.correction()
        initial = min(usual.initial, particles // 4)
        settings = replace(usual, runs=runs, particles=particles, initial=initial)

        def refine(model: ObjectModel, trial: Trial, seed: int) -> Array:
            found, _, _ = evolved(model, trial.contacts, seed, trial.start, settings=settings)
            polished = refine_contacts(model, trial.contacts, found)
            return polished.poses[int(np.argmin(polished.costs))]

        return refine

    def boxed(evaluations: int) -> Refine:
        settings = BoxSettings(evaluations=evaluations)

        def refine(model: ObjectModel, trial: Trial, seed: int) -> Array:
            cost, bounds, pose = objective(model, trial.contacts, start_prior(trial.start), settings)
            best = direct(cost, bounds, maxfun=evaluations, maxiter=evaluations, vol_tol=0.0, locally_biased=True).x
            return refine_contacts(model, trial.contacts, pose(best)[None]).poses[0]

        return refine

    for runs, particles in ((1, 2000), (1, 15_000), (4, 15_000)):
        yield _peer("Monte-Carlo (T1)", f"{runs} x {particles} particles", monte_carlo(runs, particles))
    for evaluations in (300, 1000, 10_000):
        yield _peer("scipy direct", f"{evaluations} evaluations", boxed(evaluations))
