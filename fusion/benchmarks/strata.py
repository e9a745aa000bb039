"""Answers by family and hidden share: how near, how sure, how honest, ICP beside. One loop for every benchmark.

The NEES of a right covariance has the chi-square distribution of as many degrees of freedom as the pose has: six, one
less for an object that is round about an axis (Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking
and Navigation, 2001, section 5.4); its p-region then holds the truth with probability p.
"""

from __future__ import annotations

import math
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from fusion.benchmarks.families.making import frames_of, judge_for, objects_of, why_not
from fusion.benchmarks.families.table import FAMILIES, REPORT, TUNING, Family
from fusion.benchmarks.families.told import beliefs_of
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Quantile, Rate, Report, Table
from scenes.threads import VARIABLE, thread_count

if TYPE_CHECKING:
    from fusion.truth.compare import Row
    from scenes.geometry.symmetries import Symmetries

C = TypeVar("C")
T = TypeVar("T")
# ADD-S (m) from which on an answer is wrong, as everywhere.
WRONG = 0.005
# Region whose coverage is told.
REGION = 0.95
# Hidden share of the one level that is made in a hurry.
QUICK_LEVEL = 0.3
# With a start: what is compared; without one, where each sense alone is another benchmark's.
WITH_START, WITHOUT_START = ("icp", "vision", "touch", "fused"), ("icp", "fused")


@dataclass(frozen=True)
class Answer:
    """One method on one frame. level: hidden share, NaN where a recording does not say; add_s (m); per_dof: NEES per
    degree of freedom and share: its chi-square probability, NaN without a covariance; verdict "" of ICP; confidence
    that it is right, NaN where none is told; frame: which of the cell's, the same for every method.
    """

    family: str
    level: float
    method: str
    start: bool
    add_s: float
    per_dof: float
    share: float
    verdict: str
    ms: float = math.nan
    confidence: float = math.nan
    frame: str = ""

    @property
    def right(self) -> bool:
        """Near enough."""
        return self.add_s < WRONG


@dataclass(frozen=True)
class Cell:
    """Frames made and answered in one go. told: the estimator is told how large the family's errors are."""

    family: Family
    level: float
    name: str
    trials: int
    seed: int
    with_start: tuple[str, ...] = WITH_START
    without_start: tuple[str, ...] = WITHOUT_START
    told: bool = False


def freedom(symmetries: Symmetries) -> int:
    """Degrees of freedom of a pose that can be wrong."""
    return 3 if symmetries.is_spherical else 6 - min(1, len(symmetries.axes))


def answered(row: Row, family: str, level: float, start: bool, symmetries: Symmetries, frame: str = "") -> Answer:
    """One row of `fusion.truth.compare` with the truth."""
    from scipy.stats import chi2

    assert row.errors is not None
    count, nees = freedom(symmetries), row.errors.nees
    share = math.nan if row.estimate is None else float(chi2.cdf(nees, count)) if np.isfinite(nees) else 1.0
    sure = math.nan if row.estimate is None else row.estimate.confidence
    told = nees / count, share, row.verdict, row.time_ms, sure, frame
    return Answer(family, level, row.method, start, row.errors.add_s, *told)


def answer_cell(cell: Cell) -> list[Answer]:
    """Every method on every frame of a cell, with the frame's start and without."""
    from fusion.truth.compare import compare_frame

    out = []
    for made in frames_of(cell.family, cell.level, cell.trials, cell.seed, (cell.name,)):
        judge = judge_for(cell.family, made)
        for start, methods in ((True, cell.with_start), (False, cell.without_start)):
            usable = [one for one in methods if one != "touch" or len(made.frame.contacts)]
            frame = made.frame if start else replace(made.frame, prior=None)
            frame = replace(frame, beliefs=beliefs_of(cell.family)) if cell.told else frame
            rows = compare_frame(frame, judge, usable, cell.seed, agree=False) if usable else []
            known = cell.family.name, cell.level, start, judge.model.symmetries, made.key
            out += [answered(row, *known) for row in rows]
    return out


def cells_of(families: Sequence[Family], trials: int, settings: BenchSettings) -> tuple[list[Cell], list[str]]:
    """Every family, level and object; and the families that cannot be made here, with the reason."""
    places, missing = places_of(families, settings)
    return [Cell(*place, trials, settings.seed, told=settings.told) for place in places], missing


