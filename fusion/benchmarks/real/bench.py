"""Recorded frames: ours against what others make of the same depth images, judged by truth, mask and outline.

`palpate bench real [--data DIR] [--bop DIR]`: captures in DIR or its part `real`, recorded grasps in DIR or its part
`icub-handover`, and the scenes of any BOP data set. No depth here comes from a simulator of ours, but for the fingers
that are drawn before the object in one table.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Quantile, Rate, Report, Table
from fusion.benchmarks.real import frames as recordings
from fusion.benchmarks.real import grasps
from fusion.benchmarks.real.absent import look_for_others
from fusion.benchmarks.real.diagnosis import diagnose
from fusion.benchmarks.real.frames import Recorded
from fusion.benchmarks.real.hidden import look_behind
from fusion.benchmarks.real.sheet import contact_sheet
from fusion.benchmarks.real.trials import METHODS, OURS, STARTS, Start, Trial, trials, warm_up
from scenes.errors import InputError

# Tries of every case of a frame; captures used in a hurry.
TRIALS, QUICK_TRIALS, QUICK_FRAMES = 3, 1, 3
# Images of one recording that are used, evenly picked: frames of a video repeat one another.
IMAGES = 3
# An answer that these data cannot tell from the reference: its mask's distance within a millimetre (a depth camera's
# noise at arm's length) and its overlap within a tenth of the reference's (ragged borders).
AS_GOOD_RESIDUAL, AS_GOOD_OVERLAP = 0.001, 0.1
# Chi-square quantile of the 95 % region of a pose, six degrees of freedom.
REGION_95 = 12.59

Case = tuple[bool, Start]


def run(settings: BenchSettings) -> Report:
    """All tables, a claim or two a case, and the sheet."""
    count = settings.count(TRIALS, QUICK_TRIALS)
    root = recordings.folder(settings.data) if settings.data is not None or settings.bop is None else None
    ones: list[Recorded] = []
    left: list[str] = []
    for found in _found(root, settings):
        if isinstance(found, str):
            left.append(found)
        else:
            ones.append(found)
    touched = recordings.grasps(root) if root is not None else []
    if not ones and not touched:
        where = settings.bop if root is None else root
        raise InputError(
            f"bench real: expected recorded frames in {where}, found none{_why(left)} (say --data or --bop)"
        )
    known = sum(one.truth is not None for one in ones)
    made = f"{len(ones)} frames ({known} with a true pose) x {count} tries a case"
    report = Report("real", "Recorded frames", f"{made}, {len(touched)} grasps", settings.seed)
    if ones:
        _look(report, ones, left, settings, count)
    if touched:
        report.tables.append(grasps.table(touched, settings, count))
        settings.show(report.tables[-1])
    return report


def _found(root: Path | None, settings: BenchSettings) -> Iterable[Recorded | str]:
    images, most = (1, QUICK_FRAMES) if settings.quick else (IMAGES, None)
    if root is not None:
        yield from recordings.captures(root, images, most)
    if settings.bop is not None:
        yield from recordings.bop_frames(settings.bop, images, most)


def _why(left: Sequence[str]) -> str:
    return f": {'; '.join(left)}" if left else ""


def _look(report: Report, ones: list[Recorded], left: list[str], settings: BenchSettings, count: int) -> None:
    report.tables.append(_frames_table(ones, left))
    settings.show(report.tables[-1])
    warm_up(ones[0])
    found: list[Trial] = []
    for one in settings.progress(ones, len(ones), "frames"):
        found += trials(one, STARTS, count, settings.seed)
    by_case: dict[Case, list[Trial]] = defaultdict(list)
    for t in found:
        by_case[t.mask, t.start].append(t)
    for table in (_cases_table(by_case, ones), _each_table(by_case, ones), _wrong_table(by_case, ones)):
        report.tables.append(table)
        settings.show(table)
    _claims(report, by_case)
    rows = []
    for one in ones:
        answers = []
        for (mask, start), here in by_case.items():
            ours = [t for t in here if t.frame == one.name and t.method == OURS]
            if ours and not start.once:
                heading = f"{'mask' if mask else 'no mask'}, {start.words}"
                answers.append((heading, max(ours, key=lambda t: (t.wrong, t.residual))))
        rows.append((one, answers))
    title = f"palpate on recorded frames, the worst of {count} tries, seed {settings.seed}"
    report.pictures["sheet"] = contact_sheet(rows, title)
    look_behind(report, ones, settings)
    look_for_others(report, ones, settings)


def _frames_table(ones: list[Recorded], left: list[str]) -> Table:
    columns = [Column("frame"), Column("pixels", 0), Column("at the given pose mm"), Column("it is the truth")]
    columns += [Column("floor mm"), Column("floor overlap")]
    table = Table("Frames, and what they can tell", columns)
    s = ones[0].settings
    for one in ones:
        at = 1e3 * one.given_residual
        table.add(one.name, len(one.points), at, one.truth is not None, 1e3 * one.floor, one.floor_overlap)
    table.note = (
        "Median distance of the mask's pixels from the surface. A given pose within"
        f" {1e3 * s.true_within:.1f} mm, or one of a BOP data set, is the truth."
        " Floor: the best of two ICPs on the mask's own pixels from the given pose; without a truth starts are drawn"
        " around it, and the measure is what ICP makes small: such frames favour ICP."
    )
    if left:
        table.note += f" Left out: {'; '.join(left)}."
    return table


def _as_good(t: Trial, one: Recorded) -> bool:
    return t.residual <= one.floor + AS_GOOD_RESIDUAL and t.overlap >= one.floor_overlap - AS_GOOD_OVERLAP


def _cases_table(by_case: dict[Case, list[Trial]], ones: list[Recorded]) -> Table:
    named = {one.name: one for one in ones}
    columns = [
        Column("mask"),
        Column("start"),
        Column("method"),
        Column("tries", 0),
        Column("right"),
        Column("as good"),
    ]
    columns += [Column("true: tries", 0), Column("ADD-S < 5 mm"), Column("median mm"), Column("95 % hold")]
    columns += [Column("mask mm"), Column("overlap"), Column("ok / ambiguous / lost"), Column("wrong but ok", 0)]
    columns += [Column("ok, not as good", 0), Column("ms", 0)]
    table = Table("Recorded frames: ours and others", columns)
    s = ones[0].settings
    for (mask, start), here in by_case.items():
        for method in (m for m in METHODS if any(t.method == m for t in here)):
            some = [t for t in here if t.method == method]
            true = [t for t in some if t.true]
            ours = method == OURS
            nees = np.array([t.nees for t in true])
            table.add(
                "mask" if mask else "none",
                start.name,
                method,
                len(some),
                Rate.of([not t.wrong for t in some]),
                Rate.of([_as_good(t, named[t.frame]) for t in some]),
                len(true),
                Rate.of([t.add_s <= s.wrong_add_s for t in true]),
                Quantile.of([t.add_s for t in true], 1e3),
                Rate.of(nees <= REGION_95) if ours else None,
                Quantile.of([t.residual for t in some], 1e3),
                Quantile.of([t.overlap for t in some]),
                _verdicts(some) if ours else None,
                sum(t.wrong and t.verdict == "ok" for t in some) if ours else None,
                sum(t.verdict == "ok" and not _as_good(t, named[t.frame]) for t in some) if ours else None,
                Quantile.of([t.time_ms for t in some]),
            )
    table.note = (
        f"Right: ADD-S up to {1e3 * s.wrong_add_s:.0f} mm where the pose is true; elsewhere the mask's pixels within"
        f" {1e3 * s.wrong_residual:.0f} mm (median) and an overlap of outline and mask of {s.wrong_overlap:.1f} or"
        " more, which lets some visibly wrong answers pass. As good: within"
        f" {1e3 * AS_GOOD_RESIDUAL:.0f} mm and {AS_GOOD_OVERLAP:.1f} of the floor's. 95 % hold: the truth lies in"
        " the region that our covariance says. ICP without a start begins at the mask's middle, unturned. Medians of"
        " mask distance, overlap and time; ours include the segmentation, and so do those of all others."
    )
    return table


def _verdicts(some: Iterable[Trial]) -> str:
    words = Counter(t.verdict for t in some)
    return " / ".join(str(words[word]) for word in ("ok", "ambiguous", "lost"))


def _each_table(by_case: dict[Case, list[Trial]], ones: list[Recorded]) -> Table:
    """A row a frame and case: ours beside plain ICP and the best of all others."""
    columns = [Column("frame"), Column("mask"), Column("start"), Column("floor mm"), Column("right"), Column("mask mm")]
    columns += [Column("overlap"), Column("ok / ambiguous / lost"), Column("icp right"), Column("icp mm")]
    columns += [Column("best other right"), Column("best other mm"), Column("best other")]
    table = Table("Frame by frame", columns, note="Best other: of all that are not ours, most right, then nearest.")
    for one in ones:
        for (mask, start), here in by_case.items():
            mine: dict[str, list[Trial]] = defaultdict(list)
            for t in here:
                if t.frame == one.name:
                    mine[t.method].append(t)
            ours = mine.pop(OURS, [])
            if not ours:
                continue
            ranked = sorted((-_share(some), _middle(some), name) for name, some in mine.items())
            best = mine[ranked[0][2]] if ranked else []
            plain = mine.get("icp", [])
            table.add(
                one.name,
                "mask" if mask else "none",
                start.name,
                1e3 * one.floor,
                _of(ours),
                1e3 * _middle(ours),
                Quantile.of([t.overlap for t in ours]),
                _verdicts(ours),
                _of(plain) if plain else None,
                1e3 * _middle(plain) if plain else None,
                _of(best) if best else None,
                1e3 * _middle(best) if best else None,
                ranked[0][2] if ranked else None,
            )
    return table


def _share(some: Sequence[Trial]) -> float:
    return float(np.mean([not t.wrong for t in some])) if some else float("nan")


def _middle(some: Sequence[Trial]) -> float:
    return float(np.median([t.residual for t in some])) if some else float("nan")


def _of(some: Sequence[Trial]) -> str:
    return f"{sum(not t.wrong for t in some)} of {len(some)}"


def _wrong_table(by_case: dict[Case, list[Trial]], ones: list[Recorded]) -> Table:
    """Where ours are wrong, and what is to blame: a row a frame and case."""
    columns = [Column("frame"), Column("mask"), Column("start"), Column("wrong"), Column("ok / ambiguous / lost")]
    columns += [Column("ADD-S mm"), Column("mask mm"), Column("overlap"), Column("costs more by nats", 1)]
    columns += [Column("right without joint solution"), Column("from the reference")]
    table = Table("Wrong answers of ours, and why", columns)
    table.note = (
        "Medians over the wrong answers. Costs more: the answer's cost of pixels and sight lines less the reference's,"
        " as the search ranks them; below 0 the objective prefers the wrong pose. Without the joint solution"
        " (--budget-ms 0): how many are right then. From the reference: what ours makes of the same frame when it is"
        " started there."
    )
    for one in ones:
        for (mask, start), here in by_case.items():
            ours = [t for t in here if t.frame == one.name and t.method == OURS]
            wrong = [t for t in ours if t.wrong]
            if not wrong:
                continue
            why = [diagnose(one, t, t.seed) for t in wrong]
            there = [t for (m, at), all_of in by_case.items() if m == mask and at.once for t in all_of]
            ended = ["wrong" if t.wrong else "right" for t in there if t.frame == one.name and t.method == OURS]
            table.add(
                one.name,
                "mask" if mask else "none",
                start.name,
                f"{len(wrong)} of {len(ours)}",
                _verdicts(wrong),
                Quantile.of([t.add_s for t in wrong], 1e3),
                Quantile.of([t.residual for t in wrong], 1e3),
                Quantile.of([t.overlap for t in wrong]),
                Quantile.of([d.excess for d in why]),
                f"{sum(d.skipped_right for d in why)} of {len(wrong)}",
                ended[0] if ended else None,
            )
    return table


def _claims(report: Report, by_case: dict[Case, list[Trial]]) -> None:
    """A case is met when ours is right as often as the best of the others, and nothing wrong says `ok`."""
    for (mask, start), here in by_case.items():
        if start.once:
            continue
        what = f"{'mask' if mask else 'no mask'}, {start.words}"
        shares = {m: _share([t for t in here if t.method == m]) for m in METHODS if any(t.method == m for t in here)}
        ours = shares.pop(OURS)
        best = max(shares, key=lambda m: shares[m])
        report.claims.append(Claim(f"{what}: right, against {best}", ours, shares[best], True))
        sure = sum(t.method == OURS and t.wrong and t.verdict == "ok" for t in here)
        report.claims.append(Claim(f"{what}: wrong but ok", sure, 0, False, 0))
