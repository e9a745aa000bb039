"""Sequences of an object in a hand: carried, turned, slipping, let go, shaken, out of view. Who follows it, how well?

Captures of scenes.synthesis.motion by family, no mask: every motion in every family with a hand. Methods that need a
start get the capture's own, 16 degrees and 33 mm off (T1 section 4.3), in the first frame only; "estimate" has no
memory and gets such a start in every frame that it is asked of. The particle filter begins from what vision found in
the first frame; "track begun wrong" is made to believe a wrong pose in the first. A frame is lost when its ADD-S is
above 10 mm, and wrong above 5 mm.
"""

from __future__ import annotations

import numpy as np

from fusion.benchmarks.families.making import objects_of, why_not
from fusion.benchmarks.families.table import Family, chosen
from fusion.benchmarks.printing.charts import Chart
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Rate, Report, Table
from fusion.benchmarks.tracking.methods import METHODS, SINGLE_EVERY
from fusion.benchmarks.tracking.sequences import OCCLUSION, USUAL, recorded
from fusion.benchmarks.tracking.tally import END, LOST, SLIP_DELAY, Tally, follow
from scenes.errors import unknown

# Of the families on which settings are chosen; the others have their own.
OBJECTS = ("drill", "mug", "bottle", "hammer", "box")
MOTIONS = ("carry", "slip", "slide", "turn", "regrasp", "leave", "close", "shake", "camera")
# Families that are followed in a hurry when none are asked for, and their motions.
QUICK_FAMILIES, QUICK_MOTIONS = (USUAL, "workshop", "human-hand"), ("slip", "carry")


def run(settings: BenchSettings) -> Report:
    """Tables by family, motion and method: error, lost and wrong frames, recovery, slips, time."""
    trials = settings.count(3, 1)
    frames = settings.frames or (12 if settings.quick else 45)
    methods = _methods(settings)
    families = [family for family in chosen(settings.family) if family.hand]
    if settings.quick and settings.family is None:
        families = [family for family in families if family.name in QUICK_FAMILIES]
    motions = _motions(settings)
    report = Report(
        "tracking",
        f"An object in a hand, up to {OCCLUSION:.0%} hidden in the first frame, 30 frames a second",
        f"{trials} sequences of {frames} frames an object and motion",
        settings.seed,
    )
    tracked: dict[tuple[str, str], dict[str, Tally]] = {}
    for family in families:
        if why_not(family):
            report.tables.append(Table(f"{family.name}: left out, {why_not(family)}", _COLUMNS))
            continue
        usual = objects_of(family, OBJECTS) or objects_of(family)
        names = tuple(settings.some(settings.objects or usual, 1))
        for motion in motions:
            tallies, refused = _sequences(family, motion, names, trials, frames, methods, settings)
            tracked[family.name, motion] = tallies
            report.tables.append(_errors(f"{family.name}, {motion}", tallies, refused))
            settings.show(report.tables[-1])
            if family.hand_known and motion in ("slip", "slide", "regrasp"):
                report.tables.append(_slips(f"{family.name}, {motion}", tallies["track"]))
                settings.show(report.tables[-1])
    if tracked:
        report.tables += [_over_time(tracked), _by_family(tracked), _by_motion(tracked)]
        for table in report.tables[-3:]:
            settings.show(table)
        report.charts.append(_chart(tracked))
        report.claims += _claims(tracked)
    return report


def _motions(settings: BenchSettings) -> tuple[str, ...]:
    """Those that are asked for. Raises InputError for an unknown one."""
    if settings.motions is None:
        return QUICK_MOTIONS if settings.quick else MOTIONS
    for name in settings.motions:
        if name not in MOTIONS:
            raise unknown("motion", name, MOTIONS)
    return settings.motions


def _methods(settings: BenchSettings) -> tuple[str, ...]:
    """Those that are asked for; the track is always among them. Raises InputError for an unknown one."""
    for name in settings.methods or ():
        if name not in METHODS:
            raise unknown("method", name, METHODS)
    return METHODS if settings.methods is None else tuple(m for m in METHODS if m in (*settings.methods, "track"))


def _sequences(
    family: Family,
    motion: str,
    names: tuple[str, ...],
    trials: int,
    frames: int,
    methods: tuple[str, ...],
    settings: BenchSettings,
) -> tuple[dict[str, Tally], int]:
    """Every method on every sequence of a motion; how many sequences could not be made. Others' tallies are empty."""
    tallies = {method: Tally() for method in METHODS}
    cells = [(name, trial) for name in names for trial in range(trials)]
    refused = 0
    for name, trial in settings.progress(cells, len(cells), f"{family.name}, {motion}"):
        folder = settings.folder / "tracking" if settings.folder is not None else None
        hidden = min(OCCLUSION, max(family.levels))
        made = recorded(name, motion, frames, settings.seed + 101 * trial, folder, hidden, family=family)
        if made is None:
            refused += 1
            continue
        for method in methods:
            follow(tallies[method], method, *made, settings.seed)
    return tallies, refused


_COLUMNS = (
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
    Column("NEES / 6"),
    Column("mean"),
    Column("processor ms", 1),
    Column("wall ms", 1),
    Column("wall 95 %", 1),
)


