"""Does the search find what its own objective prefers? Every answer against what refining from the truth ends in.

For each frame `fusion.estimation.steps.judge` refines the answer and the true pose alike, with fits to their outlines
and one joint solution, and says what each costs by the estimate's whole objective: the predicted picture, touch, prior.
Where the truth ends lower, the search missed a minimum; where a wrong answer costs less, the objective prefers it and
no search can help; where both cost the same, the data cannot tell. The truth is used here only.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.families.making import Made, frames_of, judge_for
from fusion.benchmarks.families.table import FAMILIES, REPORT, TUNING, Family, chosen
from fusion.benchmarks.frames.missed import keep_miss
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Quantile, Rate, Report, Table
from fusion.benchmarks.strata import WRONG, Answer, gathered, places_of, senses_table
from fusion.estimation.estimate import estimate
from fusion.estimation.settings import usual_settings
from fusion.estimation.steps.judge import Judgement, judge
from fusion.truth.compare import SENSES
from fusion.truth.errors import Judge
from scenes.errors import InputError
from scenes.recordings.frames import Frame
from vision.look.points import crop_points
from vision.published.icp import icp

Array = NDArray[np.float64]

# Nats by which one cost must be lower than another to be told from it: the odds are then e to 1.
NATS = 1.0
# Frames of each object, hidden share and family.
TRIALS = 1
# Poses that are judged together at most: the answer's, the true one, where the search ended, and other modes.
MOST_JUDGED = usual_settings().joint.modes
RIGHT, MISSED, ALIKE, PREFERRED = "right", "missed", "alike", "preferred"
# Shares of missed minima that are allowed, with a start and without.
MOST_MISSED = {True: 0.005, False: 0.01}


@dataclass(frozen=True)
class Told:
    """What the estimator is told of a frame beside its senses: a start, the object's mask, the hand's model."""

    start: bool
    mask: bool
    hand: bool

    def of(self, frame: Frame) -> Frame:
        """The frame, less what is not told."""
        frame = frame if self.start else replace(frame, prior=None)
        frame = frame if self.mask else replace(frame, mask=None)
        return frame if self.hand else replace(frame, hand=None, joints=None, world_from_hand=None)

    @property
    def words(self) -> str:
        """For names of files and rows."""
        parts = ["start" if self.start else "no start", *["mask"] * self.mask, *["hand"] * self.hand]
        return ", ".join(parts)


@dataclass(frozen=True)
class Tried:
    """One answer. usual: told what its family tells; add_s (m) of it and of what the truth refines to; gap: nats by
    which the lower of the answer and of what the search found costs more than that, NaN where nothing was sensed;
    own_gap: those of the answer alone. beside: missed, and another mode of the answer is as low.
    """

    family: str
    level: float
    frame: str
    sense: str
    told: Told
    usual: bool
    add_s: float
    truth_add_s: float
    gap: float
    verdict: str
    ms: float = math.nan
    icp_ms: float = math.nan
    own_gap: float = math.nan
    beside: bool = False

    @property
    def given_up(self) -> bool:
        """The search had found a place no higher than the truth's, and what was made of it is wrong and higher."""
        return self.add_s >= WRONG and self.own_gap > NATS and self.outcome != MISSED

    @property
    def outcome(self) -> str:
        """Whose fault a wrong answer is; a right one may have missed a minimum, too, where that is elsewhere."""
        near = self.add_s < WRONG
        if self.gap > NATS and not (near and self.truth_add_s < WRONG):
            return MISSED
        if near:
            return RIGHT
        return PREFERRED if self.gap < -NATS else ALIKE


@dataclass(frozen=True)
class SearchCell:
    """Frames tried in one go. folder: where misses are kept, None for nowhere."""

    family: Family
    level: float
    name: str
    trials: int
    seed: int
    quick: bool
    folder: Path | None


def told_of(family: Family, quick: bool) -> tuple[Told, ...]:
    """Everything that may be told of a family's frames, what the family tells first; in a hurry only that."""
    masks = (True,) if family.mask else (False,) if quick else (False, True)
    hands = (False,) if not family.hand_known else (True,) if quick else (True, False)
    return tuple(Told(start, mask, hand) for mask in masks for hand in hands for start in (True, False))


def try_cell(cell: SearchCell) -> list[Tried]:
    """Every sense on every frame of a cell, under everything that may be told."""
    out = []
    # the mask is drawn with the frame and changes nothing else of it
    whole = replace(cell.family, mask=True)
    for made in frames_of(whole, cell.level, cell.trials, cell.seed, (cell.name,)):
        true = judge_for(cell.family, made)
        beside = icp_time(made)
        for told in told_of(cell.family, cell.quick):
            frame = told.of(made.frame)
            usual = told.mask == cell.family.mask and told.hand == cell.family.hand_known
            out += [_tried(cell, made, true, frame, sense, told, usual, beside) for sense in senses_of(frame, usual)]
    return out


