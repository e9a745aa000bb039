"""How sure an answer is: for the tolerance the caller names, in every form in which an answer is told."""

from __future__ import annotations

import csv
import json
from dataclasses import fields, replace

import numpy as np
import pytest
from commands import refused, run
from made_frames import plain_view
from predicted_twin import picture
from scipy.stats import gamma

from fusion.cli.options import percent
from fusion.estimation.answer import ContactResidual, Mode
from fusion.estimation.estimate import estimate
from fusion.estimation.posterior.confidence import (
    FEATURES,
    ConfidenceSettings,
    Regression,
    as_shown,
    below,
    chances,
    observations,
)
from fusion.estimation.posterior.spread import mean_square
from fusion.estimation.settings import EstimateSettings
from fusion.results.files import read_result
from fusion.tracking.tracker import Tracker, track
from scenes.errors import InputError
from scenes.evidence.align import Prior
from scenes.files.schema import complaints
from scenes.recordings.captures import write_capture
from scenes.synthesis.library import make


@pytest.fixture(scope="module")
def box():
    return make("box")


@pytest.fixture(scope="module")
def capture(tmp_path_factory, box):
    frames = [replace(plain_view(), index=i) for i in range(3)]
    return write_capture(tmp_path_factory.mktemp("sure") / "plain", frames, box)


def test_a_wider_tolerance_is_surer(box):
    frame = plain_view()
    answers = [estimate(frame, box, sure_within=within) for within in (0.0005, 0.002, 0.005, 0.02)]
    assert [answer.sure_within for answer in answers] == [0.0005, 0.002, 0.005, 0.02]
    sure = [answer.confidence for answer in answers]
    assert np.all(np.diff(sure) >= 0)
    assert sure[0] < sure[-1]
    assert estimate(frame, box).confidence == answers[2].confidence  # 5 mm is the default
    assert estimate(frame, box).sure_within == 0.005


def test_ok_is_for_the_tolerance_that_was_named(box):
    usual = EstimateSettings()
    never = replace(usual, confidence=replace(usual.confidence, sure=1.1))
    answer = estimate(plain_view(), box, sure_within=0.0025, settings=never)
    assert answer.verdict == "ambiguous"
    assert "sure to be within 2.5 mm" in answer.notes[0]


@pytest.mark.parametrize("within", [0.0, -1.0, np.nan, np.inf])
def test_a_tolerance_is_above_zero(box, within):
    with pytest.raises(InputError, match="sure_within: expected metres above 0"):
        estimate(plain_view(), box, sure_within=within)
    with pytest.raises(InputError, match="sure_within"):
        Tracker(box, sure_within=within)


def test_nothing_sensed_is_not_sure(box):
    nothing = replace(plain_view().without_vision().without_touch(), camera=None, prior=None)
    answer = estimate(nothing, box)
    assert answer.verdict == "lost"
    assert answer.confidence < 0.05


def test_a_tracks_frames_are_as_sure_as_single_ones_and_no_surer_unseen(box):
    frames = [replace(plain_view(), index=i) for i in range(3)]
    found, *rest = track(frames, box, sure_within=0.004)
    assert 0.5 < found.confidence <= 1.0
    for answer in rest:
        assert answer.how == "tracked"
        assert answer.confidence == pytest.approx(found.confidence, abs=0.05)
        assert answer.sure_within == 0.004
    blind = replace(frames[2].without_vision().without_touch(), index=3, camera=None, prior=None)
    tracker = Tracker(box)
    seen = [tracker.step(frame).confidence for frame in frames]
    assert tracker.step(blind).confidence <= seen[-1]


def test_every_table_and_file_has_it(capsys, tmp_path, capture):
    assert run("estimate", capture, "--out", tmp_path / "e", "--sure-within", 3) == 0
    printed = capsys.readouterr().out
    assert " sure " in printed.splitlines()[0] or " sure " in printed.splitlines()[1]
    content, answers = read_result(tmp_path / "e" / "result.json")
    assert complaints(content, "result") == []
    assert [entry["sure_within_mm"] for entry in content["frames"]] == pytest.approx([3.0] * 3)
    assert [a.confidence for a in answers] == [entry["confidence"] for entry in content["frames"]]
    assert f" {percent(answers[0].confidence)} " in printed
    assert [percent(value) for value in (0.994, 0.996, 1.0, None)] == ["99 %", ">99 %", "100 %", "–"]
    assert "surface error is below 3 mm" in (tmp_path / "e" / "report.html").read_text(encoding="utf-8")
    assert run("track", capture, "--out", tmp_path / "t", "--no-report", "--sure-within", 3) == 0
    assert "sure" in capsys.readouterr().out
    tracked = json.loads((tmp_path / "t" / "result.json").read_text())["frames"]
    assert all(entry["confidence"] is not None and entry["sure_within_mm"] == pytest.approx(3.0) for entry in tracked)
    assert "expected a number above 0" in refused(capsys, "estimate", capture, "--sure-within", 0)


