"""The calibration benchmark's own arithmetic: a perfectly calibrated answerer must come out as one."""

import json

import numpy as np
import pytest
from scipy.stats import chi2

from fusion.benchmarks import strata
from fusion.benchmarks.frames import calibration, reliability
from fusion.benchmarks.printing.tables import BenchSettings, Report


def _answers(scale, count=4000, family="lab"):
    nees = scale * np.random.default_rng(0).chisquare(6, count)
    return [strata.Answer(family, 0.6, "fused", True, 0.001, float(n) / 6, float(chi2.cdf(n, 6)), "ok") for n in nees]


def _claims(answers):
    report = Report("calibration", "", "", 0)
    strata.add_strata(report, answers, ["other: no camera"], BenchSettings())
    calibration._by_verdict(report, answers, BenchSettings())
    calibration._curve(report, answers)
    calibration._tuned(report, answers)
    return {claim.what: claim.value for claim in report.claims}, report


def test_a_calibrated_answerer_is_one_and_an_overconfident_one_is_not():
    right, report = _claims(_answers(1.0))
    assert abs(right["tuning families, fused: mean NEES / dof, at least"] - 1) < 0.03
    assert abs(right["tuning families, fused: 95 % regions hold, at least"] - 0.95) < 0.01
    assert "report families, fused: 95 % regions hold, at least" not in right
    for p, inside in report.charts[0].series["fused, tuning"]:
        assert abs(p - inside) < 3
    sure, _ = _claims(_answers(4.0))
    assert sure["tuning families, fused: 95 % regions hold, at least"] < 0.6


def test_roles_are_never_pooled():
    claims, report = _claims(_answers(1.0) + _answers(9.0, family="harsh"))
    assert claims["tuning families, fused: 95 % regions hold, at least"] > 0.93
    assert claims["report families, fused: 95 % regions hold, at least"] < 0.3
    rows = [row[:3] for row in report.tables[0].rows]
    assert ["all", "tuning", "all"] in rows
    assert ["all", "report", "all"] in rows


def test_a_row_counts_what_it_says():
    def answer(method, add_s, share, verdict):
        return strata.Answer("harsh", 0.3, method, True, add_s, 2.0 * share, share, verdict)

    answers = [
        answer("fused", 0.001, 0.5, "ok"),
        answer("fused", 0.002, 0.99, "ambiguous"),
        answer("fused", 0.02, 0.999, "ok"),
        answer("fused", 0.03, 0.9, "lost"),
        answer("icp", 0.004, np.nan, ""),
        answer("icp", 0.040, np.nan, ""),
    ]
    table = strata.strata_table(answers, "fused", True, ["d455: no camera 'd455' in this version"])
    row = dict(zip([column.name for column in table.columns], table.texts()[0], strict=True))
    assert (row["family"], row["role"], row["hidden"], row["frames"]) == ("harsh", "report", "30 %", "4")
    assert (row["ADD-S mm"], row["< 5 mm"], row["95 % of that"]) == ("11.00", "50 %", "15-85")
    assert (row["95 % regions hold"], row["wrong but ok"], row["ok of right"]) == ("50 %", "25 %", "50 %")
    assert (row["ICP mm"], row["ICP < 5 mm"]) == ("22.0", "50 %")
    assert "d455: no camera" in table.note
    cell = json.loads(json.dumps(table.to_json()))["rows"][0]["< 5 mm"]
    assert (cell["hits"], cell["n"]) == (2, 4)
    assert not strata.strata_table(answers, "fused", False).rows


def _stated(true, said, count=4000, family="lab", seed=0):
    """Answers that are right with probability `true`, and say `said`."""
    rng = np.random.default_rng(seed)
    right = rng.random(count) < true
    return [
        strata.Answer(family, 0.3, "fused", True, 0.001 if r else 0.02, 1.0, 0.5, "ok", confidence=float(said))
        for r in right
    ]


def _reliability(answers):
    report = Report("calibration", "", "", 0)
    reliability.add_reliability(report, answers, BenchSettings())
    rows = [dict(zip([c.name for c in report.tables[0].columns], row, strict=True)) for row in report.tables[0].rows]
    return report, {(row["family"], row["role"], row["sense"]): row for row in rows}


def test_the_calibration_error_is_the_gap_between_stated_and_observed():
    """Of answers that say 99 % and of which 80 % are right the gap is 19 %; with 60 % that are right so often, none."""
    report, rows = _reliability(_stated(0.8, 0.99) + _stated(0.6, 0.6, family="harsh", seed=1))
    assert abs(rows["lab", "tuning", "fused"]["calibration error %"] - 19.0) < 1.5
    honest = rows["harsh", "report", "fused"]
    assert honest["calibration error %"] < 2.0
    assert 0.3 < honest["of it by chance %"] < 1.5
    claims = {claim.what: claim for claim in report.claims}
    assert not claims["tuning families, fused: expected calibration error of the confidence"].met
    assert claims["report families, fused: expected calibration error of the confidence"].met
    bins = [row for row in report.tables[1].rows if row[0] == "lab"]
    assert [(row[3], row[4]) for row in bins] == [("98-100 %", 4000)]
    content = json.loads(json.dumps(report.to_json()))
    cell = content["tables"][1]["rows"][0]
    assert cell["right"]["n"] == 4000
    assert abs(cell["right"]["share"] - 0.8) < 0.03
    assert cell["mean stated %"] == pytest.approx(99.0)


def test_every_confidence_has_one_bin():
    stated = np.array([0.0, 0.2, 0.5, 0.799999, 0.8, 0.95, 0.98, 1.0])
    bins = reliability.bins_of(stated, np.ones(8, dtype=bool))
    assert sum(one.right.n for one in bins) == len(stated)
    assert [one.low for one in bins] == [0.0, 0.2, 0.5, 0.8, 0.95, 0.98]
    assert reliability.expected_error(np.ones(8), np.ones(8, dtype=bool)) == 0.0
    assert np.isnan(reliability.expected_error(np.zeros(0), np.zeros(0, dtype=bool)))
    assert np.isnan(reliability.by_chance(np.zeros(0)))
    # one answer that says a half cannot be right a half: chance alone makes the gap
    assert reliability.by_chance(np.array([0.5])) == pytest.approx(0.5)


def test_what_tells_no_confidence_is_left_out():
    report, rows = _reliability(_answers(1.0)[:10])
    assert not rows
    assert not report.claims