def places_of(families: Sequence[Family], settings: BenchSettings) -> tuple[list[tuple[Family, float, str]], list[str]]:
    """(family, hidden share, object) of all that is asked for; families that cannot be made here, with the reason."""
    places: list[tuple[Family, float, str]] = []
    missing = []
    for family in families:
        reason = why_not(family)
        if reason:
            missing.append(f"{family.name}: {reason}")
            continue
        names = settings.some(objects_of(family, settings.objects), 1)
        levels = quick_levels(family) if settings.quick else family.levels
        places += [(family, level, name) for level in levels for name in names]
    return places, missing


def quick_levels(family: Family) -> tuple[float, ...]:
    """The one level nearest to QUICK_LEVEL."""
    return (min(family.levels, key=lambda level: abs(level - QUICK_LEVEL)),)


def collect(cells: Sequence[Cell], settings: BenchSettings) -> list[Answer]:
    """The answers of all cells, in an order that does not depend on who was done first; one thread a process."""
    found = gathered(answer_cell, cells, settings)
    order = {name: i for i, name in enumerate(FAMILIES)}
    return sorted(found, key=lambda a: (order[a.family], a.level, a.start, a.method, a.add_s, a.share))


def gathered(
    work: Callable[[C], list[T]], cells: Sequence[C], settings: BenchSettings, called: str = "cells"
) -> list[T]:
    """What `work`, a function of a module, makes of all cells, as they are done, with a line of progress that calls
    them so.
    """
    return [one for some in settings.progress(parallel(work, cells), len(cells), called) for one in some]


def parallel(work: Callable[[C], list[T]], cells: Sequence[C], workers: int | None = None) -> Iterator[list[T]]:
    """What `work`, a function of a module, makes of each cell, as they are done; one thread a process.

    workers: processes, None for as many as threads are allowed.
    """
    workers = thread_count() if workers is None else workers
    if workers == 1 or len(cells) == 1:
        yield from map(work, cells)
        return
    before = os.environ.get(VARIABLE)
    os.environ[VARIABLE] = "1"
    try:
        with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
            for done in as_completed([pool.submit(work, cell) for cell in cells]):
                yield done.result()
    finally:
        if before is None:
            del os.environ[VARIABLE]
        else:
            os.environ[VARIABLE] = before


COLUMNS = (
    Column("family"),
    Column("role"),
    Column("hidden"),
    Column("frames", 0),
    Column("ADD-S mm"),
    Column("< 5 mm"),
    Column("95 % of that"),
    Column("95 % regions hold"),
    Column("NEES / dof, median"),
    Column("mean", 1),
    Column("wrong but ok"),
    Column("ok of right"),
    Column("ICP mm", 1),
    Column("ICP < 5 mm"),
)
NOTE = (
    "Medians of ADD-S. 95 % of that: binomial interval (Wilson). A right covariance has a median NEES / dof of 0.89, a"
    " mean of 1, and 95 % regions that hold 95 %. wrong but ok: of all; ok of right: of those below 5 mm. ICP: on the"
    " usual crop about the same start, or about the middle of the cloud without one."
)


def strata_table(
    answers: Sequence[Answer], method: str, start: bool, missing: Sequence[str] = (), beside: str = "icp"
) -> Table:
    """One row a family and hidden share, one of each family together, one of each role."""
    title = f"{method}, {'a start 16 degrees and 33 mm off' if start else 'no start'}"
    table = Table(title, list(COLUMNS), note=NOTE + "".join(f" Left out: {reason}." for reason in missing))
    mine = [a for a in answers if a.start == start and a.method in (method, beside)]
    for name, family in FAMILIES.items():
        own = [a for a in mine if a.family == name]
        for level in family.levels:
            at = [a for a in own if a.level == level or (math.isnan(level) and math.isnan(a.level))]
            _row(table, name, family.role, _percent(level), at, method, beside)
        if len(family.levels) > 1:
            _row(table, name, family.role, "all", own, method, beside)
    for role in (TUNING, REPORT):
        _row(table, "all", role, "all", [a for a in mine if FAMILIES[a.family].role == role], method, beside)
    return table


SENSES_COLUMNS = (
    Column("family"),
    Column("role"),
    Column("start"),
    Column("frames", 0),
    Column("fused < 5 mm"),
    Column("vision < 5 mm"),
    Column("touch < 5 mm"),
    Column("fused wrong, a sense right"),
    Column("of these ok", 0),
    Column("fused right, both wrong"),
)


