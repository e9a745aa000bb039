"""One sense is wrong: a camera whose calibration is off, fingers that lie, a depth unit that is a little wrong.

Frames of every family with a hand of known joints that feels (a start 16 degrees and 33 mm off), each spoiled in one
way: is the pose still right, does the verdict stay honest, and is the fault said?
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.families.making import frames_of, judge_for, objects_of, why_not
from fusion.benchmarks.families.table import Family, chosen
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Quantile, Rate, Report, Table, own_seed
from scenes.geometry import poses as se3
from scenes.recordings.frames import Contacts, Frame

if TYPE_CHECKING:
    from fusion.estimation.answer import Estimate

Array = NDArray[np.float64]

LEVELS = (0.3, 0.6, 0.8)
WRONG = 0.005
# How far a lying finger's contact is from where it says (m).
ASTRAY = 0.03


@dataclass(frozen=True)
class Fault:
    """spoil(frame, rng) -> the frame with the fault, and which contacts lie (n,); said(answer, lying) -> whether the
    answer names it, None where there is nothing to name; demand: least success, None for none.
    """

    title: str
    spoil: Callable[[Frame, np.random.Generator], tuple[Frame, NDArray[np.bool_]]]
    said: Callable[[Estimate, NDArray[np.bool_]], bool] | None
    demand: float | None


def moved_camera(distance: float) -> Callable[[Frame, np.random.Generator], tuple[Frame, NDArray[np.bool_]]]:
    """Everything that the robot reports is `distance` (m) off in a random direction."""

    def spoil(frame: Frame, rng: np.random.Generator) -> tuple[Frame, NDArray[np.bool_]]:
        assert frame.world_from_hand is not None
        shift = se3.make_pose(translation=distance * _direction(rng))
        off = replace(frame, world_from_hand=shift @ frame.world_from_hand, contacts=frame.contacts.moved(shift))
        return off, np.zeros(len(frame.contacts), dtype=bool)

    return spoil


def lying_fingers(count: int) -> Callable[[Frame, np.random.Generator], tuple[Frame, NDArray[np.bool_]]]:
    """So many contacts are ASTRAY from where they were felt, and say that they are as good as the others."""

    def spoil(frame: Frame, rng: np.random.Generator) -> tuple[Frame, NDArray[np.bool_]]:
        contacts, points = frame.contacts, frame.contacts.points.copy()
        lying = np.zeros(len(points), dtype=bool)
        lying[rng.choice(len(points), min(count, len(points)), replace=False)] = True
        points[lying] += ASTRAY * np.array([_direction(rng) for _ in range(int(lying.sum()))]).reshape(-1, 3)
        spoiled = Contacts(points, contacts.normals, contacts.sigma_point, contacts.sigma_normal, contacts.sensors)
        return replace(frame, contacts=spoiled), lying

    return spoil


def scaled_depth(factor: float) -> Callable[[Frame, np.random.Generator], tuple[Frame, NDArray[np.bool_]]]:
    """Depth is `factor` times what it should be."""

    def spoil(frame: Frame, rng: np.random.Generator) -> tuple[Frame, NDArray[np.bool_]]:
        assert frame.depth is not None
        return replace(frame, depth=(factor * frame.depth).astype(np.float32)), np.zeros(len(frame.contacts), bool)

    return spoil


def _direction(rng: np.random.Generator) -> Array:
    drawn = rng.normal(size=3)
    return np.asarray(drawn / max(float(np.linalg.norm(drawn)), 1e-12), dtype=np.float64)


def _notes(answer: Estimate, lying: NDArray[np.bool_]) -> bool:
    """A doubt beside the verdict's reason."""
    return len(answer.notes) > 1


def _names_liars(answer: Estimate, lying: NDArray[np.bool_]) -> bool:
    """Every lying contact is called an outlier."""
    outlier = np.array([residual.outlier for residual in answer.contacts], dtype=bool)
    return len(outlier) == len(lying) and bool(outlier[lying].all())