def test_a_batch_has_it(capsys, tmp_path, capture):
    assert run("batch", capture.parent, "--workers", 1, "--out", tmp_path / "b", "--no-report") == 0
    assert "sure" in capsys.readouterr().out
    rows = list(csv.DictReader((tmp_path / "b" / "results.csv").open()))
    assert all(0.0 <= float(row["confidence"]) <= 1.0 for row in rows)


def shown(agree, past=0.0):
    """A predicted picture of which a share agrees, and a share is seen past."""
    return picture(agree=agree, past=past)


def test_what_contradicts_an_answer_widens_it_but_not_what_a_prior_told():
    rng = np.random.default_rng(4)
    root = rng.normal(size=(6, 6)) * 1e-3
    covariance = root @ root.T + 1e-8 * np.eye(6)
    mode = Mode(np.eye(4), 1.0, 0.0, covariance)

    def factor(picture, *beside, prior=None, scale=1.0):
        one = replace(mode, covariance=scale * covariance)
        wide = as_shown(one, picture, prior, None, *beside).covariance / scale
        np.testing.assert_allclose(wide / wide[0, 0], covariance / covariance[0, 0], rtol=1e-6)
        return wide[0, 0] / covariance[0, 0]

    assert as_shown(mode, None, None) is mode
    little, much = shown(0.02), shown(0.95)
    # the more is seen past, the less is seen, and the more blocks of the outline are off together, the wider
    by_past = [factor(shown(0.95 - past, past)) for past in (0.0, 0.01, 0.05, 0.3)]
    assert by_past == sorted(by_past)
    assert by_past[-1] > 10.0 * by_past[0]
    assert factor(little) > factor(shown(0.3)) > factor(much)
    by_outline = [factor(much, off) for off in (0.0, 0.0001, 0.0003, 0.001)]
    assert by_outline == sorted(by_outline)
    assert by_outline[-1] > 5.0 * by_outline[0]
    # a turn that is known badly bends within its own spread; one known well is narrower than it says
    by_turn = [factor(much, scale=scale) for scale in (1e-6, 1.0, 1e3, 1e4, 1e9)]
    assert (np.diff(by_turn) > -1e-12).all()
    assert factor(much, scale=1e3) > 2.0 * by_turn[0]
    # beyond what was fitted nothing grows
    assert factor(much, 0.001) == factor(much, 0.1)
    assert factor(shown(1e-9)) == factor(little)
    assert factor(shown(0.1, 0.3)) == factor(shown(0.1, 0.9))
    assert factor(much, scale=1e9) == pytest.approx(factor(much, scale=1e12), rel=1e-9)
    # who asks for it gets no narrower answer than it was
    assert factor(much) < 1.0
    np.testing.assert_allclose(as_shown(mode, much, None, least=1.0).covariance, covariance, rtol=1e-12)
    # a prior that says all leaves nothing to widen; one that says nothing is none
    told = Prior(np.eye(4), np.linalg.inv(covariance))
    np.testing.assert_allclose(as_shown(mode, little, told).covariance, covariance, rtol=1e-6, atol=1e-14)
    vague = Prior(np.eye(4), 1e-9 * np.eye(6))
    assert factor(little, prior=vague) == pytest.approx(factor(little), rel=1e-6)
    # no direction of a degenerate covariance raises
    flat = Mode(np.eye(4), 1.0, 0.0, np.diag([1e-4, 0.0, 0.0, 1e-6, 1e-6, 0.0]))
    assert np.isfinite(as_shown(flat, little, told).covariance).all()


def test_every_factor_of_the_regression_is_a_feature_with_its_sign(box):
    names = [feature.name for feature in FEATURES]
    assert sorted(names) == sorted({field.name for field in fields(Regression)} - {"nearest"})
    for feature in FEATURES:
        for factors, fitted in ((ConfidenceSettings().seen, feature.seen), (ConfidenceSettings().felt, feature.felt)):
            value = getattr(factors, feature.name)
            assert feature.sign * value >= 0.0
            assert fitted or value == 0.0


def test_an_answer_tells_what_its_confidence_was_read_from(box):
    answer, settings = estimate(plain_view(), box), ConfidenceSettings()
    assert set(answer.observed) <= {feature.name for feature in FEATURES}
    assert "agree" in answer.observed
    score = sum(getattr(settings.seen, name) * value for name, value in answer.observed.items())
    squares = mean_square(box, answer.pose, answer.modes[0].covariance)
    near = below(*squares, settings.tolerance, settings.seen.nearest)
    right = min(1.0 / (1.0 + np.exp(-score)), settings.surest)
    assert answer.confidence == pytest.approx(near * right, rel=1e-9)
    everywhere = estimate(replace(plain_view(), prior=None), box)
    assert (answer.observed["anywhere"], everywhere.observed["anywhere"]) == (0.0, 1.0)


def test_the_gamma_distribution_is_scipys_near_enough():
    mean, variance = np.array([1e-6, 4e-6, 2e-5]), np.array([5e-13, 1e-11, 6e-10])
    for tolerance in (0.001, 0.003, 0.01):
        exact = gamma.cdf((tolerance / 0.6) ** 2, mean**2 / variance, scale=variance / mean)
        np.testing.assert_allclose(below(mean, variance, tolerance, 0.6), exact, atol=0.01)
    np.testing.assert_array_equal(below([0.0, np.inf, np.nan, 1.0], [0.0, 1.0, 1.0, 0.0], 0.005, 0.6), [1, 0, 0, 0])