def senses_table(answers: Sequence[Answer]) -> Table:
    """Whether both senses together are ever below the better of them: one row a family and start, one of each role."""
    note = (
        "The same frames for all three; a sense that a family lacks has no share. Fused wrong, a sense right: frames in"
        " which fused is 5 mm off or more and vision or touch alone is not; of these ok: fused did not say that it is"
        " unsure."
    )
    table = Table("Is fused ever below the better sense?", list(SENSES_COLUMNS), note=note)
    groups: list[tuple[str, str, tuple[str, ...]]] = [(f.name, f.role, (f.name,)) for f in FAMILIES.values()]
    groups += [("all", role, tuple(n for n, f in FAMILIES.items() if f.role == role)) for role in (TUNING, REPORT)]
    for start in (True, False):
        for label, role, names in groups:
            _senses_row(table, label, role, start, [a for a in answers if a.start == start and a.family in names])
    return table


def _senses_row(table: Table, label: str, role: str, start: bool, answers: Sequence[Answer]) -> None:
    found: dict[tuple[str, float, str], dict[str, Answer]] = {}
    for a in answers:
        level = -1.0 if math.isnan(a.level) else a.level
        found.setdefault((a.family, level, a.frame), {})[a.method] = a
    both = [one for one in found.values() if "fused" in one and ("vision" in one or "touch" in one)]
    if not both:
        return

    def others(one: dict[str, Answer]) -> list[bool]:
        return [one[sense].right for sense in ("vision", "touch") if sense in one]

    below = [one["fused"] for one in both if not one["fused"].right and any(others(one))]
    table.add(
        label,
        role,
        "yes" if start else "no",
        len(both),
        *(Rate.of([one[m].right for one in both if m in one]) for m in ("fused", "vision", "touch")),
        Rate(len(below), len(both)),
        sum(a.verdict == "ok" for a in below),
        Rate.of([one["fused"].right and not any(others(one)) for one in both]),
    )


def _percent(level: float) -> str:
    return "as recorded" if math.isnan(level) else f"{100 * level:.0f} %"


def _row(table: Table, name: str, role: str, hidden: str, answers: list[Answer], method: str, beside: str) -> None:
    ours, theirs = ([a for a in answers if a.method == one] for one in (method, beside))
    if not ours:
        return
    right = [a for a in ours if a.right]
    rate = Rate.of([a.right for a in ours])
    low, high = rate.interval
    ratio = [a.per_dof for a in ours]
    table.add(
        name,
        role,
        hidden,
        len(ours),
        Quantile.of([a.add_s for a in ours], 1e3),
        rate,
        f"{100 * low:.0f}-{100 * high:.0f}",
        Rate.of([a.share <= REGION for a in ours]),
        Quantile.of(ratio),
        float(np.mean(ratio)),
        Rate.of([a.verdict == "ok" and not a.right for a in ours]),
        Rate.of([a.verdict == "ok" for a in right]) if right else None,
        Quantile.of([a.add_s for a in theirs], 1e3) if theirs else None,
        Rate.of([a.right for a in theirs]) if theirs else None,
    )


def add_strata(report: Report, answers: Sequence[Answer], missing: Sequence[str], settings: BenchSettings) -> None:
    """Tables of every method of ours that answered, with a start and without, and what is demanded of each role."""
    for start in (True, False):
        for method in ("fused", "vision", "touch"):
            if any(a.start == start and a.method == method for a in answers):
                report.tables.append(strata_table(answers, method, start, missing))
                settings.show(report.tables[-1])
    senses = senses_table(answers)
    if senses.rows:
        report.tables.append(senses)
        settings.show(senses)
    for role in (TUNING, REPORT):
        fused = [a for a in answers if a.method == "fused" and a.start and FAMILIES[a.family].role == role]
        if not fused:
            continue
        held = float(np.mean([a.share <= REGION for a in fused]))
        wrong = float(np.mean([a.verdict == "ok" and not a.right for a in fused]))
        report.claims += [
            Claim(f"{role} families, fused: 95 % regions hold, at least", held, 0.93, True),
            Claim(f"{role} families, fused: 95 % regions hold, at most", held, 0.97, False),
            Claim(f"{role} families, fused: wrong but ok, share of all", wrong, 0.01, False),
        ]
