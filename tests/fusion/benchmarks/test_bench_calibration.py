"""The calibration benchmark's own arithmetic: a perfectly calibrated answerer must come out as one."""

import json

import numpy as np
from scipy.stats import chi2

from fusion.benchmarks import strata
from fusion.benchmarks.frames import calibration
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
