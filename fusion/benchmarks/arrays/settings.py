"""What decides whether covariance matching orders poses better than distance: the sensing height, the pads' errors,
what the descriptor weighs, how the distance is measured, and how long DIRECT searches.

T1 gives no values for its parameters. It says that pads have 24 taxels, that an evaluation took 0.5 ms and a search
9.06 s, and shows a finger that is visibly not where its joints say.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.arrays.grasps import GRASPS, GraspNoise, hold, recordings
from fusion.benchmarks.contacts.trials import errors
from fusion.benchmarks.printing.tables import BenchSettings, Column, Report, Table
from scenes.geometry import poses as se3
from touch.arrays.cloud import CloudSettings, surface_cloud
from touch.arrays.costs import ArrayProblem, MatchingSettings
from touch.arrays.descriptor import describe
from touch.arrays.searches import Box, minimise

Array = NDArray[np.float64]

# Recordings of a grasp, and poses about the truth of each.
RECORDINGS, POSES = 5, 400
# DIRECT as long as T1's: 9.06 s at 0.5 ms each; starts of each of two recordings.
LONG, STARTS = 18_000, 10
# Visibly off, as a finger in T1's figure 5.9.
ROUGH = GraspNoise(turn=float(np.deg2rad(4.0)), move=0.004)
# A cloud as depth cameras gave them, and taxels where the skin would be if it were hard.
COARSE = CloudSettings(area=0.005**2, fewest=100)


@dataclass(frozen=True)
class Variant:
    """What differs from the settings of the other tables."""

    name: str
    matching: MatchingSettings
    noise: GraspNoise
    power: float = 0.0
    to_cloud: bool = False


USUAL = MatchingSettings()
VARIANTS = (
    Variant("as in the tables above", USUAL, GraspNoise()),
    Variant("sensing height 2 mm, the layer's", replace(USUAL, height=0.002), GraspNoise()),
    Variant("sensing height 5 mm", replace(USUAL, height=0.005), GraspNoise()),
    Variant("taxels weighed by pressure²", USUAL, GraspNoise(), power=2.0),
    Variant("distance from the hard skin to the points of a 5 mm cloud", USUAL, GraspNoise(), to_cloud=True),
    Variant("pads where their joints say", USUAL, GraspNoise(turn=0.0, move=0.0)),
    Variant("pads 4° and 4 mm off", USUAL, ROUGH),
)


def add_settings(report: Report, settings: BenchSettings, half: Array, rhos: Callable[[Array, Array], Array]) -> None:
    """The table. half (6,): half widths of the box of starts; rhos: costs (n,) and errors (n, 2) to (2,)."""
    columns = [Column("setting"), Column("over"), Column("covariance: mean rho"), Column("distance: mean rho")]
    columns += [Column("covariance above (angle)", 0), Column("above (position)", 0)]
    table = Table("What decides between covariance and distance: rho of cost against error", columns)
    table.note = (
        f"Poses: {POSES} drawn about the truth of each of {RECORDINGS} recordings, mean over angle, position and six"
        f" grasps. Results: ends of DIRECT after {LONG} evaluations (T1's 9.06 s), two recordings, {STARTS} starts"
        " each; all starts then end in nearly one pose, whose error is the recording's, and rho orders what is left."
    )
    count = settings.count(RECORDINGS, 2)
    for variant in VARIANTS:
        both = _over_poses(variant, count, half, settings, rhos)
        table.add(variant.name, "poses", *both.mean(axis=(1, 2)), *_above(both))
    both = _over_results(settings, half, rhos)
    table.add("DIRECT as long as T1's", "results", *np.nanmean(both, axis=(1, 2)), *_above(both))
    report.tables.append(table)
    settings.show(table)


def _above(rho: Array) -> tuple[int, int]:
    """On how many grasps covariance is above distance: of rho (2, grasps, 2)."""
    angle, position = (rho[0] > rho[1]).sum(axis=0)
    return int(angle), int(position)


def _over_poses(
    variant: Variant,
    count: int,
    half: Array,
    settings: BenchSettings,
    rhos: Callable[[Array, Array], Array],
) -> Array:
    out = np.zeros((2, len(GRASPS), 2))
    for g, name in enumerate(settings.progress(GRASPS, len(GRASPS), variant.name)):
        model = hold(name).model
        for r, (truth, readings) in enumerate(recordings(name, count, [settings.seed, 31], variant.noise)):
            rng = np.random.default_rng([settings.seed, 36, g, r])
            spread = rng.uniform(-1.0, 1.0, (POSES, 6)) * half * rng.random((POSES, 1))
            places = se3.perturb(truth, spread, model.centroid)
            off = np.array([errors(model, place, truth) for place in places])
            problem = ArrayProblem(model, readings, variant.matching)
            if variant.power > 0:
                problem.descriptors = tuple(describe(one, None, variant.power) for one in problem.touching)
            far = _to_cloud(problem, places) if variant.to_cloud else problem.distance(places)
            out[0, g] += rhos(problem.covariance(places), off) / count
            out[1, g] += rhos(far, off) / count
    return out


def _over_results(settings: BenchSettings, half: Array, rhos: Callable[[Array, Array], Array]) -> Array:
    out = np.zeros((2, len(GRASPS), 2))
    starts, evaluations = settings.count(STARTS, 3), 500 if settings.quick else LONG
    for g, name in enumerate(settings.progress(GRASPS, len(GRASPS), "long searches")):
        model = hold(name).model
        found: list[list[Array]] = [[], []]
        for r, (truth, readings) in enumerate(recordings(name, 2, [settings.seed, 31])):
            problem = ArrayProblem(model, readings)
            rng = np.random.default_rng([settings.seed, 37, g, r])
            begins = [se3.perturb(truth, rng.uniform(-1.0, 1.0, 6) * half, model.centroid) for _ in range(starts)]
            for c, cost in enumerate(("covariance", "distance")):
                ends = [minimise(problem, Box(begin, half), cost, "direct", evaluations) for begin in begins]
                off = np.array([errors(model, end.pose, truth) for end in ends])
                found[c].append(rhos(np.array([end.cost for end in ends]), off))
        for c in range(2):
            out[c, g] = np.nanmean(found[c], axis=0)
    return out


def _to_cloud(problem: ArrayProblem, places: Array) -> Array:
    """T1 algorithm 5.3 to the nearest point of a coarse cloud, from taxels whose skin does not give."""
    from scipy.spatial import cKDTree

    tree = cKDTree(surface_cloud(problem.model, COARSE).points)
    out = np.zeros(len(places))
    for one in problem.touching:
        felt = one.taxels[one.active, :3]
        local = np.concatenate([se3.apply(se3.inverse(place), felt) for place in places])
        out += (tree.query(local)[0] ** 2).reshape(len(places), -1).mean(axis=1)
    return out
