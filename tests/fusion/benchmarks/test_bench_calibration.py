"""The calibration benchmark's own arithmetic: a perfectly calibrated answerer must come out as one."""

import numpy as np
from scipy.stats import chi2

from fusion.benchmarks.frames import calibration
from fusion.benchmarks.printing.tables import BenchSettings, Report


def _answers(scale, count=4000):
    nees = scale * np.random.default_rng(0).chisquare(6, count)
    return [calibration.Answered("lab", 0.6, "fused", 0.001, float(n) / 6, float(chi2.cdf(n, 6)), "ok") for n in nees]


def _claims(answers):
    report = Report("calibration", "", "", 0)
    calibration._by_level(report, answers, BenchSettings())
    calibration._by_verdict(report, answers, BenchSettings())
    calibration._curve(report, answers)
    return {claim.what: claim.value for claim in report.claims}, report


def test_a_calibrated_answerer_is_one_and_an_overconfident_one_is_not():
    right, report = _claims(_answers(1.0))
    assert abs(right["fused: mean NEES / dof, at least"] - 1) < 0.03
    assert abs(right["fused: 95 % regions hold, at least"] - 0.95) < 0.01
    for p, inside in report.charts[0].series["fused, lab"]:
        assert abs(p - inside) < 3
    sure, _ = _claims(_answers(4.0))
    assert sure["fused: 95 % regions hold, at least"] < 0.6


def test_a_cell_is_answered_by_every_sense_and_again_the_same():
    cell = ("drill", "clean", 0.6, 1, 3)
    found = calibration.answer_cell(*cell)
    assert [a.sense for a in found] == ["fused", "vision", "touch"]
    assert all(0 <= a.share <= 1 and a.per_dof >= 0 for a in found)
    assert found == calibration.answer_cell(*cell)
