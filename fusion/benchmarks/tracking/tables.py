"""Tables of `bench tracking`: by family, motion and method; over time; and how a wrong beginning ends."""

from __future__ import annotations

import numpy as np

from fusion.benchmarks.printing.charts import Chart
from fusion.benchmarks.printing.tables import Column, Rate, Table
from fusion.benchmarks.tracking.methods import END, METHODS, SINGLE_EVERY, WRONG_STARTS
from fusion.benchmarks.tracking.tally import LOST, SLIP_DELAY, Tally

# Tallies of each family and motion, by method.
Tracked = dict[tuple[str, str], dict[str, Tally]]
# What is asked of a track that begins wrong (frames): no longer ok, and right.
DOUBTED_IN, RIGHT_IN = 10, 30

COLUMNS = (
    Column("method"),
    Column("frames", 0),
    Column("median ADD-S mm"),
    Column("95 % mm"),
    Column("rotation deg"),
    Column("at the end"),
    Column("lost (> 10 mm)"),
    Column("wrong (> 5 mm) but ok"),
    Column("ok"),
    Column("new starts", 0),
    Column("frames lost"),
    Column("NEES / dof"),
    Column("mean"),
    Column("processor ms", 1),
    Column("wall ms", 1),
    Column("wall 95 %", 1),
)


def errors_table(motion: str, tallies: dict[str, Tally], refused: int) -> Table:
    """Errors, verdicts and times of every method."""
    table = Table(
        f"{motion}: error, lost and wrong frames, time",
        COLUMNS,
        note="NEES / dof: median and mean over frames, 0.9 and 1 are right. At the end: median rotation of the last"
        f" {END} answers. Frames lost: median length of a loss that ended. Times of all but the first frame,"
        f" segmentation included, a sequence on each core. estimate: every {SINGLE_EVERY}th frame and the last {END},"
        " with a start."
        + (f" {refused} sequences could not be made: no grasp hides the object by as much." if refused else ""),
    )
    for method, tally in tallies.items():
        if not tally.add_s:
            continue
        add_s, count = 1e3 * np.array(tally.add_s), len(tally.add_s)
        known = [x for x in tally.nees if np.isfinite(x)]
        says = method not in ("icp", "particle filter")
        table.add(
            method,
            count,
            float(np.median(add_s)),
            float(np.quantile(add_s, 0.95)),
            float(np.rad2deg(np.median(tally.rotation))),
            float(np.rad2deg(np.median(tally.ends))),
            Rate(int((add_s > 1e3 * LOST).sum()), count),
            Rate(tally.wrong_ok, count) if says else None,
            Rate(sum(tally.ok), count) if says else None,
            tally.again,
            float(np.median(tally.runs)) if tally.runs else None,
            float(np.median(known)) if known else None,
            float(np.mean(known)) if known else None,
            float(np.median(tally.cpu)) if tally.cpu else None,
            float(np.median(tally.wall)) if tally.wall else None,
            float(np.quantile(tally.wall, 0.95)) if tally.wall else None,
        )
    return table


def slips_table(motion: str, tally: Tally) -> Table:
    """What a track has said of slips."""
    slips = Table(
        f"{motion}: slips in the hand, said by the track",
        [
            Column("slips", 0),
            Column("said in time as moved_in_hand"),
            Column("false alarms", 0),
            Column("said in time as slip"),
            Column("of slip: false alarms", 0),
            Column("steady frames", 0),
        ],
        note=f"In time: up to {SLIP_DELAY} frames after its end. Slips about an axis of symmetry are not counted. The"
        " fingers of these captures close anew on an object that moves, so that their own motion often predicts it:"
        " it has moved in the hand, and only what they do not predict is a slip.",
    )
    moved, said = Rate(tally.moved_hits, tally.slips), Rate(tally.hits, tally.slips)
    slips.add(tally.slips, moved, tally.moved_alarms, said, tally.alarms, tally.steady)
    return slips


# Ends (frames) of the stretches over which errors are told.
_STRETCHES = (5, 10, 20, 30, 45)


def over_time(tracked: Tracked) -> Table:
    """Median error in stretches of time, all motions and families together."""
    heads = [f"frames {low} to {high - 1}" for low, high in zip((0, *_STRETCHES), _STRETCHES)]
    table = Table("Error over time, median ADD-S mm, all together", [Column("method"), *map(Column, heads)])
    for method in METHODS:
        frame, add_s = _all(tracked, method)
        if not len(frame):
            continue
        cells: list[float | None] = []
        for low, high in zip((0, *_STRETCHES), _STRETCHES):
            use = (frame >= low) & (frame < high)
            cells.append(1e3 * float(np.median(add_s[use])) if use.any() else None)
        table.add(method, *cells)
    return table


def alone_table(followed: list[tuple[str, str, Tally]]) -> Table:
    """What a tracked frame takes, of a sequence by itself: family, motion, tally."""
    columns = [Column("family"), Column("motion"), Column("frames", 0), Column("processor ms", 1), Column("mean", 1)]
    table = Table(
        "A tracked frame, one thread, nothing beside it",
        [*columns, Column("95 %", 1), Column("wall ms", 1)],
        note="Median, mean and 95 % of all but the first frame. The mean has in it the searches of single frames, which"
        " a live track leaves to another thread.",
    )
    for family, motion, tally in followed:
        if tally.cpu:
            times = np.array(tally.cpu)
            spread = float(np.median(times)), float(times.mean()), float(np.quantile(times, 0.95))
            table.add(family, motion, len(times), *spread, float(np.median(tally.wall)))
    return table


