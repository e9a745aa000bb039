"""Peers on contacts alone, no start: scipy's global optimisers on the compiled cost, chsel, and the default search.

Trials are those of `bench global`: contacts scattered over the object, 0.9 mm and 5 degrees of noise. The optimisers of
scipy search the box of T1 (rotation vectors, positions about the contacts' mean) for the compiled cost of eq. 4.1, and
their best point is polished as in `touch.searches`. chsel gets the contacts as surface points and, since it has no
normals, a point of free space 1 cm outside each. Errors are displacements of the centroid modulo symmetry (mm); a
success is T1's (1 cm, 15 degrees).
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks import contact_trials
from fusion.benchmarks.contact_trials import Trial
from fusion.benchmarks.pareto import Point
from scenes import library
from scenes import poses as se3
from scenes.frames import Contacts
from scenes.objects import ObjectModel
from touch.localize import LocalizeSettings, localize, refine_contacts
from touch.searches.direct import BoxSettings, objective

Array = NDArray[np.float64]
Search = Callable[[ObjectModel, Contacts, int], Array]

OBJECTS = ("drill", "mug", "l_block")
CONTACTS = 12
NOISE = "0.9 mm, 5°"
# How far outside a contact chsel is told of free space (m), transforms it keeps, and its lattice (m).
FREE_AWAY, CHSEL_BATCH, CHSEL_RESOLUTION = 0.01, 30, 0.003


@dataclass(frozen=True)
class Peer:
    """A method at one budget."""

    method: str
    budget: str
    search: Search


def missing() -> dict[str, str]:
    """Peers that this installation does not have, and how to get them."""
    if find_spec("chsel") is None:
        return {"chsel": "not installed (pip install chsel, which brings PyTorch and its own Open3D)"}
    return {}


def peers(quick: bool) -> list[Peer]:
    """Every method at its budgets; when in a hurry one each."""
    found = [*_ours(), *_scipy()]
    if not missing():
        found += [Peer("chsel", f"{n} iterations", _chsel(n)) for n in (1, 3, 8)]
    if not quick:
        return found
    return list({peer.method: peer for peer in reversed(found)}.values())[::-1]


def _ours() -> Iterator[Peer]:
    def search(settings: LocalizeSettings) -> Search:
        return lambda model, contacts, seed: localize(model, contacts, seed, settings=settings).pose

    usual = LocalizeSettings()
    for share in (0.03, 0.1, 0.3, 1.0, 3.0):
        settings = replace(
            usual,
            hypotheses=max(1000, round(usual.hypotheses * share)),
            ranked=max(20, round(usual.ranked * share)),
            budget_ranked=max(1000, round(usual.budget_ranked * share)),
            budget_rank=max(3000, round(usual.budget_rank * share)),
        )
        yield Peer("palpate", f"{settings.ranked} refined", search(settings))


def _scipy() -> Iterator[Peer]:
    for evaluations in (1_000, 10_000, 40_000):
        settings = BoxSettings(evaluations=evaluations)
        yield Peer("scipy direct", f"{evaluations} evaluations", _optimised(_direct, settings))
        yield Peer("scipy dual_annealing", f"{evaluations} evaluations", _optimised(_annealing, settings))
        yield Peer("scipy basinhopping", f"{evaluations} evaluations", _optimised(_basinhopping, settings))


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

        torch.manual_seed(seed)
        rng = np.random.default_rng(seed)
        free = contacts.points + FREE_AWAY * contacts.normals
        starts = se3.make_poses(
            se3.random_rotations(CHSEL_BATCH, rng),
            contacts.points.mean(axis=0) + rng.normal(size=(CHSEL_BATCH, 3)) * 0.3 * model.radius,
        )
        # its transforms take the world to the object
        initial = torch.tensor(se3.inverse(starts), dtype=torch.float32)
        registration = chsel.CHSEL(
            _chsel_field(model),
            surface_pts=torch.tensor(contacts.points, dtype=torch.float32),
            free_pts=torch.tensor(free, dtype=torch.float32),
        )
        found, _ = registration.register(iterations=iterations, batch=CHSEL_BATCH, initial_tsf=initial)
        object_from_world = chsel.solution_to_world_to_link_matrix(found).numpy().astype(np.float64)
        best = object_from_world[int(np.argmin(np.asarray(found.rmse)))]
        rotation = se3.project_to_rotation(best[None, :3, :3])[0]
        return se3.inverse(se3.make_pose(rotation, best[:3, 3]))

    return search


def trials(count: int, seed: int) -> list[tuple[ObjectModel, Trial]]:
    """`count` trials of each object."""
    noise = contact_trials.NOISES[NOISE]
    return [
        (model, trial)
        for model in map(library.make, OBJECTS)
        for trial in contact_trials.trials(model, CONTACTS, noise, count, seed)
    ]


def measure(
    chosen: Sequence[Peer], done_on: Sequence[tuple[ObjectModel, Trial]], seed: int, progress: Callable[..., Any]
) -> list[Point]:
    """Every peer on every trial; the first on each object twice, to compile and to prepare the object."""
    points = []
    for peer in progress(chosen, len(chosen), "contacts"):
        prepared: set[str] = set()
        ms, errors = [], []
        for model, trial in done_on:
            if model.name not in prepared:
                model.field  # noqa: B018
                peer.search(model, trial.contacts, seed)
                prepared.add(model.name)
            begin = time.perf_counter()
            pose = peer.search(model, trial.contacts, seed)
            ms.append(1e3 * (time.perf_counter() - begin))
            errors.append(contact_trials.errors(model, pose, trial.truth))
        close = np.array([contact_trials.is_close(error) for error in errors])
        points.append(Point(peer.method, peer.budget, np.array(ms), 1e3 * np.array([e[1] for e in errors]), close))
    return points


def bound_mm(done_on: Sequence[tuple[ObjectModel, Trial]]) -> float:
    """Median over the trials of the Cramer-Rao bound of the displacement (mm)."""
    return float(np.median([1e3 * contact_trials.bound(m, trial.contacts, trial.truth)[1] for m, trial in done_on]))
