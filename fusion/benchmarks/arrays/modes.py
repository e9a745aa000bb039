"""Which of several modes is the object's? Random grasps by four pads, no estimate; modes of rows, told apart by what
patterns say. Near-symmetric objects first: a box, a bottle and a can can be held in many ways that rows alone allow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.arrays.grasps import FINGER, PALM, Held, first_touch, pad, record, sensor_of
from fusion.benchmarks.contacts.trials import errors, is_close
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Rate, Report, Table
from scenes.evidence.align import align
from scenes.evidence.modes import ModeSettings, distinct_modes
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.synthesis import library
from touch.answers import LocalizeSettings
from touch.arrays.costs import ArrayProblem
from touch.arrays.ranking import RankingSettings, pattern_costs
from touch.arrays.rows import array_contacts, array_rows
from touch.arrays.searches import localize_arrays
from touch.multistart import find_candidates

Array = NDArray[np.float64]

# Near-symmetric objects have the most grasps: most of their frames have one mode only.
OBJECTS = {"box": 3, "bottle": 3, "cylinder": 3, "mug": 1, "l_block": 1, "drill": 1}
# Middles of the pads are at least this far apart (m), as a hand's fingers are.
APART = 0.03
# Modes are listed as far as this above the best (nats): what patterns say is to be seen, not what the margin cut.
MARGIN = 40.0
# How the modes are told apart: what the rows' costs count, and what of the patterns is added.
ORDERS: dict[str, tuple[float, RankingSettings | None]] = {
    "rows alone": (1.0, None),
    "rows + covariance": (1.0, RankingSettings(pressures=False)),
    "pressures for rows": (0.0, RankingSettings(covariance=False)),
    "covariance + pressures for rows": (0.0, RankingSettings()),
}
FINISHED = "finished on pressures + covariance"


def random_hold(model: ObjectModel, rng: np.random.Generator) -> Held:
    """Three fingers and a palm anywhere on the object, each pressed straight in."""
    points, normals = model.sample_surface(200, int(rng.integers(2**31)))
    chosen = [0]
    for k in range(1, len(points)):
        if len(chosen) < 4 and np.linalg.norm(points[k] - points[chosen], axis=1).min() > APART:
            chosen.append(k)
    sensors, pads, directions = [], [], []
    for row, k in enumerate(chosen):
        name, shape = (f"finger{row}", FINGER) if row else ("palm", PALM)
        sensor, z = sensor_of(name, pad(*shape)), -normals[k]
        x = rng.normal(size=3)
        x -= (x @ z) * z
        x /= np.linalg.norm(x)
        far = se3.make_pose(np.stack([x, np.cross(z, x), z], axis=1), points[k] - 0.12 * z)
        sensors.append(sensor)
        pads.append(first_touch(model, far, sensor, z))
        directions.append(z)
    return Held(model, tuple(sensors), np.array(pads), np.array(directions))


def add_modes(report: Report, settings: BenchSettings) -> None:
    """The table: share of the grasps with several modes, the right one among them, in which it is the first."""
    columns = [Column("object"), Column("grasps", 0), Column("right listed"), Column("modes", 1), Column("several", 0)]
    columns += [Column(name) for name in (*ORDERS, FINISHED)]
    table = Table("Which mode is first, without an estimate", columns)
    table.note = (
        "Random grasps by three fingers and a palm, recorded as above. Modes of the rows to 40 nats above the best;"
        " several: grasps with more than one mode, the right one (15°, 1 cm) among them; of these the share in which it"
        " comes first. Last column: ours whole, which lists modes of its own; same grasps."
    )
    count = settings.count(40, 4)
    first: dict[str, list[bool]] = {name: [] for name in (*ORDERS, FINISHED)}
    for name, times in OBJECTS.items():
        rows: dict[str, list[bool]] = {key: [] for key in first}
        listed, modes = [], []
        model = library.make(name)
        for i in settings.progress(range(times * count), times * count, f"modes of {name}"):
            rng = np.random.default_rng([settings.seed, 41, i, *map(ord, name)])
            truth = se3.make_pose(se3.random_rotations(1, rng)[0], 0.1 * rng.normal(size=3))
            problem = ArrayProblem(model, record(random_hold(model, rng), truth, rng))
            if len(problem.touching) < 2:
                continue
            poses, costs = _modes_of_rows(problem, i)
            good = np.array([is_close(errors(model, pose, truth)) for pose in poses])
            listed.append(bool(good.any()))
            modes.append(len(poses))
            if len(poses) < 2 or not good.any():
                continue
            for key, order in ORDERS.items():
                keeps, patterns = order
                told = keeps * costs
                if patterns is not None:
                    told = told + pattern_costs(model, problem.readings, poses, patterns)
                rows[key].append(bool(good[int(np.argmin(told))]))
            rows[FINISHED].append(is_close(errors(model, localize_arrays(problem, i).pose, truth)))
        table.add(
            name, len(listed), Rate.of(listed), float(np.mean(modes)), len(rows[FINISHED]),
            *(Rate.of(rows[key]) for key in first),
        )  # fmt: skip
        for key, flags in rows.items():
            first[key] += flags
    table.add("all", None, None, None, len(first[FINISHED]), *(Rate.of(flags) for flags in first.values()))
    report.tables.append(table)
    settings.show(table)
    shares = {key: Rate.of(flags).share for key, flags in first.items()}
    report.claims += [
        Claim("the right mode first: covariance's gain over rows alone, %",
              100 * (shares["rows + covariance"] - shares["rows alone"]), 0.0, True, 1),
        Claim("the right mode first: gain of both over rows alone, %",
              100 * (shares["covariance + pressures for rows"] - shares["rows alone"]), 0.0, True, 1),
    ]  # fmt: skip


def _modes_of_rows(problem: ArrayProblem, seed: int) -> tuple[Array, Array]:
    """Poses (k, 4, 4) of the modes of the rows of evidence and their costs (k,)."""
    model, readings = problem.model, problem.readings
    contacts, rows = array_contacts(readings), array_rows(readings)
    found = find_candidates(model, contacts, rows, np.random.default_rng(seed), None, LocalizeSettings())
    aligned = align(model, rows, found.poses, None)
    modes = distinct_modes(model, aligned, ModeSettings(cost_margin=MARGIN, most=40))
    return np.array([mode.pose for mode in modes]), np.array([mode.cost for mode in modes])
