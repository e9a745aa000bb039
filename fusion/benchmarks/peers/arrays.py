"""Tactile arrays: the costs and searches of T1 chapter 5 and ours, from its starts, each at several budgets.

Grasps, recordings and starts are those of `bench arrays` (up to 20 degrees and 10 mm off per axis). The published
searches look in the box that starts are drawn in; ours is told its width as a Gaussian. Errors are displacements of the
centroid modulo symmetry (mm); a success is 1 cm and 15 degrees. There is no Cramér-Rao bound: what limits these
answers is how pads are placed, which no row of evidence tells.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.arrays.grasps import GRASPS, recordings
from fusion.benchmarks.contacts.trials import errors, is_close
from fusion.benchmarks.peers.pareto import Method, swept
from scenes.evidence.align import Prior
from scenes.geometry import poses as se3
from scenes.synthesis import library
from touch.arrays.costs import COSTS, ArrayProblem
from touch.arrays.searches import SEARCHES, Box, PressureSettings, localize_arrays, minimise

Array = NDArray[np.float64]

# As in `bench arrays`: half width of the box of starts (rad, m).
ANGLE, DISTANCE = float(np.deg2rad(20.0)), 0.010
NAMES = {"covariance": "covariance (T1)", "distance": "distance only (T1)", "forward": "pressures (ours)"}


@dataclass(frozen=True)
class Case:
    """A recording of a grasp: problem, truth and start (4, 4)."""

    grasp: str
    problem: ArrayProblem
    truth: Array
    start: Array


Peer = Method[Case, Array]


def cases(count: int, seed: int) -> list[Case]:
    """`count` recordings of each grasp, a start each."""
    out = []
    for name, (thing, _, _) in GRASPS.items():
        model = library.make(thing)
        for i, (truth, readings) in enumerate(recordings(name, count, [seed, 31])):
            rng = np.random.default_rng([seed, 41, ord(name), i])
            offset = rng.uniform(-1.0, 1.0, 6) * ([ANGLE] * 3 + [DISTANCE] * 3)
            out.append(Case(name, ArrayProblem(model, readings), truth, se3.perturb(truth, offset, model.centroid)))
    return out


def peers(quick: bool = False) -> Sequence[Peer]:
    """Every cost by DIRECT, T1's by every search, and ours, at their budgets; when in a hurry the smallest of each."""
    ways = [(cost, "direct") for cost in COSTS] + [("covariance", name) for name in SEARCHES if name != "direct"]
    searched = [_searched(*way, evaluations) for way in ways for evaluations in (200, 1000, 4000, 16_000)]
    return swept([*_ours(), *searched], quick)


def _ours() -> Iterator[Peer]:
    for draws, finished, steps in ((4, 1, 5), (15, 4, 8), (60, 12, 15), (60, 24, 15), (240, 60, 20)):
        usual = PressureSettings()
        local = replace(usual.localize, draws=draws)
        settings = replace(usual, localize=local, finished=finished, steps=steps)
        yield Method(
            "rows, then pressures (ours)",
            f"{draws} starts, {finished} finished",
            lambda case, seed, settings=settings: (  # type: ignore[misc]
                localize_arrays(case.problem, seed, _prior(case.start), settings).pose
            ),
        )


def _prior(start: Array) -> Prior:
    """A Gaussian as wide as the box that a start is drawn from."""
    return Prior.isotropic(start, ANGLE / np.sqrt(3.0), DISTANCE / np.sqrt(3.0))


def _searched(cost: str, search: str, evaluations: int) -> Peer:
    def solve(case: Case, seed: int) -> Array:
        return minimise(case.problem, Box.around(case.start, ANGLE, DISTANCE), cost, search, evaluations, seed).pose

    return Method(f"{NAMES[cost]}, {search}", f"{evaluations} evaluations", solve)


def judged(case: Case, pose: Array) -> tuple[float, bool]:
    """Displacement (mm) and success."""
    error = errors(case.problem.model, pose, case.truth)
    return 1e3 * error[1], is_close(error)