def test_one_confidence_is_as_one_of_many():
    means, variances = np.array([1e-6, 4e-6, 1e-4]), np.array([1e-13, 9e-12, 1e-9])
    many = below(means, variances, 0.003, 0.7)
    alone = [float(below(mean, variance, 0.003, 0.7)) for mean, variance in zip(means, variances)]
    np.testing.assert_allclose(alone, many, rtol=1e-12)


def test_touch_alone_is_less_sure_of_what_blunt_fingertips_say(box):
    """Contacts of a hand whose fingertips are worn, agreeing as well: it is as badly calibrated, and nothing shows it.
    Claims finer or blunter than any that was fitted tell no more.
    """
    pose = np.eye(4)
    pose[2, 3] = 0.6
    mode = Mode(pose, 0.99, 0.0, np.diag(np.repeat([0.01, 0.001], 3) ** 2))

    def right(sigma_mm):
        felt = tuple(ContactResidual(f"tip {i}", 0.3, 2.0, False, sigma_mm) for i in range(5))
        return chances(box, (mode,), None, felt, 5.0)[0]

    fine, usual, blunt, blunter = (right(sigma) for sigma in (0.2, 0.9, 1.3, 3.0))
    assert fine == pytest.approx(usual, rel=1e-12)
    assert usual > blunt > blunter == right(1.6)
    assert right(float("nan")) == pytest.approx(usual, rel=1e-12)


def test_how_much_is_felt_counts_fingers_and_how_sharp_they_are(box):
    """One contact that may be 4 mm off is not five that are good to one, however well it agrees; a finger that is felt
    in many places is one finger, and a normal ties two numbers where a place ties one.
    """
    pose = np.eye(4)
    pose[2, 3] = 0.6
    mode = Mode(pose, 0.99, 0.0, np.diag(np.repeat([0.01, 0.001], 3) ** 2))

    def told(count, sigma_mm, of_finger=1.0, normal_deg=float("nan")):
        felt = tuple(ContactResidual(f"tip {i}", 0.3, normal_deg, False, sigma_mm, of_finger) for i in range(count))
        return observations(box, (mode,), None, felt, 0.0, ConfidenceSettings()).get("touch")

    assert told(0, 0.9) is None
    sharp = [told(count, 0.9) for count in (1, 3, 5)]
    np.testing.assert_allclose(sharp, np.log1p([1.0, 3.0, 5.0]), rtol=1e-12)
    assert sharp[2] > told(5, 1.8) > told(5, 4.0) > told(1, 4.0) > 0.0
    assert told(5, 0.1) == sharp[2]
    assert told(5, 0.9, normal_deg=2.0) == pytest.approx(np.log1p(15.0), rel=1e-12)
    assert told(40, 0.9, 0.125) == pytest.approx(sharp[2], rel=1e-12)
    assert told(5, float("nan")) == pytest.approx(told(5, 1.6), rel=1e-12)


def test_a_picture_that_many_sharp_fingers_agree_with_is_surer_than_one_blunt_finger(box):
    settings = ConfidenceSettings()
    pose = np.eye(4)
    pose[2, 3] = 0.6
    mode = Mode(pose, 0.99, 0.0, np.diag(np.repeat([0.01, 0.001], 3) ** 2))

    def right(count, sigma_mm):
        felt = tuple(ContactResidual(f"tip {i}", 0.3, 2.0, False, sigma_mm) for i in range(count))
        return chances(box, (mode,), picture(agree=0.5), felt, 0.0, settings)[0]

    assert right(5, 0.9) > right(2, 0.9) > right(1, 4.0) >= right(0, 0.9)


def test_touch_alone_is_likelier_near_than_a_wide_spread_has_it(box):
    """ADD-S of a pose far off is less than its spread: what the second factor makes too little of the first makes up
    for, from a spread of a tenth of the radius on; what does not belong speaks against an answer.
    """
    pose = np.eye(4)
    pose[2, 3] = 0.6

    def right(sigma, outliers=0):
        mode = Mode(pose, 0.99, 0.0, np.diag(np.repeat([sigma / box.radius, sigma], 3) ** 2))
        felt = tuple(ContactResidual(f"tip {i}", 0.3, 2.0, i < outliers, 0.9) for i in range(5))
        return chances(box, (mode,), None, felt, 5.0)

    narrow, usual, wide, wider = (right(share * box.radius) for share in (0.005, 0.03, 0.2, 0.4))
    assert narrow[0] == usual[0] < wide[0] <= wider[0]
    stated = [right * near for right, near in (narrow, usual, wide, wider)]
    assert stated == sorted(stated, reverse=True)
    assert right(0.001, outliers=3)[0] < 0.95 * right(0.001, outliers=1)[0] < 0.95 * narrow[0]
