"""Peers on contacts alone, no start: scipy's global optimisers on the compiled cost, chsel, and the default search.

Trials are those of `bench global`: contacts scattered over the object, 0.9 mm and 5 degrees of noise. The optimisers of
scipy search the box of T1 (rotation vectors, positions about the contacts' mean) for the compiled cost of eq. 4.1, and
their best point is polished as in `touch.searches`. chsel gets the contacts as surface points and, since it has no
normals, a point of free space 1 cm outside each. Errors are displacements of the centroid modulo symmetry (mm); a
success is T1's (1 cm, 15 degrees).
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.contacts import trials as contact_trials
from fusion.benchmarks.contacts.trials import Trial
from fusion.benchmarks.peers.pareto import Method, Point, least_error, measure, swept
from scenes.evidence import table as evidence
from scenes.evidence.align import terms
from scenes.evidence.modes import covariance_of
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from scenes.synthesis import library
from touch.answers import LocalizeSettings
from touch.localization import localize
from touch.multistart import refine_contacts
from touch.published.optimisers.direct import BoxSettings, objective

Array = NDArray[np.float64]
Search = Callable[[ObjectModel, Contacts, int], Array]
Case = tuple[ObjectModel, Trial]
Peer = Method[Case, Array]

OBJECTS = ("drill", "mug", "l_block")
CONTACTS = 12
# Trials of a method that takes seconds, and of one that takes minutes.
SLOW, SLOWEST = 6, 3
NOISE = "0.9 mm, 5°"
# How far outside a contact chsel is told of free space (m), transforms it keeps, and its lattice (m).
FREE_AWAY, CHSEL_BATCH, CHSEL_RESOLUTION = 0.01, 30, 0.003


def missing() -> dict[str, str]:
    """Peers that this installation does not have, and how to get them."""
    if find_spec("chsel") is None:
        return {"chsel": "not installed (pip install chsel, which brings PyTorch and its own Open3D)"}
    return {}


def peers(quick: bool = False) -> Sequence[Peer]:
    """Every method at its budgets; when in a hurry the smallest of each."""
    found = [*_ours(), *_published(), *_scipy()]
    if not missing():
        found += [_peer("chsel", f"{n} iterations", _chsel(n), SLOWEST) for n in (1, 3)]
    return swept(found, quick)


def _peer(name: str, budget: str, search: Search, most: int | None = None) -> Peer:
    return Method(name, budget, lambda case, seed: search(case[0], case[1].contacts, seed), most)


def _ours() -> Iterator[Peer]:
    def search(settings: LocalizeSettings) -> Search:
        return lambda model, contacts, seed: localize(model, contacts, seed, settings=settings).pose

    usual = LocalizeSettings(drawn=False)  # no other method says how sure it is
    for share in (0.03, 0.1, 0.3, 1.0, 3.0):
        settings = replace(
            usual,
            hypotheses=max(1000, round(usual.hypotheses * share)),
            ranked=max(20, round(usual.ranked * share)),
            budget_ranked=max(1000, round(usual.budget_ranked * share)),
            budget_rank=max(3000, round(usual.budget_rank * share)),
        )
        yield _peer("palpate", f"{settings.ranked} refined", search(settings))


def _published() -> Iterator[Peer]:
    """Of the theses: the Monte-Carlo search of T1 (its best poses polished) and, without normals, the MUPF of T2."""
    from touch.published.optimisers.monte_carlo import MonteCarloSettings
    from touch.published.optimisers.monte_carlo import search as evolved
    from touch.published.particles import memory_unscented_particle_filter as unscented

    def monte_carlo(runs: int) -> Search:
        settings = replace(MonteCarloSettings.global_search(), runs=runs)

        def search(model: ObjectModel, contacts: Contacts, seed: int) -> Array:
            found, _, _ = evolved(model, contacts, seed, settings=settings)
            polished = refine_contacts(model, contacts, found)
            return polished.poses[int(np.argmin(polished.costs))]

        return search

    def mupf(particles: int) -> Search:
        settings = unscented.UnscentedSettings(particles=particles)
        return lambda model, contacts, seed: unscented.localize(model, contacts, seed, settings=settings).pose

    for runs in (1, 4):
        yield _peer("Monte-Carlo (T1)", f"{runs} runs", monte_carlo(runs), SLOW)
    for particles in (200, 700, 3000):
        yield _peer("MUPF (T2)", f"{particles} particles", mupf(particles))


def _scipy() -> Iterator[Peer]:
    for evaluations in (1_000, 10_000, 40_000):
        settings = BoxSettings(evaluations=evaluations)
        yield _peer("scipy direct", f"{evaluations} evaluations", _optimised(_direct, settings))
        yield _peer("scipy dual_annealing", f"{evaluations} evaluations", _optimised(_annealing, settings))
        yield _peer("scipy basinhopping", f"{evaluations} evaluations", _optimised(_basinhopping, settings))


Cost = Callable[[Array], float]
Bounds = list[tuple[float, float]]


def _optimised(optimise: Callable[[Cost, Bounds, int, BoxSettings], Array], settings: BoxSettings) -> Search:
    def search(model: ObjectModel, contacts: Contacts, seed: int) -> Array:
        cost, bounds, pose = objective(model, contacts, None, settings)
        best = optimise(cost, bounds, seed, settings)
        return refine_contacts(model, contacts, pose(best)[None]).poses[0]

    return search


def _direct(cost: Cost, bounds: Bounds, seed: int, settings: BoxSettings) -> Array:
    from scipy.optimize import direct

    work = settings.evaluations
    return np.asarray(direct(cost, bounds, maxfun=work, maxiter=work, vol_tol=0.0, locally_biased=False).x)


def _annealing(cost: Cost, bounds: Bounds, seed: int, settings: BoxSettings) -> Array:
    from scipy.optimize import dual_annealing

    rng = np.random.default_rng(seed)
    work = settings.evaluations
    # its local search (L-BFGS-B) on: the published rows of `palpate localize --method annealing` go without
    return np.asarray(dual_annealing(cost, bounds, maxfun=work, maxiter=work, rng=rng).x)


class _Spent(Exception):
    """The evaluations are used up."""


def _basinhopping(cost: Cost, bounds: Bounds, seed: int, settings: BoxSettings) -> Array:
    """Wales and Doye 1997; a step is a draw anywhere in the box, a minimiser L-BFGS-B; stopped by its evaluations."""
    from scipy.optimize import basinhopping

    rng = np.random.default_rng(seed)
    low, high = np.array(bounds).T
    best: tuple[float, Array] = (np.inf, 0.5 * (low + high))
    used = 0

    def counted(x: Array) -> float:
        nonlocal best, used
        used += 1
        if used > settings.evaluations:
            raise _Spent
        value = cost(x)
        if value < best[0]:
            best = value, np.array(x)
        return value

    minimiser = {"method": "L-BFGS-B", "bounds": bounds, "options": {"maxfun": 200}}
    with suppress(_Spent):
        basinhopping(
            counted,
            best[1],
            niter=settings.evaluations,
            minimizer_kwargs=minimiser,
            take_step=lambda x: rng.uniform(low, high),
            rng=rng,
        )
    return best[1]


# ---- chsel


@cache
def _chsel_field(model: ObjectModel) -> Any:
    """The distance lattice that chsel makes of the mesh."""
    import pytorch_volumetric
    import trimesh

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "object.obj"
        trimesh.Trimesh(model.vertices, model.faces, process=False).export(path)
        mesh = pytorch_volumetric.MeshObjectFactory(str(path))
        exact = pytorch_volumetric.MeshSDF(mesh)
        box = mesh.bounding_box(padding=0.1)
        return pytorch_volumetric.CachedSDF(
            model.name, CHSEL_RESOLUTION, box, exact, cache_path=str(Path(folder) / "cache.pkl")
        )


def _chsel(iterations: int) -> Search:
    def search(model: ObjectModel, contacts: Contacts, seed: int) -> Array:
        import chsel
        import torch

        torch.set_num_threads(1)
        torch.manual_seed(seed)
        rng = np.random.default_rng(seed)
        free = contacts.points + FREE_AWAY * contacts.normals
        starts = se3.make_poses(
            se3.random_rotations(CHSEL_BATCH, rng),
            contacts.points.mean(axis=0) + rng.normal(size=(CHSEL_BATCH, 3)) * 0.3 * model.radius,
        )
        # its transforms take the world to the object
        initial = torch.tensor(se3.inverse(starts), dtype=torch.float32)
        # one of its classes a point: on the surface, or free
        kinds = [chsel.SemanticsClass.SURFACE] * len(contacts) + [chsel.SemanticsClass.FREE] * len(contacts)
        registration = chsel.CHSEL(
            _chsel_field(model),
            positions=torch.tensor(np.concatenate([contacts.points, free]), dtype=torch.float32),
            semantics=torch.tensor([kind.value for kind in kinds]),
        )
        found, _ = registration.register(iterations=iterations, batch=CHSEL_BATCH, initial_tsf=initial)
        object_from_world = chsel.solution_to_world_to_link_matrix(found).numpy().astype(np.float64)
        best = object_from_world[int(np.argmin(np.asarray(found.rmse)))]
        rotation = se3.nearest_rotation(best[None, :3, :3])[0]
        return se3.inverse(se3.make_pose(rotation, best[:3, 3]))

    return search


def trials(count: int, seed: int) -> list[Case]:
    """`count` trials of each object, in an order that mixes them."""
    noise = contact_trials.NOISES[NOISE]
    each = [
        [(model, trial) for trial in contact_trials.trials(model, CONTACTS, noise, count, seed)]
        for model in map(library.make, OBJECTS)
    ]
    return [case for cases in zip(*each, strict=True) for case in cases]


def front(
    chosen: Sequence[Peer], done_on: Sequence[Case], seed: int, progress: Callable[..., Iterator[Any]], what: str
) -> list[Point]:
    """Every peer on every trial."""
    for model, _ in done_on:
        model.field  # noqa: B018

    def judged(case: Case, pose: Array) -> tuple[float, bool]:
        error = contact_trials.errors(case[0], pose, case[1].truth)
        return 1e3 * error[1], contact_trials.is_close(error)

    return measure(chosen, done_on, lambda case: case[0].name, judged, seed, progress, what)


def bound_mm(done_on: Sequence[Case], with_start: bool = False) -> float:
    """Median displacement (mm) of the centroid that no unbiased method can be below: Cramér-Rao, of the contacts and,
    when asked for, of what the start tells.
    """
    covariances = []
    for model, trial in done_on:
        information = terms(model, evidence.from_contacts(trial.contacts), trial.truth)[2]
        if with_start:
            information = information + contact_trials.start_prior(trial.start).information
        covariances.append(covariance_of(model, information))
    return least_error(covariances, lambda case, delta: np.linalg.norm(delta[:, 3:], axis=1))