def senses_of(frame: Frame, usual: bool) -> tuple[str, ...]:
    """Senses worth trying: nothing felt makes both senses vision, and touch knows no mask."""
    if not (len(frame.contacts) or frame.wrenches or frame.tactile or frame.gels):
        return ("fused",)
    return ("fused", "vision", "touch") if usual else ("fused", "vision")


def icp_time(made: Made) -> float:
    """Processor time (ms) of ICP on the usual crop around the frame's start; NaN without start or depth."""
    frame = made.frame
    if frame.prior is None or frame.depth is None:
        return math.nan
    begin = time.process_time()
    icp(crop_points(frame, made.model, frame.prior), made.model, frame.prior)
    return 1e3 * (time.process_time() - begin)


def _tried(
    cell: SearchCell, made: Made, true: Judge, frame: Frame, sense: str, told: Told, usual: bool, beside: float
) -> Tried:
    truth, use = frame.camera_from_object_truth, SENSES[sense]
    assert truth is not None
    begin = time.process_time()
    answer = estimate(frame, made.model, use=use, seed=cell.seed)
    spent = 1e3 * (time.process_time() - begin)
    costs: Judgement | None = None
    # what is answered is a mean over what may be the case, which a joint solution may leave for another valley: that
    # from which it was solved speaks for the search, too
    ends = [answer.pose, truth] if answer.searched is None else [answer.pose, truth, answer.searched]
    with suppress(InputError):  # a frame that tells nothing of the object has no costs
        costs = judge(frame, made.model, np.array(ends), use=use, seed=cell.seed)
    add_s = true.errors(answer.pose, truth).add_s

    def compared(costs: Judgement | None) -> Tried:
        gap, own_gap, truth_add_s = math.nan, math.nan, math.nan
        if costs is not None:
            gap, own_gap = (float(cost - costs.costs[1]) for cost in (np.delete(costs.costs, 1).min(), costs.costs[0]))
            truth_add_s = true.errors(costs.poses[1], truth).add_s
        times = answer.verdict, spent, beside, own_gap
        return Tried(cell.family.name, cell.level, made.key, sense, told, usual, add_s, truth_add_s, gap, *times)

    tried = compared(costs)
    if tried.outcome == MISSED and len(answer.modes) > 1:
        # what is told as another mode the search had found: it is missed by the answer alone
        rest = [mode.pose for mode in sorted(answer.modes[1:], key=lambda mode: mode.cost)]
        costs = judge(frame, made.model, np.array([*ends, *rest][:MOST_JUDGED]), use=use, seed=cell.seed)
        tried = replace(tried, beside=compared(costs).outcome != MISSED)
    if tried.outcome == MISSED and cell.folder is not None and costs is not None:
        words = {
            "family": cell.family.name,
            "hidden": None if math.isnan(cell.level) else cell.level,
            "object": made.name,
            "trial": made.trial,
            "seed": cell.seed,
            "sense": sense,
            "told": told.words,
            "answer_add_s_mm": 1e3 * add_s,
            "truth_refined_add_s_mm": 1e3 * tried.truth_add_s,
            "gap_nats": tried.gap,
        }
        keep_miss(cell.folder, frame, made.model, words, answer, costs)
    return tried


def run(settings: BenchSettings) -> Report:
    """Tables of whose fault wrong answers are: by family and hidden share, and by what is told."""
    trials = settings.count(TRIALS, quick=1)
    places, missing = places_of(chosen(settings.family), settings)
    cells = [SearchCell(*place, trials, settings.seed, settings.quick, settings.folder) for place in places]
    report = Report(
        "search",
        "Does the search find what its own objective prefers?",
        f"{len(cells) * trials} frames at most, {trials} of each object at each hidden share, each its own draw",
        settings.seed,
    )
    found = gathered(try_cell, cells, settings)
    note = NOTE + "".join(f" Left out: {reason}." for reason in missing)
    for sense in SENSES_SHOWN:
        for start in (True, False):
            table = by_family(found, sense, start, note)
            if table.rows:
                report.tables.append(table)
                settings.show(table)
    for table in (by_told(found), senses_table(_answers(found))):
        if table.rows:
            report.tables.append(table)
            settings.show(table)
    _claims(report, found)
    return report


SENSES_SHOWN = ("fused", "vision", "touch")
_OUTCOMES = (
    Column("frames", 0),
    Column("< 5 mm"),
    Column("missed"),
    Column("missed, of all", 0),
    Column("found, given up", 0),
    Column("told as another mode", 0),
    Column("objective prefers wrong"),
    Column("data cannot tell"),
    Column("lower from the truth"),
    Column("gap of missed, nats", 1),
    Column("gap of preferred", 1),
)
NOTE = (
    "missed: refining from the truth ends more than one nat lower than the answer, and than the pose that the search"
    " handed to the joint solution, and elsewhere; found, given up: the search had found a place as low as the truth's,"
    " and what the joint solution and the mean made of it is wrong and higher; told as another mode: of the missed,"
    " those where a mode beside the answer is as low as the truth's; objective prefers"
    " wrong: the answer, 5 mm off or more, ends more than one nat lower; data cannot tell: it is wrong, and neither is"
    " lower; the rest is right. lower from the truth: whether right or wrong. Gaps: means."
)
TOLD_NOTE = (
    " 95 % of missed: binomial interval (Wilson). CPU ms: processor time of an answer, median; ICP ms: of ICP on the"
    " usual crop around the start, whatever the answer is told."
)