def _all(tracked: Tracked, method: str) -> tuple[np.ndarray, np.ndarray]:
    """Frame indices and ADD-S (m) of all answers of a method."""
    frame = [i for tallies in tracked.values() for i in tallies[method].frame]
    add_s = [x for tallies in tracked.values() for x in tallies[method].add_s]
    return np.array(frame, dtype=np.int64), np.array(add_s)


def by_family(tracked: Tracked) -> Table:
    """The track alone, family by family over all motions."""
    columns = [Column("family"), Column("frames", 0), Column("median ADD-S mm"), Column("wrong but ok"), Column("ok")]
    columns += [Column("95 % regions hold"), Column("NEES / dof, mean"), Column("median")]
    columns += [Column("processor ms", 1), Column("mean ", 1)]
    table = Table("The track by family, all motions together", columns)
    without = []
    for family in dict.fromkeys(family for family, _ in tracked):
        own = Tally()
        for (name, _), tallies in tracked.items():
            if name == family:
                own.pooled(tallies["track"])
        if own.add_s:
            nees = [x for x in own.nees if np.isfinite(x)] or [float("nan")]
            table.add(
                family,
                len(own.add_s),
                1e3 * float(np.median(own.add_s)),
                Rate(own.wrong_ok, len(own.ok)),
                Rate(sum(own.ok), len(own.ok)),
                Rate(own.held, len(own.nees)),
                float(np.mean(nees)),
                float(np.median(nees)),
                float(np.median(own.cpu)) if own.cpu else None,
                float(np.mean(own.cpu)) if own.cpu else None,
            )
        else:
            without.append(family)
    if without:
        table.note = f"No grasp hides the object by as much as is asked in {', '.join(without)}: no sequence."
    return table


def by_motion(tracked: Tracked) -> Table:
    """The track alone, motion by motion over all families."""
    columns = [Column("motion"), Column("frames", 0), Column("wrong but ok"), Column("ok"), Column("sequences", 0)]
    columns += [Column("95 % regions hold"), Column("NEES / dof, mean"), Column("+-")]
    columns += [Column("rotation at the end"), Column("single frames there")]
    table = Table("The track by motion, all families together", columns)
    table.note = (
        "+-: standard error of the mean, by sequences: all frames of one share a camera's and a robot's lasting errors."
        f" Single frames: those of the last {END} of each sequence, too."
    )
    for motion in dict.fromkeys(motion for _, motion in tracked):
        own, single = Tally(), Tally()
        for (_, name), tallies in tracked.items():
            if name == motion:
                own.pooled(tallies["track"])
                single.pooled(tallies["estimate"])
        if not own.add_s:
            continue
        nees = [x for x in own.nees if np.isfinite(x)]
        table.add(
            motion,
            len(own.add_s),
            Rate(own.wrong_ok, len(own.add_s)),
            Rate(sum(own.ok), len(own.ok)),
            len(own.means),
            Rate(own.held, len(own.nees)) if own.nees else None,
            float(np.mean(nees)) if nees else None,
            float(np.std(own.means, ddof=1) / np.sqrt(len(own.means))) if len(own.means) > 1 else None,
            float(np.rad2deg(np.median(own.ends))) if own.ends else None,
            float(np.rad2deg(np.median(single.ends))) if single.ends else None,
        )
    return table


def begun_wrong(tracked: Tracked) -> Table | None:
    """How tracks that were made to begin wrong find out, by family; None where none were."""
    columns = [Column("family"), Column("begins"), Column("sequences", 0), Column(f"no longer ok in {DOUBTED_IN}")]
    columns += [Column("median frame", 0), Column(f"right in {RIGHT_IN}"), Column("median frame ", 0)]
    columns += [Column("never", 0), Column("wrong but ok"), Column("error at the end mm")]
    table = Table("Tracks that begin wrong, all motions together", columns)
    table.note = (
        "The first pose is given and believed with 95 %. Frames from there until an answer is no longer wrong and ok,"
        " and until five on end are right (ADD-S up to 5 mm). Wrong but ok: of all frames after the first."
    )
    for family in dict.fromkeys(family for family, _ in tracked):
        for method, (turn, distance) in WRONG_STARTS.items():
            own = Tally()
            for (name, _), tallies in tracked.items():
                if name == family:
                    own.pooled(tallies[method])
            count = len(own.doubted)
            if not count:
                continue
            table.add(
                family,
                f"{np.rad2deg(turn):.0f} deg, {1e3 * distance:.0f} mm off",
                count,
                Rate(sum(one <= DOUBTED_IN for one in own.doubted), count),
                float(np.median(own.doubted)),
                Rate(sum(one <= RIGHT_IN for one in own.righted), count),
                float(np.median(own.righted)) if own.righted else None,
                own.never,
                Rate(own.still_wrong_ok, len(own.add_s) - count),
                1e3 * float(np.median(own.end_errors)),
            )
    return table if table.rows else None


def chart_of(tracked: Tracked) -> Chart:
    """Median error of every method from frame to frame."""
    series = {}
    for method in METHODS:
        frame, add_s = _all(tracked, method)
        at = np.unique(frame)
        if not len(at):
            continue
        series[method] = [(float(i), 1e3 * float(np.median(add_s[frame == i]))) for i in at]
    return Chart("Median error over time, all families and motions", "frame", "ADD-S mm", series, log_y=True)
