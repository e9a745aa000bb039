"""Are answers that are so sure right so often? What they state against what is observed, by family.

Answers are sorted into bins by their confidence; in each, the mean of what is stated should be the share that is right
(DeGroot and Fienberg, The Statistician 1983). The expected calibration error is the mean gap between the two, bins
weighed by their answers (Naeini, Cooper and Hauskrecht, AAAI 2015). Few answers leave a gap by chance alone, however
honest: what a right answerer of the same confidences would show is told beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.families.table import FAMILIES, REPORT, TUNING
from fusion.benchmarks.printing.charts import Chart
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Rate, Report, Table
from fusion.benchmarks.strata import WRONG, Answer

Array = NDArray[np.float64]

SENSES = ("fused", "vision", "touch")
# Bounds of the bins: fine where answers are `ok`, which most of them are.
EDGES = (0.0, 0.2, 0.5, 0.8, 0.9, 0.95, 0.98, 1.0)
# Largest expected calibration error that is demanded.
MOST = 0.03
# Draws of a right answerer.
DRAWS = 400


@dataclass(frozen=True)
class Bin:
    """Answers whose confidence is from low to high (the last bin holds 1): mean stated, and how many were right."""

    low: float
    high: float
    stated: float
    right: Rate


def bins_of(stated: Array, right: NDArray[np.bool_]) -> list[Bin]:
    """The bins that hold an answer, of confidences (n,) and whether each answer was right (n,)."""
    out = []
    for k, (low, high) in enumerate(pairwise(EDGES)):
        inside = (stated >= low) & ((stated < high) | (k == len(EDGES) - 2))
        if inside.any():
            out.append(Bin(low, high, float(stated[inside].mean()), Rate.of(right[inside])))
    return out


def expected_error(stated: Array, right: NDArray[np.bool_]) -> float:
    """The expected calibration error (a share) of confidences (n,); NaN without answers."""
    if not len(stated):
        return float("nan")
    gaps = [one.right.n * abs(one.stated - one.right.share) for one in bins_of(stated, right)]
    return float(sum(gaps) / len(stated))


def by_chance(stated: Array, seed: int = 0) -> float:
    """Mean expected calibration error of right answerers with these confidences (n,); NaN without answers."""
    if not len(stated):
        return float("nan")
    rng = np.random.default_rng(seed)
    return float(np.mean([expected_error(stated, rng.random(len(stated)) < stated) for _ in range(DRAWS)]))


def add_reliability(report: Report, answers: Sequence[Answer], settings: BenchSettings) -> None:
    """By family and role: the error of each, the bins of each, the diagram, and what is demanded of each role."""
    told = [a for a in answers if np.isfinite(a.confidence)]
    summary, details, series = _summary_table(), _bins_table(), {"right": [(0.0, 0.0), (100.0, 100.0)]}
    for sense in SENSES:
        mine = [a for a in told if a.method == sense]
        for name, family in FAMILIES.items():
            _add(summary, details, name, family.role, sense, [a for a in mine if a.family == name])
        for role in (TUNING, REPORT):
            pooled = [a for a in mine if FAMILIES[a.family].role == role]
            if not pooled:
                continue
            stated, right = _add(summary, details, "all", role, sense, pooled)
            series[f"{sense}, {role}"] = [(100 * b.stated, 100 * b.right.share) for b in bins_of(stated, right)]
            if sense == "fused":
                what = f"{role} families, fused: expected calibration error of the confidence"
                report.claims.append(Claim(what, expected_error(stated, right), MOST, False, 3))
    for table in (summary, details):
        report.tables.append(table)
        settings.show(table)
    report.charts.append(Chart("Confidence: stated and observed", "stated, %", "right, %", series))


def _add(
    summary: Table, details: Table, family: str, role: str, sense: str, answers: Sequence[Answer]
) -> tuple[Array, NDArray[np.bool_]]:
    """One row of the summary, one a bin of the details; none without answers. Returns what was stated and was right."""
    stated = np.array([a.confidence for a in answers], dtype=np.float64)
    right = np.array([a.right for a in answers], dtype=bool)
    if len(answers):
        error, chance = expected_error(stated, right), by_chance(stated)
        numbers = (100 * float(stated.mean()), Rate.of(right), 100 * error, 100 * chance)
        summary.add(family, role, sense, len(answers), *numbers)
        for one in bins_of(stated, right):
            low, high = one.right.interval
            between = f"{100 * low:.0f}-{100 * high:.0f}"
            span = f"{100 * one.low:g}-{100 * one.high:g} %"
            details.add(family, role, sense, span, one.right.n, 100 * one.stated, one.right, between)
    return stated, right


def _summary_table() -> Table:
    columns = [Column("family"), Column("role"), Column("sense"), Column("answers", 0), Column("stated %", 1)]
    columns += [Column("right"), Column("calibration error %", 1), Column("of it by chance %", 1)]
    note = (
        f"With a start and without. stated: mean confidence that ADD-S is below {1e3 * WRONG:g} mm; right: the share of"
        " which it was. Calibration error: mean gap between the two over the bins of the next table; by chance: what a"
        " right answerer of the same confidences shows with so few answers."
    )
    return Table("Confidence against the truth", columns, note=note)


def _bins_table() -> Table:
    columns = [Column("family"), Column("role"), Column("sense"), Column("stated"), Column("answers", 0)]
    columns += [Column("mean stated %", 1), Column("right"), Column("95 % of that")]
    note = "Bins of the confidence; a right one has its mean stated inside the interval (Wilson) of what is right."
    return Table("Reliability: stated against observed", columns, note=note)
