"""The bench command: statistics, tables, files; and that its numbers mean what they say."""

import json
import math
import re
from dataclasses import fields, replace
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from commands import refused

from fusion import benchmarks
from fusion.benchmarks.asked import HEEDED, OPTIONS, check
from fusion.benchmarks.contacts import few
from fusion.benchmarks.contacts import trials as contact_trials
from fusion.benchmarks.printing.charts import Chart, draw
from fusion.benchmarks.printing.tables import (
    BenchSettings,
    Claim,
    Column,
    Rate,
    Report,
    Spread,
    Table,
    as_text,
    write_report,
)
from fusion.cli.main import main
from scenes.errors import InputError
from scenes.evidence.align import align
from scenes.evidence.table import from_contacts
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from scenes.synthesis import library
from scenes.synthesis.noise.presets import observe_contacts


def a_report():
    table = Table("A table", [Column("method"), Column("error mm", 1), Column("success")], note="[note]")
    table.add("one", Spread.of([1.0, 2.0, 3.0]), Rate(9, 10))
    table.add("two", math.nan, None)
    chart = Chart("Title <1>", "x", "y", {"a & b": [(1.0, 2.0), (10.0, 20.0), (math.nan, 1.0)]}, log_x=True)
    claims = [Claim("fast", 3.0, 5.0, False), Claim("right", math.nan, 0.9, True)]
    return Report("name", "title", "3 trials", 7, [table], [chart], claims)


def test_spread_and_rate():
    spread = Spread.of([1e-3, 3e-3, math.nan], 1e3)
    assert (spread.mean, spread.n, spread.largest) == (2.0, 2, 3.0)
    assert spread.sd == pytest.approx(np.sqrt(2.0))
    assert Spread.of([]).n == 0
    low, high = Rate(0, 50).interval
    assert low == 0.0
    assert 0.05 < high < 0.09  # Wilson: 7.1 %
    assert math.isnan(Rate.of([]).share)


def test_a_row_of_the_wrong_length_is_refused():
    with pytest.raises(ValueError, match="expected 3 cells, got 1"):
        a_report().tables[0].add("x")


def test_a_claim_that_could_not_be_measured_is_missed():
    claims = a_report().claims
    assert claims[0].met
    assert not claims[1].met


def test_the_report_is_text_json_and_a_picture(tmp_path):
    report = a_report()
    text = as_text(report)
    for part in ("2.0 ± 1.0", "90 %", "MISSED", "[note]", "numpy", "seed 7"):
        assert part in text
    paths = write_report(report, tmp_path / "new")
    assert [p.name for p in paths] == ["name.json", "name.txt", "name.md", "name.svg"]
    data = json.loads(paths[0].read_text())
    assert data["tables"][0]["rows"][0]["error mm"]["n"] == 3
    assert data["tables"][0]["rows"][1]["error mm"] is None
    assert data["claims"][0] == {"what": "fast", "value": 3.0, "at most": 5.0, "met": True}
    assert {"processor", "threads", "versions"} <= set(data["machine"])
    assert "| --- |" in paths[2].read_text(encoding="utf-8")
    ElementTree.parse(paths[3])


def test_tables_are_shown_as_they_are_done_and_once(capsys, monkeypatch):
    first = Table("First table", [Column("x")], [[1.0]])

    def run(settings):
        settings.show(first)
        assert "First table" in capsys.readouterr().out
        return Report("local", "title", "1 trial", 0, [first, Table("Second table", [Column("x")], [[2.0]])])

    monkeypatch.setattr("fusion.benchmarks.contacts.local.run", run)
    assert main(["bench", "local"]) == 0
    rest = capsys.readouterr().out
    assert "First table" not in rest
    assert "Second table" in rest


def test_charts_survive_anything():
    for points in ([], [(0.0, 0.0)], [(1.0, 5.0), (1.0, 5.0)], [(-1.0, -2.0), (3.0, 4.0)]):
        for log in (False, True):
            ElementTree.fromstring(draw([Chart("t", "x", "y", {"s": points}, log, log)]))


def test_trials_of_a_cell():
    assert BenchSettings().count(200) == 200
    assert BenchSettings(quick=True).count(200) == 20
    assert BenchSettings(trials=7, quick=True).count(200) == 7


