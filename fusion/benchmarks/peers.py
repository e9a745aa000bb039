"""Others' methods and ours in one run: time against error with every method's budget swept, on clouds and on contacts.

What is not installed is a row that says so. Times are by the clock: ours on PALPATE_THREADS threads, ICP and small_gicp
on one, the features of Open3D and OpenCV on what they take.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from fusion.benchmarks import pareto, peers_clouds, peers_contacts
from fusion.benchmarks.pareto import Point
from fusion.benchmarks.tables import BenchSettings, Claim, Column, Report, Table


def run(settings: BenchSettings) -> Report:
    """Clouds with and without a start, contacts; each a table and a chart with the Cramér-Rao bound; settings shown."""
    from touch.searches.direct import BoxSettings
    from vision.baselines import BaselineSettings
    from vision.registration import IcpSettings

    count = settings.count(4, quick=1)
    shown = list(peers_clouds.views(count, settings.seed))
    felt = peers_contacts.trials(settings.count(10, quick=2), settings.seed)
    if settings.quick:
        shown = shown[:3]
    report = Report(
        "peers", "Peers, each at several budgets", f"{len(shown)} views, {len(felt)} contact sets", settings.seed
    )
    for with_start in (True, False):
        chosen = [peer for peer in peers_clouds.peers(settings.quick) if peer.with_start == with_start]
        points = peers_clouds.measure(chosen, shown, settings.seed, settings.progress)
        what = "from a start 16 degrees and 33 mm off" if with_start else "without a start"
        _add(report, f"Visible clouds {what}", points, "ADD-S < 5 mm", peers_clouds.bound_mm(shown))
        there, how = peers_clouds.available()
        if with_start and not there:
            _absent(report.tables[-1], "small_gicp", how)
        settings.show(report.tables[-1])
    points = peers_contacts.measure(peers_contacts.peers(settings.quick), felt, settings.seed, settings.progress)
    title = f"{peers_contacts.CONTACTS} contacts of {peers_contacts.NOISE}, no start"
    _add(report, title, points, "< 1 cm, 15°", peers_contacts.bound_mm(felt))
    for name, how in peers_contacts.missing().items():
        _absent(report.tables[-1], name, how)
    settings.show(report.tables[-1])
    table = Table("Settings of the peers, but for the budget swept", [Column("setting"), Column("value")])
    parts: dict[str, Any] = {"icp": IcpSettings(), "baselines": BaselineSettings(), "scipy": BoxSettings()}
    for part, values in parts.items():
        for name, value in asdict(values).items():
            table.add(f"{part}: {name.replace('_', ' ')}", str(value))
    report.tables.append(table)
    return report


def _add(report: Report, title: str, points: Sequence[Point], success: str, bound: float) -> None:
    note = f"Cramér-Rao bound, median over the trials: {bound:.3f} mm. * : no other point is as fast and as near."
    report.tables.append(pareto.table(title, points, success, note))
    report.charts.append(pareto.chart(title, points, bound))
    best = pareto.frontier([point.place for point in points])
    ours = [point for point, is_best in zip(points, best) if is_best and point.method == "palpate"]
    report.claims.append(Claim(f"{title}: points of ours that nobody beats", len(ours), 1, True, 0))


def _absent(table: Table, name: str, how: str) -> None:
    table.rows.append([name, how, *[None] * (len(table.columns) - 3), ""])