FAULTS = (
    Fault("none", moved_camera(0.0), None, 0.95),
    Fault("calibration off by 5 mm", moved_camera(0.005), None, 0.95),
    Fault("calibration off by 10 mm", moved_camera(0.010), _notes, 0.9),
    Fault("calibration off by 20 mm", moved_camera(0.020), _notes, None),
    Fault("one finger lies", lying_fingers(1), _names_liars, 0.95),
    Fault("two fingers lie", lying_fingers(2), _names_liars, 0.9),
    Fault("depth 1 % too far", scaled_depth(1.01), None, 0.95),
    Fault("depth 3 % too far", scaled_depth(1.03), _notes, None),
)


# Frames of an object at each hidden share: of the family of the usual table, and of the others.
USUAL, TRIALS, OTHER_TRIALS = "lab", 2, 1
Found = dict[str, list[tuple[float, str, bool | None]]]


def usable(family: Family) -> bool:
    """Whether its frames have what the faults spoil."""
    return family.hand_known and "point" in family.touch


def run(settings: BenchSettings) -> Report:
    """One table a family, a row a fault."""
    families = [family for family in chosen(settings.family) if usable(family)]
    report = Report(
        "faults",
        "One sense is wrong: a start 16 degrees and 33 mm off",
        f"hidden shares {', '.join(f'{level:.0%}' for level in LEVELS)};"
        f" {settings.count(TRIALS, quick=1)} frames of an object at each of {USUAL},"
        f" {settings.count(OTHER_TRIALS, quick=1)} of every other family",
        settings.seed,
    )
    for family in families:
        if why_not(family):
            report.tables.append(Table(f"{family.name}: left out, {why_not(family)}", _columns()))
        else:
            _family(report, family, settings)
    return report


def _family(report: Report, family: Family, settings: BenchSettings) -> None:
    from fusion import estimate

    trials = settings.count(TRIALS if family.name == USUAL else OTHER_TRIALS, quick=1)
    names = settings.some(objects_of(family, settings.objects), 1)
    levels = [level for level in LEVELS if level in family.levels] or [family.levels[-1]]
    found: Found = {fault.title: [] for fault in FAULTS}
    cells = [(name, level) for name in names for level in (levels[1:2] or levels if settings.quick else levels)]
    for name, level in settings.progress(cells, len(cells), f"faults, {family.name}"):
        for i, made in enumerate(frames_of(family, level, trials, settings.seed, (name,))):
            truth, judge = made.frame.camera_from_object_truth, judge_for(family, made)
            if truth is None:
                continue
            for fault in FAULTS:
                rng = np.random.default_rng(own_seed(settings.seed, fault.title, name, level, i))
                spoiled, lying = fault.spoil(made.frame, rng)
                answer = estimate(spoiled, judge.model, seed=settings.seed)
                said = None if fault.said is None else fault.said(answer, lying)
                found[fault.title].append((judge.errors(answer.pose, truth).add_s, answer.verdict, said))
    report.tables.append(_table(report, family, found))
    settings.show(report.tables[-1])


def _columns() -> list[Column]:
    first = [Column("fault"), Column("frames", 0), Column("ADD-S < 5 mm"), Column("median ADD-S mm"), Column("90 % mm")]
    return [*first, Column("ok / ambiguous / lost"), Column("wrong but ok"), Column("said")]


def _table(report: Report, family: Family, found: Found) -> Table:
    """The family's table; demands are made of the usual family only."""
    note = (
        "said: the answer's notes doubt the calibration, intrinsics or unit; or every lying finger's contact is named"
        f" an outlier. A lying finger's contact is {1e3 * ASTRAY:.0f} mm off. wrong: ADD-S above 5 mm."
    )
    table = Table(f"{family.name}: {family.stands_for}", _columns(), note=note)
    for fault in FAULTS:
        rows = found[fault.title]
        if not rows:
            continue
        error = np.array([row[0] for row in rows])
        named = [row[2] for row in rows if row[2] is not None]
        table.add(
            fault.title,
            len(rows),
            Rate.of(error < WRONG),
            Quantile.of(error, 1e3),
            Quantile.of(error, 1e3, 0.9),
            " / ".join(str(sum(row[1] == word for row in rows)) for word in ("ok", "ambiguous", "lost")),
            Rate.of([row[1] == "ok" and row[0] > WRONG for row in rows]),
            Rate.of(named) if named else None,
        )
        if fault.demand is not None and family.name == USUAL:
            share = float(np.mean(error < WRONG))
            report.claims.append(Claim(f"{fault.title}: ADD-S below 5 mm", share, fault.demand, True))
    return table
