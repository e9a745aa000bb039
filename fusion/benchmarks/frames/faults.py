"""One sense is wrong: a camera whose calibration is off, fingers that lie, a depth unit that is a little wrong.

Frames of `bench occlusion` (lab, a hand of known joints, a start 16 degrees and 33 mm off), each spoiled in one way:
is the pose still right, does the verdict stay honest, and is the fault said?
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.frames.occlusion import OBJECTS, SCENES, frames_of
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


def run(settings: BenchSettings) -> Report:
    """One table, a row a fault."""
    from fusion import estimate
    from fusion.truth.errors import Judge
    from scenes.synthesis import library

    trials = settings.count(2, quick=1)
    objects = settings.objects or tuple(settings.some(OBJECTS, 1))
    lab = next(scene for scene in SCENES if scene.noise == "lab" and scene.occluder == "hand")
    report = Report(
        "faults",
        "One sense is wrong: lab noise, a start 16 degrees and 33 mm off",
        f"{len(objects)} objects x {len(LEVELS)} hidden shares ({LEVELS[0]:.0%} to {LEVELS[-1]:.0%}) x {trials} frames",
        settings.seed,
    )
    found: dict[str, list[tuple[float, str, bool | None]]] = {fault.title: [] for fault in FAULTS}
    cells = [(name, level) for name in objects for level in LEVELS]
    for name, level in settings.progress(cells, len(cells), "faults"):
        judge = Judge(library.make(name))
        for i, frame in enumerate(frames_of(name, lab, level, trials, settings.seed)):
            truth = frame.camera_from_object_truth
            if truth is None:
                continue
            for fault in FAULTS:
                rng = np.random.default_rng(own_seed(settings.seed, fault.title, name, level, i))
                spoiled, lying = fault.spoil(frame, rng)
                answer = estimate(spoiled, judge.model, seed=settings.seed)
                said = None if fault.said is None else fault.said(answer, lying)
                found[fault.title].append((judge.errors(answer.pose, truth).add_s, answer.verdict, said))
    columns = [
        Column("fault"),
        Column("frames", 0),
        Column("ADD-S < 5 mm"),
        Column("median ADD-S mm"),
        Column("90 % mm"),
    ]
    columns += [Column("ok / ambiguous / lost"), Column("wrong but ok"), Column("said")]
    note = (
        "said: the answer's notes doubt the calibration, intrinsics or unit; or every lying finger's contact is named"
        f" an outlier. A lying finger's contact is {1e3 * ASTRAY:.0f} mm off. wrong: ADD-S above 5 mm."
    )
    table = Table("faults", columns, note=note)
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
        if fault.demand is not None:
            share = float(np.mean(error < WRONG))
            report.claims.append(Claim(f"{fault.title}: ADD-S below 5 mm", share, fault.demand, True))
    report.tables.append(table)
    settings.show(table)
    return report
