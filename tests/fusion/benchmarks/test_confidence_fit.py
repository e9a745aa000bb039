"""The command that fits the confidence: what was put in comes out, families are left out, files can be gone on with."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import refused, run

from fusion.benchmarks.confidence import answers as answers_module
from fusion.benchmarks.confidence.answers import (
    BLUNTER,
    MOST_FELT,
    Told,
    Work,
    answered,
    frame_of,
    mend,
    read_answers,
    told_little,
    works_of,
    write_line,
)
from fusion.benchmarks.confidence.fit import Sample, _Cost, as_literal, fit, fit_model
from fusion.benchmarks.families.table import FAMILIES
from fusion.cli.config import read_config
from fusion.estimation.posterior.confidence import FEATURES, ConfidenceSettings, Regression, below

TRUE = Regression(weight=0.5, agree=12.0, past=-8.0, spread=-1.0, constant=-1.5, nearest=0.6)


def made(count, seed=0, family="lab", seen=True):
    """Answers whose errors are drawn as the regression TRUE has it."""
    rng = np.random.default_rng(seed)
    out = []
    for number in range(count):
        told = {feature.name: 0.0 for feature in FEATURES} | {"constant": 1.0, "weight": rng.uniform(-3, 6)}
        if seen:
            told |= {"agree": rng.uniform(0, 0.2), "past": rng.uniform(0, 0.3), "spread": rng.uniform(-3, 0)}
        mean = float(np.exp(rng.uniform(-15, -10)))
        variance = mean**2 / 2.0
        score = sum(getattr(TRUE, name) * value for name, value in told.items())
        off = TRUE.nearest * np.sqrt(rng.gamma(mean**2 / variance, variance / mean))
        add_s = off if rng.random() < 1.0 / (1.0 + np.exp(-score)) else 0.05
        place = family, 0.3, f"object {number % 5}", number, 0
        out.append(Told(*place, "fused", True, float(add_s), True, seen, mean, variance, told, "now"))
    return out


def test_what_was_put_in_comes_out():
    found = fit(Sample.of(made(6000), True))
    for name, tolerance in (("weight", 0.1), ("agree", 2.5), ("past", 1.5), ("spread", 0.25), ("nearest", 0.03)):
        assert getattr(found, name) == pytest.approx(getattr(TRUE, name), abs=tolerance)
    assert found.outline == 0.0  # none of the answers told it


def test_the_slope_is_that_of_the_cost():
    sample = Sample.of(made(200), True)
    used = sample.values.std(axis=0) > 0
    right_at = np.array([sample.add_s < tolerance for tolerance in (0.003, 0.005, 0.010)], dtype=float)
    cost = _Cost(sample.values[:, used], right_at, sample, np.ones(used.sum(), dtype=bool))
    rng = np.random.default_rng(1)
    x = np.append(0.3 * rng.normal(size=used.sum()), np.log(0.6))
    _, slope = cost(x)
    for k in range(len(x)):
        step = np.zeros(len(x))
        step[k] = 1e-5
        assert slope[k] == pytest.approx((cost(x + step)[0] - cost(x - step)[0]) / 2e-5, rel=1e-3, abs=1e-3)


def test_a_factor_keeps_its_sign():
    backwards = [replace(one, features={**one.features, "past": 0.3 - one.features["past"]}) for one in made(1500)]
    least = next(feature.least for feature in FEATURES if feature.name == "past")
    assert fit(Sample.of(backwards, True)).past == pytest.approx(-least)
    backwards = [replace(one, features={**one.features, "agree": 0.2 - one.features["agree"]}) for one in made(1500)]
    assert fit(Sample.of(backwards, True)).agree == 0.0


def test_a_family_is_judged_by_the_fit_that_has_not_seen_it():
    odd = [replace(one, add_s=0.05 if k % 10 else 0.001) for k, one in enumerate(made(150, 1, "rough"))]
    fitted = fit_model([*made(400), *odd], True)
    assert set(fitted.left_out) == {"lab", "rough"}
    own = np.array([one.family == "rough" for one in fitted.answers])
    assert fitted.held[own].mean() > 0.4  # nothing told it
    low, high = fitted.between("constant")
    assert low <= high
    shuffled = [*odd, *made(400)][::-1]
    assert fit_model(shuffled, True).factors == fitted.factors
    assert fit_model(made(400), True).left_out == {}


def test_the_confidence_is_that_of_an_estimate():
    sample, settings = Sample.of(made(50), True), ConfidenceSettings()
    one = made(50)[7]
    score = sum(getattr(settings.seen, name) * value for name, value in one.features.items())
    near = below(one.mean, one.variance, 0.005, settings.seen.nearest)
    assert sample.confidence(settings.seen, 0.005)[7] == pytest.approx(near / (1.0 + np.exp(-score)))


def test_lines_are_read_back_and_a_half_written_one_is_none(tmp_path):
    path = tmp_path / "answers.jsonl"
    told = [*made(3), Told("lab", 0.3, "box", 0, 0, "none")]
    path.write_text("".join(map(write_line, told)) + '{"family": "lab", "le')
    back = read_answers(path)
    assert back[:3] == told[:3]
    assert (back[3].place, back[3].sense) == (told[3].place, "none")
    mend(path)
    assert path.read_text() == "".join(map(write_line, told))


def test_some_factors_are_fitted_and_the_others_stay():
    sample = Sample.of(made(1500), True)
    stands = replace(TRUE, weight=-3.0, nearest=1.2)
    found = fit(sample, stands, ("weight",))
    assert found == replace(stands, weight=found.weight)
    assert found.weight > 0.0
    assert fit(sample, TRUE, ("nearest",)).nearest == pytest.approx(TRUE.nearest, rel=0.1)
    assert fit(sample, TRUE, ("touch",)) == TRUE  # what varies in no answer
    held = fit_model(made(400), True, TRUE, ("weight",))
    assert {one.agree for one in held.left_out.values()} <= {TRUE.agree}


def test_only_what_lacks_is_answered():
    methods = [("fused", True), ("touch", True)]
    asked = [FAMILIES["lab"]], [0.3], ["box", "mug"], 2, 0, methods
    every = works_of(*asked)
    assert [(w.name, w.trial) for w in every] == [("mug", 0), ("mug", 1), ("box", 0), ("box", 1)]
    known = [
        *(Told("lab", 0.3, "mug", 0, 0, sense) for sense in ("fused", "touch")),
        Told("lab", 0.3, "mug", 1, 0, "fused"),
        Told("lab", 0.3, "box", 0, 0, "none"),
    ]
    lacks = works_of(*asked, known=known)
    assert [(w.name, w.trial, w.asked) for w in lacks] == [("mug", 1, (("touch", True),)), ("box", 1, tuple(methods))]
    # nothing is felt there
    assert works_of([FAMILIES["desk"]], [0.3], ["box"], 1, 0, methods)[0].asked == (("fused", True),)


def test_frames_that_tell_little_have_a_few_of_their_contacts():
    frame = frame_of(Work(FAMILIES["lab"], 0.3, "box", 0, 5, ()))
    assert len(frame.contacts) > MOST_FELT
    given = [told_little(frame, np.random.default_rng(seed)) for seed in range(40)]
    counts = [len(one.contacts) for one in given]
    assert set(counts) == set(range(1, MOST_FELT + 1))
    assert {one.hand is None for one in given} == {True, False}
    assert {bool(one.contacts.sigma_told.all()) for one in given} == {True, False}
    finest = frame.contacts.sigma_point.min()
    for one in given:
        away = np.linalg.norm(one.contacts.points[:, None] - frame.contacts.points, axis=2)
        assert away.min(axis=1).max() < 6.0 * max(BLUNTER)
        assert np.all(one.contacts.sigma_point >= finest)
        assert set(one.contacts.sensors) <= set(frame.contacts.sensors)
        assert one.no_contact is None
        np.testing.assert_array_equal(one.depth, frame.depth)
    again = told_little(frame, np.random.default_rng(7))
    np.testing.assert_array_equal(again.contacts.points, given[7].contacts.points)


def test_a_frame_is_answered_the_same_when_it_was_kept(tmp_path):
    work = Work(FAMILIES["lab"], 0.3, "box", 0, 5, (("vision", True), ("touch", False)), tmp_path)
    first, again = answered(work), answered(work)
    assert first == again
    assert (tmp_path / "lab" / "0.3" / "box-0-5" / "capture.json").is_file()
    assert [(one.sense, one.start, one.seen) for one in first] == [("vision", True, True), ("touch", False, False)]
    assert set(first[0].features) == {feature.name for feature in FEATURES}
    assert first[0].add_s < 0.005


@pytest.fixture
def answering(monkeypatch):
    """Answers without work, right ones and wrong ones."""
    asked = []

    def one(work):
        asked.append(work)
        drawn = made(len(work.asked), len(asked), work.family.name)
        place = dict(zip(("family", "level", "object", "trial", "seed"), work.place))
        return [replace(told, **place, sense=sense, start=start) for told, (sense, start) in zip(drawn, work.asked)]

    monkeypatch.setattr(answers_module, "answered", one)
    return asked


def test_the_command_answers_fits_writes_and_goes_on(answering, tmp_path, capsys):
    answers, factors, result = tmp_path / "a.jsonl", tmp_path / "f.toml", tmp_path / "r.json"
    few = ["--family", "lab,rough", "--levels", "0.3,0.6", "--methods", "fused,vision", "--jobs", 1]
    asked = ["fit-confidence", *few, "--answers", answers, "--write", factors]
    assert run(*asked, "--json", result) == 0
    assert len(answering) == 2 * 2 * 8
    out = capsys.readouterr().out
    assert "Every family left out in turn" in out
    assert "seen: Regression = Regression(" in out
    written = read_config(factors).estimate.confidence.seen
    content = json.loads(result.read_text())
    assert content["factors"]["seen"] == {name: getattr(written, name) for name in content["factors"]["seen"]}
    assert as_literal(written) in out
    answering.clear()
    assert run(*asked, "--trials", 2) == 0
    assert len(answering) == 2 * 2 * 8  # the second trial alone
    answering.clear()
    assert run("fit-confidence", "--from", answers, "--levels", "0.3") == 0
    assert not answering
    assert f"{2 * 2 * 8 * 4} answers to 32 frames" in capsys.readouterr().out  # two trials, one level of two


def test_what_cannot_be_fitted_is_refused_in_one_line(answering, tmp_path, capsys):
    here = ["--answers", tmp_path / "a.jsonl", "--jobs", 1]
    assert "only reported" in refused(capsys, "fit-confidence", "--family", "harsh", *here)
    assert "only reported" in refused(capsys, "fit-confidence", "--family", "all", *here)
    few = ["--family", "lab", "--objects", "box", "--levels", "0"]
    assert run("fit-confidence", *few, *here) == 2
    assert "got 8, " in capsys.readouterr().err  # and they are kept
    assert len(read_answers(here[1])) == 8
    path = tmp_path / "b.jsonl"
    path.write_text('{"family": "harsh"}\n')
    assert "line 1: expected an answer" in refused(capsys, "fit-confidence", "--from", path)
    path.write_text("".join(write_line(replace(one, features={"constant": 1.0})) for one in made(40)))
    line = refused(capsys, "fit-confidence", "--from", path)
    assert "expected the feature 'weight'" in line
    assert "got 'weight,mood'" in refused(capsys, "fit-confidence", "--from", path, "--only", "weight,mood")
    assert "make the answers anew" in line
    assert "expected some of fused" in refused(capsys, "fit-confidence", "--methods", "smell")
    assert "nowhere.jsonl: expected a file" in refused(capsys, "fit-confidence", "--from", Path("nowhere.jsonl"))
