"""Tactile arrays: T1 chapter 5 again on simulated pads. Angles of principal axes, six grasps by three costs, the
searches of table 5.2, a search of everywhere, and the bottle of figure 5.11. Angles in degrees, lengths in millimetres.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.arrays.angles import add_angles
from fusion.benchmarks.arrays.grasps import GRASPS, hold, recordings
from fusion.benchmarks.arrays.modes import add_modes
from fusion.benchmarks.arrays.settings import add_settings
from fusion.benchmarks.arrays.slip import add_slips
from fusion.benchmarks.contacts.trials import errors, is_close
from fusion.benchmarks.printing.charts import Chart
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Quantile, Rate, Report, Spread, Table
from scenes.evidence.align import Prior
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from touch.arrays.costs import COSTS, ArrayProblem
from touch.arrays.ranking import pattern_costs
from touch.arrays.searches import SEARCHES, Box, PressureSettings, localize_arrays, minimise

Array = NDArray[np.float64]

# T1 section 5.3.2: the start is off by up to this about and along each axis.
ANGLE, DISTANCE = float(np.deg2rad(20.0)), 0.010
# Recordings of a grasp (the object turned, forces and errors drawn anew) that share its trials.
RECORDINGS = 5
# Evaluations of DIRECT for each cost: 4.5 in each direction of the box would be 8,300; most of it need not be cut.
EVALUATIONS = 2000
# Of the published cost where nothing is known of the pose.
EVERYWHERE = 40_000
# Poses drawn about the truth at which all costs are compared, whatever a search makes of them.
POSES = 400
NAMES = {"covariance": "covariance (T1)", "distance": "distance only (T1)", "forward": "pressures (ours)"}
OURS = "rows, then pressures (ours)"
# What ours adds to the pressures of a pose.
SHAPES = PressureSettings().ranking
# T1 table 5.3: rho of angle and of position, covariance and distance.
PUBLISHED_RHO = {
    "a": ((0.70, 0.57), (0.41, 0.31)),
    "b": ((0.42, -0.03), (0.07, -0.04)),
    "c": ((0.71, 0.02), (0.31, -0.38)),
    "d": ((0.56, 0.71), (0.52, 0.40)),
    "e": ((0.63, 0.88), (0.10, 0.22)),
    "f": ((0.80, 0.56), (-0.01, 0.74)),
}


@dataclass
class Tried:
    """One cost or method in one grasp: per recording rows of (cost, rotation rad, position m); times of a search."""

    results: list[list[tuple[float, float, float]]] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    poses_rho: list[Array] = field(default_factory=list)

    def rho(self) -> Array:
        """(2,) Spearman's rho of cost against rotation and position, the mean over recordings."""
        return _mean([_rhos(np.array(r)[:, 0], np.array(r)[:, 1:]) for r in self.results])

    def at_minimum(self) -> Array:
        """(2,) error at the lowest cost of each recording, the mean over recordings."""
        return np.mean([np.array(r)[np.argmin(np.array(r)[:, 0]), 1:] for r in self.results], axis=0)

    def errors(self) -> Array:
        """(n, 2) of all trials."""
        return np.concatenate([np.array(r)[:, 1:] for r in self.results])


