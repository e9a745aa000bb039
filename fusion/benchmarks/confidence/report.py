"""Tables of a fit: is what it says true of families that it has not seen, and what would be `ok`; its factors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.confidence.answers import Told
from fusion.benchmarks.confidence.fit import TOLERANCES, Fitted, as_literal
from fusion.benchmarks.frames.reliability import MOST, by_chance, expected_error
from fusion.benchmarks.printing.tables import Claim, Column, Rate, Report, Table
from fusion.estimation.posterior.confidence import ConfidenceSettings

Array = NDArray[np.float64]

# Confidences from which on an answer could be called `ok`.
THRESHOLDS = (0.85, 0.9, 0.95)


def report_of(fits: Sequence[Fitted], seed: int, settings: ConfidenceSettings | None = None) -> Report:
    """What the fits say of families that they were not fitted to, beside what the settings say of all."""
    settings = settings or ConfidenceSettings()
    answers = [told for one in fits for told in one.answers]
    frames = len({told.place for told in answers})
    report = Report(
        "fit-confidence",
        "The confidence, fitted to tuning families",
        f"{len(answers)} answers to {frames} frames",
        seed,
    )
    held = np.concatenate([one.held for one in fits])
    now = np.concatenate([one.sample.confidence(getattr(settings, one.name), settings.tolerance) for one in fits])
    of_all = [make(answers, held, now, settings) for make in (_calibration, _verdicts)]
    report.tables += [*of_all, *(_factors(one, settings) for one in fits)]
    error = expected_error(held, _right(answers, settings))
    report.claims.append(Claim("left out in turn: expected calibration error of the confidence", error, MOST, False, 3))
    return report


def literals(fits: Sequence[Fitted]) -> list[str]:
    """The fields of `ConfidenceSettings` as they would stand there."""
    return [f"{one.name}: Regression = {as_literal(one.factors)}" for one in fits]


def _right(answers: Sequence[Told], settings: ConfidenceSettings) -> NDArray[np.bool_]:
    return np.array([told.add_s < settings.tolerance for told in answers], dtype=bool)


def _groups(answers: Sequence[Told]) -> Iterator[tuple[str, str, NDArray[np.bool_]]]:
    """(family, method, which answers) of every row: a family and method, a family, a method, all."""
    families, methods = np.array([a.family for a in answers]), np.array([a.method for a in answers])
    every = np.ones(len(answers), dtype=bool)
    for family in (*sorted(set(families.tolist())), "all"):
        of = every if family == "all" else families == family
        for method in (*sorted(set(methods[of].tolist())), "all"):
            yield family, method, of & (every if method == "all" else methods == method)


def _calibration(answers: Sequence[Told], held: Array, now: Array, settings: ConfidenceSettings) -> Table:
    columns = [Column("family"), Column("method"), Column("answers", 0), Column("right"), Column("stated %", 1)]
    columns += [Column("error %", 1), Column("by chance %", 1), Column("stated now %", 1), Column("error now %", 1)]
    note = (
        f"right: ADD-S below {1e3 * settings.tolerance:g} mm. stated: mean confidence by the fit that has not seen the"
        " family; error: its expected calibration error; by chance: what a right answerer of the same confidences shows"
        " with so few answers. now: of the settings as they stand, which may have been fitted to these."
    )
    table = Table("Every family left out in turn: stated against the truth", columns, note=note)
    right = _right(answers, settings)
    for family, method, which in _groups(answers):
        stated, today, true = held[which], now[which], right[which]
        numbers = 100 * float(stated.mean()), 100 * expected_error(stated, true), 100 * by_chance(stated)
        since = 100 * float(today.mean()), 100 * expected_error(today, true)
        table.add(family, method, len(true), Rate.of(true), *numbers, *since)
    return table


def _verdicts(answers: Sequence[Told], held: Array, now: Array, settings: ConfidenceSettings) -> Table:
    columns = [Column("family"), Column("method"), Column("right", 0), Column("wrong", 0)]
    for what in (*(f"{threshold:.2f}" for threshold in THRESHOLDS), f"now {settings.sure:.2f}"):
        columns += [Column(f"{what}: ok of right"), Column("of wrong")]
    note = (
        "Answers that are right and wrong, and the share of each that would be `ok` at a confidence of that or more, by"
        " the fit that has not seen the family: every other rule of the verdict holds, too. now: as the settings stand."
    )
    table = Table("Every family left out in turn: what would be ok", columns, note=note)
    right, rest = _right(answers, settings), np.array([told.rest_ok for told in answers], dtype=bool)
    for family, method, which in _groups(answers):
        true, row = right[which], []
        asked = [(held, threshold) for threshold in THRESHOLDS]
        for stated, threshold in (*asked, (now, settings.sure)):
            ok = (stated[which] >= threshold) & rest[which]
            row += [Rate.of(ok[true]), Rate.of(ok[~true])]
        table.add(family, method, int(true.sum()), int((~true).sum()), *row)
    return table


def _factors(one: Fitted, settings: ConfidenceSettings) -> Table:
    columns = [Column("factor"), Column("fitted", 3), Column("least", 3), Column("largest", 3), Column("now", 3)]
    said = ", ".join(f"{1e3 * tolerance:g}" for tolerance in TOLERANCES)
    note = (
        f"By maximum likelihood of {len(one.answers)} answers at tolerances of {said} mm. Least, largest: one family"
        " left out. Now: as it stands in the settings."
    )
    what = "with a picture" if one.seen else "by touch alone"
    table = Table(f"{one.name}: answers {what}", columns, note=note)
    for name in (*(feature.name for feature in one.sample.features), "nearest"):
        current = getattr(getattr(settings, one.name), name)
        table.add(name, getattr(one.factors, name), *one.between(name), current)
    return table
