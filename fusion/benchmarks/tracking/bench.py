"""Sequences of an object in a hand: carried, turned, slipping, let go, shaken, out of view. Who follows it, how well?

Captures of scenes.synthesis.motion by family, no mask: every motion in every family with a hand. An object is held by
one grasp in all motions of a trial, each made once, with a camera's and a robot's errors of its own, and followed by
every method. Methods that need a start get the capture's own, 16 degrees and 33 mm off (T1 section 4.3), in the first
frame only; "estimate" has no memory and gets such a start in every frame that it is asked of: every fifth, and the last
five, which a track's end is held against. The particle filter begins from what vision found in the first frame; a track
that is "begun" is made to believe a wrong pose in the first. A frame is lost when its ADD-S is above 10 mm, and wrong
above 5 mm.
"""

from __future__ import annotations

import numpy as np

from fusion.benchmarks.families.making import objects_of, why_not
from fusion.benchmarks.families.table import Family, chosen
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Report, Table
from fusion.benchmarks.strata import parallel
from fusion.benchmarks.tracking import tables
from fusion.benchmarks.tracking.cells import Cell, Followed, follow_alone, follow_cell
from fusion.benchmarks.tracking.methods import METHODS, WRONG_STARTS
from fusion.benchmarks.tracking.sequences import OCCLUSION, USUAL
from fusion.benchmarks.tracking.tables import DOUBTED_IN, RIGHT_IN, Tracked
from fusion.benchmarks.tracking.tally import Tally
from scenes.errors import unknown

# Of the families on which settings are chosen; the others have their own.
OBJECTS = ("drill", "mug", "bottle", "hammer", "box")
MOTIONS = ("carry", "slip", "slide", "turn", "regrasp", "leave", "close", "shake", "camera", "pick", "put")
# Frames of a sequence: half as many again as a track that begins wrong has to be right in; and in a hurry.
FRAMES, QUICK_FRAMES = 45, 8


def run(settings: BenchSettings) -> Report:
    """Tables by family, motion and method: error, lost and wrong frames, recovery, slips, time. In a hurry one object a
    family, every motion in the usual one and one in each other.
    """
    trials = settings.count(1, 1)
    frames = settings.frames or (QUICK_FRAMES if settings.quick else FRAMES)
    methods, motions = settings.of_methods(METHODS, always="track"), _motions(settings)
    families = [family for family in chosen(settings.family) if family.hand]
    report = Report(
        "tracking",
        f"An object in a hand, up to {OCCLUSION:.0%} hidden in the first frame, 30 frames a second",
        f"{trials} sequences of {frames} frames an object and motion",
        settings.seed,
    )
    folder = settings.folder / "tracking" if settings.folder is not None else None
    cells: list[Cell] = []
    for at, family in enumerate(families):
        if why_not(family):
            report.tables.append(Table(f"{family.name}: left out, {why_not(family)}", tables.COLUMNS))
            continue
        usual = objects_of(family, OBJECTS) or objects_of(family)
        names = tuple(settings.some(settings.objects or usual, 1))
        asked = motions if not settings.quick or family.name == USUAL else (motions[at % len(motions)],)
        how = asked, frames, methods, settings.seed, folder
        cells += [Cell(family.name, name, trial, *how) for name in names for trial in range(trials)]
    tracked: Tracked = {}
    done: dict[tuple[str, str, int], list[Followed]] = {}
    for followed in settings.progress(parallel(follow_cell, cells), len(cells), "objects of families"):
        done[followed[0].key] = followed
        for family in families:
            own = [cell for cell in cells if cell.family == family.name]
            if followed[0].key[0] == family.name and all(cell.key in done for cell in own):
                _add_family(report, family, [one for cell in own for one in done[cell.key]], tracked, settings)
    if tracked:
        order = [(family.name, motion) for family in families for motion in motions]
        tracked = {key: tracked[key] for key in order if key in tracked}
        wrong = tables.begun_wrong(tracked)
        last = [tables.over_time(tracked), tables.by_family(tracked), tables.by_motion(tracked)]
        for table in last + ([] if wrong is None else [wrong]):
            report.tables.append(table)
            settings.show(table)
        report.charts.append(tables.chart_of(tracked))
        firsts: dict[str, Cell] = {}
        for cell in cells:
            firsts.setdefault(cell.family, cell)
        alone = [(cell.family, *follow_alone(cell)) for cell in firsts.values()]
        timed = tables.alone_table(alone)
        report.tables.append(timed)
        settings.show(timed)
        report.claims += _claims(tracked, [ms for _, _, tally in alone for ms in tally.cpu])
    return report


