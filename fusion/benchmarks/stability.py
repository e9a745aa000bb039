"""The stability suite as a table: every case that the tests run, what it tried, the worst number it met, its time.

The cases come with the sources (tests/stability), not with an installation: a user needs none of them.

A quick run leaves out slow cases (a million faces, 10^5 random tables) and all inputs but one to the same thing. A case
that fails says what broke it.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Protocol

from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Report, Table
from scenes.errors import InputError

# Where a source checkout has the package `cases`.
FOLDER = Path(__file__).resolve().parents[2] / "tests" / "stability"


class Case(Protocol):
    """theme, what is tried, for the table; number: what run() returns, with its unit; run() raises when it broke."""

    theme: str
    what: str
    number: str
    run: Callable[[], float]


@dataclass(frozen=True)
class Outcome:
    """number: the worst one met, NaN when the case broke; broken: with what words, "" when it held; seconds."""

    case: Case
    number: float
    broken: str
    seconds: float


def all_cases(slow: bool | None) -> list[Case]:
    """Every case, only the slow or only the fast ones when asked for; raises InputError where there are none."""
    if not (FOLDER / "cases" / "registry.py").is_file():
        raise InputError(f"bench stability: expected its cases in {FOLDER}; they come with the sources of palpate")
    if str(FOLDER) not in sys.path:
        sys.path.append(str(FOLDER))
    found: list[Case] = import_module("cases.registry").all_cases(slow)
    return found


def run(settings: BenchSettings) -> Report:
    """Run every case; one row for what is tried, over all inputs it is tried on.

    Raises InputError in an installation, which has no cases.
    """
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
    except AssertionError as error:  # the case's own judgement
        number, broken = math.nan, str(error) or type(error).__name__
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
