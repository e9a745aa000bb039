"""The stability table: rows by what is tried, a case that breaks is a row and a missed demand, not the end."""

import math

import numpy as np
import pytest
from cases.registry import (
    Case,
    Cases,
    Unstable,
    all_cases,
    at_most,
    is_covariance,
    is_rigid,
    refuses,
)

from fusion.benchmarks import stability
from fusion.benchmarks.frames.scaling import Measured, growth
from fusion.benchmarks.printing.tables import BenchSettings, as_text
from scenes.errors import InputError


def test_what_breaks_is_told_and_the_others_go_on(monkeypatch):
    cases = Cases()

    @cases("theme", "worst, m", over=(1.0, 2.0))
    def it_holds(value):
        return value

    @cases("theme", "")
    def it_breaks():
        raise Unstable("off by 3")

    @cases("other", "", slow=True)
    def it_crashes():
        raise ZeroDivisionError("by zero")

    monkeypatch.setattr(stability, "all_cases", lambda slow: [c for c in cases.found if slow is None or c.slow == slow])
    report = stability.run(BenchSettings())
    rows = report.tables[0].rows
    assert [row[:4] for row in rows] == [
        ["theme", "it holds", 2, 2],
        ["theme", "it breaks", 1, 0],
        ["other", "it crashes", 1, 0],
    ]
    assert rows[0][4:6] == ["2", "worst, m"]
    assert report.claims[0].value == pytest.approx(0.5)
    text = as_text(report)
    assert "off by 3" in text
    assert "ZeroDivisionError" in text
    assert len(stability.run(BenchSettings(quick=True)).tables[0].rows) == 2


def test_an_installation_without_the_sources_says_where_the_cases_are(monkeypatch, tmp_path):
    monkeypatch.setattr(stability, "FOLDER", tmp_path)
    with pytest.raises(InputError, match="they come with the sources"):
        stability.run(BenchSettings())


def test_the_judges_judge():
    assert at_most([1.0, -2.0], 1.5, "x") == 1.0
    for wrong in ([2.0], [math.nan]):
        with pytest.raises(Unstable):
            at_most(wrong, 1.5, "x")
    with pytest.raises(Unstable):
        is_rigid(np.diag([1.0, 1.0, -1.0, 1.0]))
    with pytest.raises(Unstable):
        is_covariance(np.diag([1.0, 1, 1, 1, 1, -1e-3]))
    with pytest.raises(Unstable, match="accepted"):
        refuses(lambda: None, "x")
    with pytest.raises(Unstable, match="ValueError"):
        refuses(lambda: float("a"), "x")

    def ours():
        raise InputError("expected better")

    assert refuses(ours, "x") == 0.0


def test_every_case_has_a_name_of_its_own():
    names = [str(case) for case in all_cases()]
    assert len(set(names)) == len(names) > 150
    assert all(isinstance(case, Case) for case in all_cases(slow=True))


def test_growth_is_the_exponent():
    assert growth(Measured(10, 0, 1.0, 0), Measured(100, 0, 10.0, 0)) == pytest.approx(1.0)
    assert growth(Measured(10, 0, 1.0, 0), Measured(40, 0, 16.0, 0)) == pytest.approx(2.0)
