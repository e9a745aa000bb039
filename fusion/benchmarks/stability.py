"""The stability suite as a table: every case that the tests run, what it tried, the worst number it met, its time.

A quick run leaves out slow cases (a million faces, 10^5 random tables) and all inputs but one to the same thing. A case
that fails says what broke it.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

from cases.registry import Case, Unstable, all_cases

from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Report, Table


@dataclass(frozen=True)
class Outcome:
    """number: the worst one met, NaN when the case broke; broken: with what words, "" when it held; seconds."""

    case: Case
    number: float
    broken: str
    seconds: float


def run(settings: BenchSettings) -> Report:
    """Run every case; one row for what is tried, over all inputs it is tried on."""
    import warnings

    cases = all_cases(slow=False if settings.quick else None)
    if settings.quick:  # one input for each thing that is tried
        cases = list({(case.theme, case.what): case for case in reversed(cases)}.values())[::-1]
    report = Report(
        "stability", "What tries to break it", f"{len(cases)} cases, the list that the tests run", settings.seed
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # overflow is what the cases are made of
        outcomes = [outcome(case) for case in settings.progress(cases, len(cases), "stability")]
    report.tables.append(_table(outcomes))
    broken = [one for one in outcomes if one.broken]
    if broken:
        report.tables.append(_failures(broken))
    report.claims.append(Claim("cases that hold, of all", 1.0 - len(broken) / len(cases), 1.0, True, 4))
    return report


def outcome(case: Case) -> Outcome:
    """Run one case; an exception of any kind is a case that broke."""
    begin = time.perf_counter()
    try:
        number, broken = float(case.run()), ""
    except Unstable as error:
        number, broken = math.nan, str(error)
    except Exception as error:  # noqa: BLE001  (the suite goes on to its other cases)
        number, broken = math.nan, f"{type(error).__name__}: {error}"
    return Outcome(case, number, broken, time.perf_counter() - begin)


def _table(outcomes: list[Outcome]) -> Table:
    table = Table(
        "Cases by theme",
        [
            Column("theme"),
            Column("what is tried"),
            Column("cases", 0),
            Column("held", 0),
            Column("worst number"),
            Column("of"),
            Column("s", 2),
        ],
    )
    groups: dict[tuple[str, str], list[Outcome]] = {}
    for one in outcomes:
        groups.setdefault((one.case.theme, one.case.what), []).append(one)
    for (theme, what), members in groups.items():
        numbers = [one.number for one in members if not math.isnan(one.number)]
        number = members[0].case.number
        table.add(
            theme,
            what,
            len(members),
            sum(not one.broken for one in members),
            f"{max(numbers):.3g}" if numbers and number else None,
            number or None,
            sum(one.seconds for one in members),
        )
    held = sum(not one.broken for one in outcomes)
    table.note = f"{held} of {len(outcomes)} cases held, in {sum(one.seconds for one in outcomes):.0f} s."
    return table


def _failures(broken: list[Outcome]) -> Table:
    table = Table("Cases that broke", [Column("case"), Column("with")])
    for one in broken:
        table.add(str(one.case), one.broken[:200])
    return table
