"""Where a frame's time goes: processor milliseconds of every stage, one thread, beside ICP on the usual crop.

Generated frames of families and recorded ones, by both senses and by vision alone, with a start and without. Each is
estimated once so that everything is loaded, then a few times in turn with ICP, so that what else the machine does
meets all alike; the quickest of each counts, since it only adds. A stage's time is its share of the run's processor
time, and the time by the clock stands beside it; ICP is Open3D's, to planes, from the same start.
"""

from __future__ import annotations

import math
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fusion.benchmarks.families.making import frames_of
from fusion.benchmarks.families.table import RECORDED, chosen
from fusion.benchmarks.printing.one_thread import one_thread
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Quantile, Report, Table
from fusion.benchmarks.strata import places_of
from fusion.estimation.answer import Estimate
from fusion.estimation.estimate import estimate
from fusion.truth.compare import SENSES
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame
from vision.look.points import crop_points
from vision.published.icp import icp

# Frames of each object, hidden share and family; runs of each frame that are timed.
TRIALS, RUNS = 1, 3
# What is looked at when no family is named, and in a hurry.
USUAL, QUICK = ("lab", "d435", RECORDED), ("lab",)
# What does not belong to a stage: checks, and what is laid out between them.
BETWEEN, WHOLE, BY_CLOCK = "between stages", "whole frame", "by the clock"
# Milliseconds of the median frame, and of ICP's time, that are asked for with a start: by both senses, by vision.
ASKED = {"fused": 25.0, "vision": 15.0}
ASKED_OF_ICP = 0.5


@dataclass(frozen=True)
class Timed:
    """One frame by one sense: processor time (ms) of each stage, and that of ICP; clock: of the whole, by the clock."""

    family: str
    sense: str
    start: bool
    stages: dict[str, float]
    icp: float
    clock: float

    @property
    def whole(self) -> float:
        """Milliseconds of all stages together."""
        return sum(self.stages.values())


def run(settings: BenchSettings) -> Report:
    """One table a sense, with a start and without: stages in rows, families in columns."""
    names = (QUICK if settings.quick else USUAL) if settings.family is None else (settings.family,)
    families = [family for name in names for family in chosen(name)]
    trials = settings.count(TRIALS, quick=1)
    places, missing = places_of(families, settings)
    report = Report(
        "profile",
        "Where a frame's time goes",
        f"{trials} frames of each object and hidden share, one thread, the quickest of {RUNS} runs",
        settings.seed,
    )
    found: list[Timed] = []
    with one_thread():
        for family, level, name in settings.progress(places, len(places), "places"):
            for made in frames_of(family, level, trials, settings.seed, (name,)):
                found += _timed(family.name, made.frame, made.model)
    note = NOTE + "".join(f" Left out: {reason}." for reason in missing)
    for start in (True, False):
        for sense in ASKED:
            table = _table(found, sense, start, note)
            report.tables.append(table)
            settings.show(table)
    for sense, most in ASKED.items():
        mine = [one for one in found if one.sense == sense and one.start]
        if mine:
            report.claims.append(Claim(f"{sense} with a start: ms", _median(mine, lambda t: t.whole), most, False))
            share = _median(mine, lambda t: t.whole / t.icp)
            report.claims.append(Claim(f"{sense} with a start: of ICP's time", share, ASKED_OF_ICP, False))
    return report


NOTE = (
    f"Medians over frames of processor milliseconds, but for {BY_CLOCK!r}; a stage that half of the frames skip is 0,"
    " and medians do not add up. Mean: over all frames. Of ICP: of each frame's own."
)


def _timed(family: str, frame: Frame, model: ObjectModel) -> Iterator[Timed]:
    start = frame.prior
    if start is None:
        return
    asked = [(sense, known) for sense in ASKED for known in (True, False)]
    works: list[Callable[[], Estimate]] = [
        partial(estimate, frame if known else replace(frame, prior=None), model, use=SENSES[sense])
        for sense, known in asked
    ]
    (by_icp, _, _), *ours = _quickest([lambda: icp(crop_points(frame, model, start), model, start), *works])
    for (sense, known), (spent, clock, answer) in zip(asked, ours):
        assert isinstance(answer, Estimate)
        stages: dict[str, float] = defaultdict(float)
        for stage in answer.trace:
            # "rows, 20 starts" and "rows, 76 starts" are rounds of one stage; the trace's time is that of the clock
            stages[stage.name.split(",")[0]] += stage.ms * spent / clock if stage.ran else 0.0
        stages[BETWEEN] = max(0.0, spent - sum(stages.values()))
        yield Timed(family, sense, known, dict(stages), by_icp, clock)


def _quickest(works: Sequence[Callable[[], object]]) -> list[tuple[float, float, object]]:
    """Milliseconds of the processor and by the clock, and the result, of the quickest of a few runs of each of works,
    done in turn after one that loads.
    """
    found = [(math.inf, math.inf, work()) for work in works]
    for _ in range(RUNS):
        for k, work in enumerate(works):
            begin, begun = time.perf_counter(), time.process_time()
            result = work()
            spent, clock = 1e3 * (time.process_time() - begun), 1e3 * (time.perf_counter() - begin)
            if spent < found[k][0]:
                found[k] = spent, max(clock, 1e-9), result
    return found


def _median(found: list[Timed], of: Callable[[Timed], float]) -> float:
    return float(np.median([of(one) for one in found]))


def _stage(name: str, one: Timed) -> float:
    return one.stages.get(name, 0.0)


def _table(found: list[Timed], sense: str, start: bool, note: str) -> Table:
    by_family: dict[str, list[Timed]] = defaultdict(list)
    for one in found:
        if one.sense == sense and one.start == start:
            by_family[one.family].append(one)
            by_family["all"].append(one)
    columns = [Column("stage"), *(Column(f"{name} ms", 1) for name in by_family), Column("mean ms", 1)]
    table = Table(f"{sense}, {'with' if start else 'without'} a start", columns, note=note)
    every = by_family.get("all", [])
    stages = list(dict.fromkeys(name for one in every for name in one.stages))
    rows: list[tuple[str, Callable[[Timed], float]]] = [
        *((name, partial(_stage, name)) for name in [*(name for name in stages if name != BETWEEN), BETWEEN]),
        (WHOLE, lambda t: t.whole),
        (BY_CLOCK, lambda t: t.clock),
        ("ICP", lambda t: t.icp),
        ("of ICP", lambda t: t.whole / t.icp),
    ]
    for name, of in rows if every else ():
        values = [Quantile.of([of(one) for one in mine]) for mine in by_family.values()]
        table.add(name, *values, float(np.mean([of(one) for one in every])))
    return table
