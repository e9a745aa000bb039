"""Is an answer as sure as it is right? NEES, coverage, verdicts by family and hidden share, with and without a start;
how often answers are right that state how sure they are.

Every frame is another grasp, view and draw of all errors (docs/evaluation.md names the families).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.families.table import FAMILIES, REPORT, TUNING, chosen
from fusion.benchmarks.frames.reliability import add_reliability
from fusion.benchmarks.printing.charts import Chart
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Quantile, Rate, Report, Table
from fusion.benchmarks.strata import Answer, add_strata, cells_of, collect

Array = NDArray[np.float64]

SENSES = ("fused", "vision", "touch")
# Regions whose coverage is told, and those of the curve.
REGIONS = (0.5, 0.9, 0.95, 0.99)
CURVE = (*(k / 20 for k in range(1, 20)), 0.99)


def run(settings: BenchSettings) -> Report:
    """Tables by family and hidden share, with a start and without; by verdict; the reliability curve."""
    trials = settings.count(2, quick=1)
    cells, missing = cells_of(chosen(settings.family), trials, settings)
    report = Report(
        "calibration",
        "Is an answer as sure as it is right? By family and hidden share"
        + (", told how large each family's errors are" if settings.told else ""),
        f"{len(cells) * trials} frames at most, {trials} of each object at each hidden share, each its own draw",
        settings.seed,
    )
    answers = collect(cells, settings)
    add_strata(report, answers, missing, settings)
    add_reliability(report, answers, settings)
    with_start = [a for a in answers if a.start]
    _by_verdict(report, with_start, settings)
    _curve(report, with_start)
    _tuned(report, with_start)
    return report


def _tuned(report: Report, answers: Sequence[Answer]) -> None:
    """What is demanded where settings may be tuned."""
    fused = [a for a in answers if a.method == "fused" and FAMILIES[a.family].role == TUNING]
    if fused:
        ratio = float(np.mean([a.per_dof for a in fused]))
        report.claims += [
            Claim("tuning families, fused: mean NEES / dof, at least", ratio, 0.9, True),
            Claim("tuning families, fused: mean NEES / dof, at most", ratio, 1.1, False),
        ]


def _row(found: Sequence[Answer]) -> list[object]:
    ratio, share = np.array([a.per_dof for a in found]), np.array([a.share for a in found])
    return [
        len(found),
        Quantile.of([a.add_s for a in found], 1e3),
        Rate.of([a.right for a in found]),
        float(np.mean(ratio)),
        _trimmed(ratio),
        *(Rate.of(share <= p) for p in REGIONS),
    ]


def _trimmed(values: Array) -> float:
    """Mean without the largest hundredth: a few answers in another mode outweigh a thousand otherwise."""
    return float(np.sort(values)[: max(1, int(np.ceil(0.99 * len(values))))].mean())


def _by_verdict(report: Report, answers: Sequence[Answer], settings: BenchSettings) -> None:
    columns = [Column("role"), Column("sense"), Column("verdict"), Column("frames", 0), Column("ADD-S mm")]
    columns += [Column("< 5 mm"), Column("NEES / dof"), Column("99 % of them"), *(Column(f"{p:.0%}") for p in REGIONS)]
    note = (
        "With a start. NEES / dof: mean, 1 is right; 99 % of them: without the largest hundredth. Last columns: share"
        " of the truths that regions of so much hold."
    )
    table = Table("The verdict against the truth", columns, note=note)
    for role in (TUNING, REPORT):
        for sense in SENSES:
            mine = [a for a in answers if a.method == sense and FAMILIES[a.family].role == role]
            for verdict in ("ok", "ambiguous", "lost"):
                found = [a for a in mine if a.verdict == verdict]
                if found:
                    table.add(role, sense, verdict, *_row(found))
    report.tables.append(table)
    settings.show(table)


def _curve(report: Report, answers: Sequence[Answer]) -> None:
    series = {"right": [(0.0, 0.0), (100.0, 100.0)]}
    for role in (TUNING, REPORT):
        for sense in SENSES:
            shares = np.array([a.share for a in answers if a.method == sense and FAMILIES[a.family].role == role])
            if len(shares):
                inside = [100 * float(np.mean(shares <= p)) for p in CURVE]
                series[f"{sense}, {role}"] = [(100 * p, y) for p, y in zip(CURVE, inside)]
    report.charts.append(Chart("Reliability: truths inside the p-region", "p, %", "inside, %", series))