def test_unknown_benchmarks_are_named(capsys):
    assert main(["bench", "speed"]) == 2
    assert "local" in capsys.readouterr().err
    assert {"local", "global"} <= set(benchmarks.available())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("local --objects foo", "bench local: expected no --objects, which is of few, vision, search, .*, got it"),
        ("arrays --family lab", "bench arrays: expected no --family, which is of vision, "),
        ("search --methods icp", "bench search: expected no --methods, which is of occlusion, tracking, got it"),
        ("real --told", "bench real: expected no --told, which is of vision, calibration, got it"),
        ("skipping --objects dril", "--objects: expected some of .*, got 'dril': did you mean drill"),
        ("tracking --objects foo", "--objects: expected some of .*, got 'foo'"),
        ("occlusion --family lab --objects kettle", "--objects: expected some of .*, got 'kettle'"),
        ("all --objects foo", "--objects: expected some of .*, got 'foo'"),
    ],
)
def test_what_a_benchmark_would_pass_over_is_refused(capsys, words, message):
    assert re.search(message, refused(capsys, "bench", *words.split()))


def test_what_pages_ask_benchmarks_for_is_heeded():
    """And every name of an option is one of the settings."""
    settings = BenchSettings(objects=("kettle",), family="report")
    check("occlusion", settings)
    check("tracking", replace(settings, family="stranger,borrowed", objects=("drill", "mug", "kettle")))
    check("calibration", replace(settings, objects=None, told=True))
    assert set(OPTIONS) <= {one.name for one in fields(BenchSettings)}
    assert {option for has in HEEDED.values() for option in has} == set(OPTIONS)
    assert set(HEEDED) <= set(benchmarks.BENCHMARKS)


def test_the_bound_is_that_of_many_trials():
    # smooth: at an edge the noise of the point blurs the normal, which the bound does not know
    ball = trimesh.creation.icosphere(subdivisions=4)
    model = ObjectModel.from_mesh(ball.vertices * [0.03, 0.05, 0.09], ball.faces, "egg")
    exact = Contacts(*model.sample_surface(25, seed=3))
    truth = poses.make_pose()
    noise = contact_trials.NOISES["0.9 mm, 5°"]
    errors = []
    for seed in range(40):
        contacts = observe_contacts(exact, noise, np.random.default_rng(seed))
        found = align(model, from_contacts(contacts), truth[None]).poses[0]
        errors.append(contact_trials.errors(model, found, truth))
    limit = contact_trials.bound(model, observe_contacts(exact, noise, np.random.default_rng(0)), truth)
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert (rms < 1.3 * np.array(limit)).all()
    assert (rms > 0.75 * np.array(limit)).all()


def test_the_bound_forgets_the_turn_of_a_bottle_and_knows_what_is_free():
    bottle = library.make("bottle")
    contacts = Contacts(*bottle.sample_surface(12, seed=1), 1e-3, 0.1)
    assert np.isfinite(contact_trials.bound(bottle, contacts, np.eye(4))).all()
    flat = library.make("box")
    top = flat.vertices[:, 2].max()
    points = np.array([[0.01, 0.01, top], [-0.01, 0.02, top], [0.0, -0.02, top]])
    one_face = Contacts(points, np.tile([0.0, 0.0, 1.0], (3, 1)), 1e-3, 0.1)
    assert contact_trials.bound(flat, one_face, np.eye(4)) == (math.inf, math.inf)


def test_the_cube_has_24_turns():
    cube = contact_trials.cube()
    members = cube.symmetries.discrete
    assert members.shape == (24, 4, 4)
    assert np.allclose(members[0], np.eye(4))
    moved = np.sort(np.round(poses.apply(members, cube.vertices), 9).reshape(24, -1), axis=1)
    assert np.allclose(moved, moved[0])


def test_trials_repeat_with_their_seed():
    model = library.make("l_block")
    noise = contact_trials.NOISES["1.8 mm, 10°"]
    first, second = (list(contact_trials.trials(model, 4, noise, 3, seed=5)) for _ in range(2))
    for a, b in zip(first, second):
        assert np.array_equal(a.truth, b.truth)
        assert np.array_equal(a.contacts.points, b.contacts.points)
        rotation, position = contact_trials.errors(model, a.start, a.truth)
        assert rotation == pytest.approx(np.deg2rad(16.0))
        assert position == pytest.approx(0.0332)


def test_few_contacts_are_as_right_as_they_are_sure():
    shown = []
    report = few.run(BenchSettings(quick=True, objects=("hammer",), trials=3, show=shown.append))
    assert report.tables == shown
    by_count, by_object = report.tables
    assert [row[0] for row in by_object.rows] == ["hammer"]
    whole = by_count.rows[-1]
    # normals or none, sigmas told or not, two numbers of contacts, three trials
    assert whole[3].n == 2 * 2 * 2 * 3
    assert whole[5].hits <= whole[4].hits
    assert abs(report.claims[2].value) < 0.3
    with pytest.raises(InputError, match=r"--objects.*got 'teapot'"):
        few.run(BenchSettings(objects=("teapot",)))