def _errors(motion: str, tallies: dict[str, Tally], refused: int) -> Table:
    table = Table(
        f"{motion}: error, lost and wrong frames, time",
        _COLUMNS,
        note="NEES / 6: median and mean over frames, 0.9 and 1 are right. At the end: median rotation of the last"
        f" {END} answers. Frames lost: median length of a loss that ended. Times of all but the first frame,"
        f" segmentation included. estimate: every {SINGLE_EVERY}th frame, with a start."
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


def _slips(motion: str, tally: Tally) -> Table:
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


def _over_time(tracked: dict[tuple[str, str], dict[str, Tally]]) -> Table:
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


def _all(tracked: dict[tuple[str, str], dict[str, Tally]], method: str) -> tuple[np.ndarray, np.ndarray]:
    """Frame indices and ADD-S (m) of all answers of a method."""
    frame = [i for tallies in tracked.values() for i in tallies[method].frame]
    add_s = [x for tallies in tracked.values() for x in tallies[method].add_s]
    return np.array(frame, dtype=np.int64), np.array(add_s)


def _by_family(tracked: dict[tuple[str, str], dict[str, Tally]]) -> Table:
    """The track alone, family by family over all motions."""
    columns = [Column("family"), Column("frames", 0), Column("median ADD-S mm"), Column("wrong but ok"), Column("ok")]
    columns += [Column("NEES / 6, mean"), Column("median"), Column("processor ms", 1), Column("mean ", 1)]
    table = Table("The track by family, all motions together", columns)
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
                float(np.mean(nees)),
                float(np.median(nees)),
                float(np.median(own.cpu)) if own.cpu else None,
                float(np.mean(own.cpu)) if own.cpu else None,
            )
    return table


def _by_motion(tracked: dict[tuple[str, str], dict[str, Tally]]) -> Table:
    """The track alone, motion by motion over all families, and how it finds out that it began wrong."""
    columns = [Column("motion"), Column("frames", 0), Column("wrong but ok"), Column("ok"), Column("NEES / 6, mean")]
    columns += [Column("rotation at the end"), Column("single frames"), Column("begun wrong", 0)]
    columns += [Column("ok lost after", 0), Column("worst", 0), Column("right after", 0), Column("worst ", 0)]
    columns += [Column("never", 0)]
    table = Table("The track by motion, all families together", columns)
    table.note = "Begun wrong: sequences whose first pose is turned by 150 degrees and believed; frames from there."
    for motion in dict.fromkeys(motion for _, motion in tracked):
        own, wrong, single = Tally(), Tally(), Tally()
        for (_, name), tallies in tracked.items():
            if name == motion:
                own.pooled(tallies["track"])
                wrong.pooled(tallies["track begun wrong"])
                single.pooled(tallies["estimate"])
        if not own.add_s:
            continue
        nees = [x for x in own.nees if np.isfinite(x)]
        table.add(
            motion,
            len(own.add_s),
            Rate(own.wrong_ok, len(own.add_s)),
            Rate(sum(own.ok), len(own.ok)),
            float(np.mean(nees)) if nees else None,
            float(np.rad2deg(np.median(own.ends))) if own.ends else None,
            float(np.rad2deg(np.median(single.rotation))) if single.rotation else None,
            len(wrong.doubted),
            float(np.median(wrong.doubted)) if wrong.doubted else None,
            max(wrong.doubted, default=None),
            float(np.median(wrong.righted)) if wrong.righted else None,
            max(wrong.righted, default=None),
            wrong.never,
        )
    return table


def _chart(tracked: dict[tuple[str, str], dict[str, Tally]]) -> Chart:
    series = {}
    for method in METHODS:
        frame, add_s = _all(tracked, method)
        at = np.unique(frame)
        if not len(at):
            continue
        series[method] = [(float(i), 1e3 * float(np.median(add_s[frame == i]))) for i in at]
    return Chart("Median error over time, all families and motions", "frame", "ADD-S mm", series, log_y=True)


def _claims(tracked: dict[tuple[str, str], dict[str, Tally]]) -> list[Claim]:
    families: dict[str, Tally] = {}
    motions: dict[str, Tally] = {}
    for (family, motion), tallies in tracked.items():
        families.setdefault(family, Tally()).pooled(tallies["track"])
        motions.setdefault(motion, Tally()).pooled(tallies["track"])
    wrong = [one["track begun wrong"] for one in tracked.values()]
    cpu = [x for t in families.values() for x in t.cpu]
    out = [Claim("a tracked frame, median processor ms", float(np.median(cpu)) if cpu else float("nan"), 8.0, False, 1)]
    for name, tally in families.items():
        share = 100.0 * tally.wrong_ok / len(tally.ok) if tally.ok else float("nan")
        out.append(Claim(f"wrong but ok, % of tracked frames, {name}", share, 1.0, False, 1))
    for name, tally in motions.items():
        mean = float(np.mean([x for x in tally.nees if np.isfinite(x)] or [np.nan]))
        out.append(Claim(f"NEES / 6, mean, {name}", mean, 0.7, True))
        out.append(Claim(f"NEES / 6, mean, {name}", mean, 1.5, False))
    if any(t.doubted for t in wrong):
        late = max(x for t in wrong for x in t.doubted)
        righted = [x for t in wrong for x in t.righted]
        late_right = float("inf") if any(t.never for t in wrong) else float(max(righted, default=0))
        out.append(Claim("frames until a wrong beginning is no longer ok, most", float(late), 10.0, False, 0))
        out.append(Claim("frames until it is right, most", late_right, 30.0, False, 0))
    for (family, motion), tallies in tracked.items():
        if motion == "slip" and tallies["estimate"].rotation:
            mine, single = np.median(tallies["track"].ends), np.median(tallies["estimate"].rotation)
            what = f"rotation at the end of a slip, {family}: less than single frames' by, degrees"
            out.append(Claim(what, float(np.rad2deg(single - mine)), 0.0, True))
    return out