def _add_family(
    report: Report, family: Family, found: list[Followed], tracked: Tracked, settings: BenchSettings
) -> None:
    """The tables of a family whose sequences are all done."""
    for motion in dict.fromkeys(one.motion for one in found):
        tallies, refused = {method: Tally() for method in METHODS}, 0
        for one in found:
            if one.motion == motion and one.tallies is None:
                refused += 1
            elif one.motion == motion and one.tallies is not None:
                for method, tally in one.tallies.items():
                    tallies[method].pooled(tally)
        tracked[family.name, motion] = tallies
        added = [tables.errors_table(f"{family.name}, {motion}", tallies, refused)]
        if family.hand_known and motion in ("slip", "slide", "regrasp"):
            added.append(tables.slips_table(f"{family.name}, {motion}", tallies["track"]))
        for table in added:
            report.tables.append(table)
            settings.show(table)


def _motions(settings: BenchSettings) -> tuple[str, ...]:
    """Those that are asked for. Raises InputError for an unknown one."""
    if settings.motions is None:
        return MOTIONS
    for name in settings.motions:
        if name not in MOTIONS:
            raise unknown("motion", name, MOTIONS)
    return settings.motions


def _claims(tracked: Tracked, cpu: list[float]) -> list[Claim]:
    """Demands. cpu: processor milliseconds of frames that were tracked with nothing beside them."""
    families: dict[str, Tally] = {}
    motions: dict[str, Tally] = {}
    for (family, motion), tallies in tracked.items():
        families.setdefault(family, Tally()).pooled(tallies["track"])
        motions.setdefault(motion, Tally()).pooled(tallies["track"])
    wrong = [one[method] for one in tracked.values() for method in WRONG_STARTS]
    median = float(np.median(cpu)) if cpu else float("nan")
    out = [Claim("a tracked frame, median processor ms, alone", median, 8.0, False, 1)]
    # of a family or motion that no grasp could be made for nothing is asked
    for name, tally in families.items():
        if tally.ok:
            share = 100.0 * tally.wrong_ok / len(tally.ok)
            out.append(Claim(f"wrong but ok, % of tracked frames, {name}", share, 1.0, False, 1))
    for name, tally in motions.items():
        if not tally.nees:
            continue
        mean = float(np.mean([x for x in tally.nees if np.isfinite(x)] or [np.nan]))
        out.append(Claim(f"NEES / dof, mean, {name}", mean, 0.7, True))
        out.append(Claim(f"NEES / dof, mean, {name}", mean, 1.5, False))
    begun = sum(len(t.doubted) for t in wrong)
    if begun:
        doubted = sum(x <= DOUBTED_IN for t in wrong for x in t.doubted)
        righted = sum(x <= RIGHT_IN for t in wrong for x in t.righted)
        for share, asked in ((doubted, f"no longer ok in {DOUBTED_IN}"), (righted, f"right in {RIGHT_IN}")):
            out.append(Claim(f"tracks that begin wrong: {asked} frames, %", 100.0 * share / begun, 100.0, True, 0))
    for (family, motion), tallies in tracked.items():
        if motion == "slip" and tallies["estimate"].ends:
            # objects differ by more than methods do: each frame is held against itself
            less = np.subtract(tallies["estimate"].ends, tallies["track"].ends)
            what = f"rotation at the end of a slip, {family}: less than of the same frame alone by (median), degrees"
            out.append(Claim(what, float(np.rad2deg(np.median(less))), 0.0, True))
    return out
