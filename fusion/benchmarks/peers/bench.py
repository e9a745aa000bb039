"""Time against error with every method's budget swept, ours and others' in one run: eight fronts, a chart each.

All methods of a front get the same data on one thread; what a method prepares once an object and what is compiled is
not timed, for nobody. What is not installed is a row that says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from math import isnan
from typing import Any

from fusion.benchmarks.families.making import why_not
from fusion.benchmarks.families.table import FAMILIES
from fusion.benchmarks.families.table import chosen as chosen_families
from fusion.benchmarks.peers import arrays as peers_arrays
from fusion.benchmarks.peers import clouds as peers_clouds
from fusion.benchmarks.peers import contacts as peers_contacts
from fusion.benchmarks.peers import filters as peers_filters
from fusion.benchmarks.peers import local as peers_local
from fusion.benchmarks.peers import occlusion as peers_occlusion
from fusion.benchmarks.peers import pareto
from fusion.benchmarks.peers.pareto import Point
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Report, Table
from scenes.errors import InputError

# Families of the fronts under occlusion when it has to be quick.
QUICK = ("clean", "lab", "workshop")
# Names that ours go by.
OURS = ("palpate", "fused", "rows, then pressures (ours)")


def run(settings: BenchSettings) -> Report:
    """The fronts of vision (with and without a start), global, local, arrays, filters and occlusion (by family); those
    of occlusion alone where a family or objects are named.
    """
    report = Report("peers", "Time against error, each method at several budgets", "", settings.seed)
    trials = []
    if settings.family is None and settings.objects is None:  # the other fronts have their own objects, in no frames
        trials += [_vision(report, settings), _contacts(report, settings), _arrays(report, settings)]
        trials.append(_filters(report, settings))
    trials.append(_occlusion(report, settings))
    report.trials = ", ".join(trials)
    report.tables.append(_settings_table())
    return report


def _vision(report: Report, settings: BenchSettings) -> str:
    shown = list(peers_clouds.views(settings.count(2, quick=1), settings.seed))
    shown = shown[:3] if settings.quick else shown
    bound = peers_clouds.bound_mm(shown)
    for with_start in (True, False):
        chosen = peers_clouds.peers(with_start, settings.quick)
        what = "from a start 16° and 33 mm off" if with_start else "no start"
        points = peers_clouds.front(chosen, shown, settings.seed, settings.progress, f"vision, {what}")
        missing = {} if peers_clouds.available()[0] else {"small_gicp": peers_clouds.available()[1]}
        _add(report, settings, f"Vision: visible points, {what}", points, "ADD-S < 5 mm", bound, missing)
    return f"{len(shown)} views"


def _contacts(report: Report, settings: BenchSettings) -> str:
    felt = peers_contacts.trials(settings.count(4, quick=1), settings.seed)
    chosen = peers_contacts.peers(settings.quick)
    points = peers_contacts.front(chosen, felt, settings.seed, settings.progress, "global")
    title = f"Global: {peers_contacts.CONTACTS} contacts of {peers_contacts.NOISE}, no start"
    _add(report, settings, title, points, "< 1 cm, 15°", peers_contacts.bound_mm(felt), peers_contacts.missing())
    near = peers_local.trials(settings.count(30, quick=3), settings.seed)
    points = peers_contacts.front(peers_local.peers(settings.quick), near, settings.seed, settings.progress, "local")
    title = f"Local: {peers_local.CONTACTS} contacts of {peers_contacts.NOISE}, a start 16° and 33 mm off"
    _add(report, settings, title, points, "< 1 cm, 15°", peers_contacts.bound_mm(near, with_start=True))
    return f"{len(felt)} and {len(near)} contact sets"


def _arrays(report: Report, settings: BenchSettings) -> str:
    held = peers_arrays.cases(settings.count(2, quick=1), settings.seed)
    held = held[:2] if settings.quick else held
    points = pareto.measure(
        peers_arrays.peers(settings.quick),
        held,
        lambda case: f"{case.grasp}{id(case.problem)}",
        peers_arrays.judged,
        settings.seed,
        settings.progress,
        "arrays",
    )
    _add(report, settings, "Arrays: a start up to 20° and 10 mm off per axis", points, "< 1 cm, 15°", None)
    return f"{len(held)} array recordings"


def _filters(report: Report, settings: BenchSettings) -> str:
    try:
        sets = peers_filters.cases(settings.count(1, quick=1), settings.quick)
    except InputError as error:
        table = Table("Filters: recorded contacts", [Column("method"), Column("why not")])
        table.add("all", str(error))
        report.tables.append(table)
        return "no recorded sets"
    chosen = peers_filters.peers(settings.quick)
    points = peers_filters.front(chosen, sets, settings.seed, settings.progress, "filters")
    title = "Filters: recorded contacts, mean distance to the surface above the least reached"
    _add(report, settings, title, points, "< 5 mm above", None)
    return f"{len(sets)} filter trials"


def _occlusion(report: Report, settings: BenchSettings) -> str:
    count = 0
    short = settings.quick and settings.family is None
    families = [FAMILIES[name] for name in QUICK] if short else chosen_families(settings.family)
    for family in families:
        if why_not(family):
            report.tables.append(Table(f"Occlusion: {family.name}", [Column("method"), Column("why not")]))
            report.tables[-1].add("all", why_not(family))
            continue
        trials = settings.count(1, quick=1)
        frames = peers_occlusion.cases(family, trials, settings.seed, settings.quick, settings.objects)
        if not frames:
            continue
        chosen = peers_occlusion.peers(settings.quick)
        points = peers_occlusion.front(chosen, frames, settings.seed, settings.progress, f"occlusion, {family.name}")
        bound = peers_occlusion.bound_mm(frames) if family.name == "clean" else None
        share = peers_occlusion.hidden(family)
        much = "as recorded" if isnan(share) else f"{share:.0%} hidden"
        title = f"Occlusion: {family.name}, {much}, a start 16° and 33 mm off"
        _add(report, settings, title, points, "ADD-S < 5 mm", bound)
        count += len(frames)
    if not count and settings.objects is not None:
        names = ", ".join(settings.objects)
        raise InputError(f"objects: expected some of the families' objects, got {names} that none has")
    return f"{count} frames"


def _add(
    report: Report,
    settings: BenchSettings,
    title: str,
    points: Sequence[Point],
    success: str,
    bound: float | None,
    missing: dict[str, str] | None = None,
) -> None:
    note = "*: no other point is as fast and as near."
    if bound is not None:
        note += f" Cramér-Rao bound of the median error: {bound:.3f} mm."
    report.tables.append(pareto.table(title, points, success, note))
    report.charts.append(pareto.chart(title, points, bound))
    for name, how in (missing or {}).items():
        _absent(report.tables[-1], name, how)
    best = pareto.frontier([point.place for point in points])
    ours = [point for point, is_best in zip(points, best, strict=True) if is_best and point.method in OURS]
    report.claims.append(Claim(f"{title}: points of ours that nobody beats", len(ours), 1, True, 0))
    settings.show(report.tables[-1])


def _absent(table: Table, name: str, how: str) -> None:
    table.rows.append([name, how, *[None] * (len(table.columns) - 3), ""])


def _settings_table() -> Table:
    from touch.published.optimisers.direct import BoxSettings
    from vision.published.icp import CloudIcpSettings
    from vision.published.registration import BaselineSettings

    table = Table("Settings of the peers, but for the budget swept", [Column("setting"), Column("value")])
    parts: dict[str, Any] = {"icp": CloudIcpSettings(), "baselines": BaselineSettings(), "scipy": BoxSettings()}
    for part, values in parts.items():
        for name, value in asdict(values).items():
            table.add(f"{part}: {name.replace('_', ' ')}", str(value))
    for name, value in (
        ("transforms", peers_contacts.CHSEL_BATCH),
        ("lattice, m", peers_contacts.CHSEL_RESOLUTION),
        ("free space outside a contact, m", peers_contacts.FREE_AWAY),
    ):
        table.add(f"chsel: {name}", str(value))
    return table