def run(settings: BenchSettings) -> Report:
    """All tables of this file."""
    trials = settings.count(100, 10)
    each = max(2, -(-trials // RECORDINGS))
    report = Report(
        "arrays",
        "pose from taxel arrays",
        f"{each * RECORDINGS} trials a grasp ({RECORDINGS} recordings, {each} starts each)",
        settings.seed,
    )
    add_angles(report)
    settings.show(report.tables[-1])
    _add_grasps(report, each, settings)
    add_settings(report, settings, np.repeat([ANGLE, DISTANCE], 3), _rhos)
    _add_searches(report, settings)
    _add_global(report, settings)
    add_modes(report, settings)
    add_slips(report, settings)
    _add_bottle(report, settings)
    return report


def _problems(name: str, seed: int, count: int = RECORDINGS) -> list[tuple[Array, ArrayProblem]]:
    model = hold(name).model
    return [(truth, ArrayProblem(model, readings)) for truth, readings in recordings(name, count, [seed, 31])]


def _start(model: ObjectModel, truth: Array, rng: np.random.Generator) -> Array:
    return se3.perturb(truth, rng.uniform(-1.0, 1.0, 6) * ([ANGLE] * 3 + [DISTANCE] * 3), model.centroid)


def _prior(start: Array) -> Prior:
    """A Gaussian as wide as the box that a start is drawn from."""
    return Prior.isotropic(start, ANGLE / np.sqrt(3.0), DISTANCE / np.sqrt(3.0))


def _try_grasp(name: str, each: int, settings: BenchSettings) -> dict[str, Tried]:
    tried = {key: Tried() for key in (*COSTS, OURS)}
    for r, (truth, problem) in enumerate(_problems(name, settings.seed)):
        model, rng = problem.model, np.random.default_rng([settings.seed, 32, ord(name), r])
        _warm(problem, truth)
        for one in tried.values():
            one.results.append([])
        for i in settings.progress(range(each), each, f"grasp {name}, recording {r + 1}"):
            start = _start(model, truth, rng)
            for cost in COSTS:
                found = minimise(problem, Box.around(start, ANGLE, DISTANCE), cost, "direct", EVALUATIONS)
                _keep(tried[cost], found.cost, errors(model, found.pose, truth), found.seconds, found.cpu)
            ours = localize_arrays(problem, i, _prior(start))
            _keep(tried[OURS], ours.cost, errors(model, ours.pose, truth), ours.seconds, ours.cpu)
        offsets = rng.uniform(-1.0, 1.0, (POSES, 6)) * ([ANGLE] * 3 + [DISTANCE] * 3) * rng.random((POSES, 1))
        places = se3.perturb(truth, offsets, model.centroid)
        off = np.array([errors(model, p, truth) for p in places])
        for cost in COSTS:
            tried[cost].poses_rho.append(_rhos(problem.cost(cost)(places), off))
    return tried


def _keep(one: Tried, cost: float, error: tuple[float, float], seconds: float, cpu: float) -> None:
    one.results[-1].append((cost, *error))
    one.seconds.append(seconds)
    one.cpu.append(cpu)


def _add_grasps(report: Report, each: int, settings: BenchSettings) -> None:
    columns = [Column("grasp"), Column("object"), Column("cost"), Column("rotation °", 1), Column("position mm", 1)]
    columns += [Column("at min cost °", 1), Column("at min mm", 1), Column("rho °"), Column("rho mm")]
    columns += [Column("T1 rho °"), Column("T1 rho mm"), Column("rho poses °"), Column("rho poses mm")]
    columns += [Column("success"), Column("median ms", 1), Column("CPU ms", 1)]
    note = (
        f"Starts up to 20° and 10 mm off per axis; the three costs by the same DIRECT of {EVALUATIONS} evaluations in"
        " that box. Rho: cost of the results against their error, within a recording, mean over recordings (T1 table"
        f" 5.3). Rho poses: the same at {POSES} poses drawn about the truth, no search between. Where all trials end in"
        " one pose rho is that of noise. Errors modulo the object's symmetry; contacts of bottle and cylinder leave"
        " a slide along the axis nearly free. Success: < 15° and < 1 cm. CPU: of all threads."
    )
    table = Table("Six grasps on four objects (T1 table 5.3)", columns, note=note)
    rho: dict[str, list[Array]] = {cost: [] for cost in COSTS}
    poses_rho: dict[str, list[Array]] = {cost: [] for cost in COSTS}
    mean: dict[str, list[Array]] = {key: [] for key in (*COSTS, OURS)}
    slowest = 0.0
    for name, (thing, what, _) in settings.some(list(GRASPS.items()), 2):
        for key, one in _try_grasp(name, each, settings).items():
            off = one.errors()
            found = one.rho()
            if key in rho:
                rho[key].append(found)
                poses_rho[key].append(_mean(one.poses_rho))
            mean[key].append(off.mean(axis=0))
            published = PUBLISHED_RHO[name][COSTS.index(key)] if key in COSTS[:2] else (None, None)
            table.add(
                name, f"{thing}: {what}", NAMES.get(key, key), Spread.of(off[:, 0], 180 / np.pi),
                Spread.of(off[:, 1], 1e3), *(one.at_minimum() * [180 / np.pi, 1e3]), *found, *published,
                *(_mean(one.poses_rho) if key in rho else (None, None)), Rate.of([is_close((a, b)) for a, b in off]),
                Quantile.of(one.seconds, 1e3), Quantile.of(one.cpu, 1e3),
            )  # fmt: skip
            if key == OURS:
                slowest = max(slowest, 1e3 * float(np.median(one.cpu)))
    report.tables.append(table)
    settings.show(table)
    for label, one_rho in (("results", rho), ("poses", poses_rho)):
        _claim_order(report, label, {key: np.array(value) for key, value in one_rho.items()})
    best = sum(
        (mean[OURS][g] <= np.minimum(mean["covariance"][g], mean["distance"][g])).all() for g in range(len(mean[OURS]))
    )
    report.claims += [
        Claim("grasps where ours has the least mean error in rotation and position", float(best), 5.0, True, 0),
        Claim("local, ours: median CPU ms of the slowest grasp", slowest, 100.0, False, 1),
    ]


def _claim_order(report: Report, label: str, rho: dict[str, Array]) -> None:
    both = np.maximum(rho["covariance"], rho["distance"])
    for column, unit in enumerate(("angle", "position")):
        above = float((rho["covariance"][:, column] > rho["distance"][:, column]).sum())
        ours = float((rho["forward"][:, column] > both[:, column]).sum())
        report.claims += [
            Claim(f"rho of {label}, {unit}: grasps with covariance above distance only", above, 5.0, True, 0),
            Claim(f"rho of {label}, {unit}: grasps with pressures above both", ours, 5.0, True, 0),
        ]


def _add_searches(report: Report, settings: BenchSettings) -> None:
    columns = [Column("cost"), Column("search"), Column("average cost", 4), Column("T1 cost", 4)]
    columns += [Column("average ms", 1), Column("CPU ms", 1), Column("T1 s", 1), Column("rotation °", 1)]
    columns += [Column("position mm", 1), Column("evaluations", 0), Column("µs each, CPU", 2)]
    published = {
        ("covariance", "monte-carlo"): (0.1343, 16.49), ("covariance", "direct"): (0.1058, 10.79),
        ("covariance", "annealing"): (0.1308, 38.63), ("distance", "monte-carlo"): (1.2877, 20.71),
        ("distance", "direct"): (1.1102, 9.30), ("distance", "annealing"): (1.1513, 30.78),
    }  # fmt: skip
    table = Table("Searches (T1 table 5.2), with an estimate", columns)
    table.note = (
        f"{EVALUATIONS} evaluations each in a box of 20° and 10 mm about a start drawn in such a box. Costs in metres"
        " (covariance), square millimetres (distance) and natural units (pressures); T1's weights are not known, only"
        " columns of one cost compare. µs each: a batch of poses, no search around it."
    )
    count = settings.count(12, 3)
    for cost in COSTS:
        speed = _speed(settings, cost)
        if cost == "covariance":
            report.claims.append(Claim("published cost: slowest grasp, CPU µs an evaluation", speed, 10.0, False, 2))
        for search in SEARCHES:
            rows = []
            for i in range(count):
                name = list(GRASPS)[i % len(GRASPS)]
                truth, problem = _problems(name, settings.seed, 1)[0]
                rng = np.random.default_rng([settings.seed, 33, i])
                start = _start(problem.model, truth, rng)
                found = minimise(problem, Box.around(start, ANGLE, DISTANCE), cost, search, EVALUATIONS, i)
                error = errors(problem.model, found.pose, truth)
                rows.append((found.cost, found.seconds, found.cpu, *error, found.evaluations))
            mean = np.array(rows).mean(axis=0)
            known = published.get((cost, search), (None, None))
            scale = 1e6 if cost == "distance" else 1.0
            table.add(
                NAMES[cost], search, scale * mean[0], known[0], 1e3 * mean[1], 1e3 * mean[2], known[1],
                np.degrees(mean[3]), 1e3 * mean[4], mean[5], speed,
            )  # fmt: skip
    report.tables.append(table)
    settings.show(table)


def _speed(settings: BenchSettings, cost: str) -> float:
    """CPU microseconds an evaluation, the slowest of the grasps."""
    slowest = 0.0
    for name in GRASPS:
        truth, problem = _problems(name, settings.seed, 1)[0]
        rng = np.random.default_rng([settings.seed, 34])
        places = np.array([_start(problem.model, truth, rng) for _ in range(1000)])
        evaluate = problem.cost(cost)
        evaluate(places)
        taken = []
        for _ in range(3):
            begin = time.process_time()
            evaluate(places)
            taken.append(time.process_time() - begin)
        slowest = max(slowest, 1e6 * min(taken) / len(places))
    return slowest


def _add_global(report: Report, settings: BenchSettings) -> None:
    columns = [Column("grasp"), Column("object"), Column("method"), Column("success"), Column("optimal")]
    columns += [Column("listed"), Column("median ms", 1), Column("CPU ms", 1)]
    table = Table("No estimate at all (T1: up to 60 s)", columns)
    table.note = (
        "Optimal: the answer's cost is at most that of the truth, so the search did its part. Listed: some listed mode"
        f" is within 15° and 1 cm of the truth. Covariance: multi-start of {EVERYWHERE} evaluations over all rotations."
    )
    slowest, count = 0.0, settings.count(20, 2)
    for name, (thing, _, _) in settings.some(list(GRASPS.items()), 2):
        ours, published = [], []
        for i, (truth, problem) in enumerate(_problems(name, settings.seed + 1, count)):
            model, shapes = problem.model, pattern_costs(problem.model, problem.readings, truth[None], SHAPES)
            best = [float(problem.cost(c)(truth[None])[0]) for c in ("forward", "covariance")]
            if not i:
                localize_arrays(problem, 0)  # compiled and tabled before anything is timed
            found = localize_arrays(problem, i)
            off = [errors(model, mode.pose, truth) for mode in found.modes]
            optimal = found.cost <= best[0] + shapes[0] + 1e-6
            ours.append((is_close(off[0]), optimal, any(map(is_close, off)), found.seconds, found.cpu))
            if i < max(3, count // 4):
                one = minimise(problem, _everywhere(problem), "covariance", "multistart", EVERYWHERE, i)
                close = is_close(errors(model, one.pose, truth))
                published.append((close, one.cost <= best[1], close, one.seconds, one.cpu))
        for label, rows in ((OURS, np.array(ours)), (NAMES["covariance"], np.array(published))):
            times = 1e3 * np.median(rows[:, 3:], axis=0)
            table.add(name, thing, label, *(Rate.of(rows[:, k] > 0) for k in range(3)), *times)
            slowest = max(slowest, float(times[1]))
    report.tables.append(table)
    settings.show(table)
    report.claims.append(Claim("global: median CPU ms of the slowest grasp and method", slowest, 1000.0, False, 0))


def _everywhere(problem: ArrayProblem) -> Box:
    """All rotations, the object's centroid within its radius of the arrays' middle."""
    model = problem.model
    middle = np.mean([r.taxels[:, :3].mean(axis=0) for r in problem.readings], axis=0)
    half = np.array([np.pi] * 3 + [model.radius] * 3)
    return Box(se3.make_pose(None, middle - model.centroid), half)


def _add_bottle(report: Report, settings: BenchSettings) -> None:
    """Figure 5.11: costs while the bottle turns about the axis across it and the fingers, the rest kept."""
    truth, problem = _problems("c", settings.seed, 1)[0]
    angles = np.linspace(-57.0, 57.0, 77)
    # the axis between the opposed contacts: about it the points stay where they are, the bottle's axis does not
    axis = truth[:3, :3] @ np.array([1.0, 0.0, 0.0])
    middle = truth[:3, :3] @ [0.0, 0.0, 0.072] + truth[:3, 3]
    turned = se3.perturb(
        np.eye(4), np.concatenate([np.deg2rad(angles)[:, None] * axis, np.zeros((77, 3))], axis=1), middle
    )
    series = {}
    table = Table(
        "Bottle held by opposed, close contacts (T1 figure 5.11)", [Column("cost"), Column("minimum at °", 1)]
    )
    table.note = "Turned from -57 to 57° about the line between finger and palm; the chart shows costs as shares."
    for cost in COSTS:
        values = problem.cost(cost)(turned @ truth)
        low, high = float(values.min()), float(values.max())
        shares = (values - low) / max(high - low, 1e-300)
        series[NAMES[cost]] = [(float(a), float(s)) for a, s in zip(angles, shares)]
        at = float(angles[int(np.argmin(values))])
        table.add(NAMES[cost], at)
        if cost != "distance":
            report.claims.append(Claim(f"bottle: minimum of {NAMES[cost]}, degrees off", abs(at), 5.0, False, 1))
    report.tables.append(table)
    settings.show(table)
    report.charts.append(
        Chart("Bottle: cost over angle", "degrees about the line between the contacts", "share", series)
    )


def _warm(problem: ArrayProblem, pose: Array) -> None:
    """Kernels, cloud, lattice and tables of a problem, so that nothing of it is timed."""
    for cost in COSTS:
        problem.cost(cost)(pose[None])
        minimise(problem, Box.around(pose, ANGLE, DISTANCE), cost, "direct", 10)
    localize_arrays(problem, 0, _prior(pose))


def _rhos(cost: Array, off: Array) -> Array:
    """(2,) Spearman's rho of costs (n,) with both columns of errors (n, 2); NaN where one does not vary."""
    from scipy.stats import spearmanr

    if np.ptp(cost) == 0.0 or len(cost) < 3:
        return np.full(2, np.nan)
    return np.array([spearmanr(cost, column).statistic for column in off.T])


def _mean(values: list[Array]) -> Array:
    """(2,) means of those that are numbers; NaN where none is."""
    known = np.isfinite(values)
    total = np.where(known, values, 0.0).sum(axis=0)
    return np.where(known.any(axis=0), total / np.maximum(known.sum(axis=0), 1), np.nan)