def by_family(found: Sequence[Tried], sense: str, start: bool, note: str = NOTE) -> Table:
    """One row a family and hidden share, told what the family tells; one of each family and of each role."""
    title = f"{sense}, {'a start 16 degrees and 33 mm off' if start else 'no start'}"
    table = Table(title, [Column("family"), Column("role"), Column("hidden"), *_OUTCOMES], note=note)
    mine = [t for t in found if t.sense == sense and t.told.start == start and t.usual]
    for name, family in FAMILIES.items():
        own = [t for t in mine if t.family == name]
        for level in family.levels:
            at = [t for t in own if t.level == level or (math.isnan(level) and math.isnan(t.level))]
            hidden = "as recorded" if math.isnan(level) else f"{100 * level:.0f} %"
            _row(table, [name, family.role, hidden], at)
        if len(family.levels) > 1:
            _row(table, [name, family.role, "all"], own)
    for role in (TUNING, REPORT):
        _row(table, ["all", role, "all"], [t for t in mine if FAMILIES[t.family].role == role])
    return table


def by_told(found: Sequence[Tried]) -> Table:
    """One row a role, sense and what is told; one of each start whatever else is told, which is what the demands are
    of.
    """
    yes = ("start", "mask", "hand")
    head = [Column("role"), Column("sense"), *(Column(name) for name in yes)]
    more = [Column("95 % of missed"), Column("asked"), Column(""), Column("CPU ms", 0), Column("ICP ms", 0)]
    table = Table("By what is told", [*head, *_OUTCOMES, *more], note=NOTE + TOLD_NOTE)
    every = sorted({t.told for t in found}, key=lambda t: (not t.start, t.mask, not t.hand))
    for role in (TUNING, REPORT):
        for sense in SENSES_SHOWN:
            of = [t for t in found if t.sense == sense and FAMILIES[t.family].role == role]
            for start in (True, False):
                own = [told for told in every if told.start == start]
                for told in own:
                    named = [role, sense, *("yes" if getattr(told, name) else "no" for name in yes)]
                    _told_row(table, named, [t for t in of if t.told == told], start)
                if len(own) > 1:
                    named = [role, sense, "yes" if start else "no", "all", "all"]
                    _told_row(table, named, [t for t in of if t.told.start == start], start)
    return table


def _told_row(table: Table, head: list[str], found: Sequence[Tried], start: bool) -> None:
    if not found:
        return
    missed, most = Rate.of([t.outcome == MISSED for t in found]), MOST_MISSED[start]
    low, high = missed.interval
    times = [Quantile.of([getattr(t, name) for t in found]) for name in ("ms", "icp_ms")]
    said = "met" if missed.share <= most else "MISSED"
    asked = [f"{100 * low:.1f} to {100 * high:.1f} %", f"<= {100 * most:.1f} %", said]
    table.add(*head, *_outcomes(found), *asked, *times)


def _row(table: Table, head: list[str], found: Sequence[Tried]) -> None:
    if found:
        table.add(*head, *_outcomes(found))


def _outcomes(found: Sequence[Tried]) -> list[Any]:
    """The cells of _OUTCOMES."""

    def gap(outcome: str) -> float | None:
        gaps = [t.gap for t in found if t.outcome == outcome]
        return float(np.mean(gaps)) if gaps else None

    missed = Rate.of([t.outcome == MISSED for t in found])
    return [
        len(found),
        Rate.of([t.add_s < WRONG for t in found]),
        missed,
        missed.hits,
        sum(t.given_up for t in found),
        sum(t.beside for t in found),
        Rate.of([t.outcome == PREFERRED for t in found]),
        Rate.of([t.outcome == ALIKE for t in found]),
        Rate.of([t.gap > NATS for t in found]),
        gap(MISSED),
        gap(PREFERRED),
    ]


def _answers(found: Sequence[Tried]) -> list[Answer]:
    """What the table of the senses compares: told what the family tells."""
    return [
        Answer(t.family, t.level, t.sense, t.told.start, t.add_s, math.nan, math.nan, t.verdict, frame=t.frame)
        for t in found
        if t.usual
    ]


def _claims(report: Report, found: Sequence[Tried]) -> None:
    for role in (TUNING, REPORT):
        for sense in SENSES_SHOWN:
            for start, most in MOST_MISSED.items():
                mine = [
                    t for t in found if t.sense == sense and t.told.start == start and FAMILIES[t.family].role == role
                ]
                if mine:
                    what = f"{role} families, {sense}, {'a start' if start else 'no start'}: missed, share of all"
                    share = Rate.of([t.outcome == MISSED for t in mine]).share
                    report.claims.append(Claim(what, share, most, False, digits=3))
