"""All benchmarks in one run: resumed, stopped in time, and going on after one that cannot run."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from fusion.benchmarks.peers import pareto
from fusion.benchmarks.printing import run_all as all_benchmarks
from fusion.benchmarks.printing.charts import draw
from fusion.benchmarks.printing.run_all import run_all, summary
from fusion.benchmarks.printing.tables import (
    BenchSettings,
    Claim,
    Column,
    Quantile,
    Report,
    Spread,
    Table,
    plain,
    text_of,
)
from fusion.cli.main import main
from scenes.errors import InputError
from scenes.threads import thread_count


@pytest.fixture
def ran(monkeypatch):
    """Names of the benchmarks that ran; "bad" cannot, "long" has a hundred cells of a second."""
    names = []
    clock = SimpleNamespace(now=0.0)

    def run(name, settings):
        names.append(name)
        if name == "bad":
            raise InputError("expected data, found none")
        table = Table("Shown", [Column("x")], [[1.0]])
        settings.show(table)
        for _ in settings.progress(range(100 if name == "long" else 1), 100, name):
            clock.now += 1.0
        return Report(name, "title", "1 trial", settings.seed, [table], claims=[Claim("good", 1.0, 0.5, True)])

    def load(name):
        return SimpleNamespace(run=lambda settings: run(name, settings))

    monkeypatch.setattr(all_benchmarks, "load", load)
    # the code may be edited while this runs
    monkeypatch.setattr(all_benchmarks, "source_version", lambda: "1.0+abc")
    return SimpleNamespace(names=names, clock=lambda: clock.now)


def test_a_finished_benchmark_is_not_run_again(ran, tmp_path):
    settings = BenchSettings(seed=3)
    first = run_all(["one", "two"], settings, tmp_path, clock=ran.clock)
    assert [one.state for one in first] == ["done", "done"]
    again = run_all(["one", "two", "three"], settings, tmp_path, clock=ran.clock)
    assert ran.names == ["one", "two", "three"]
    assert [one.again for one in again] == [True, True, False]
    assert again[0].report["claims"][0]["met"]
    assert "done before" in summary(again).texts()[0]
    run_all(["one"], BenchSettings(seed=4), tmp_path, clock=ran.clock)
    assert ran.names[-1] == "one"  # another seed is another run
    index = json.loads((tmp_path / "all.json").read_text())
    assert set(index["benchmarks"]) == {"one", "two", "three"}
    assert index["benchmarks"]["two"]["demands_met"] == "1 of 1"
    assert {"processor", "versions"} <= set(index["machine"])


def test_other_code_is_another_run(ran, tmp_path, monkeypatch):
    run_all(["one"], BenchSettings(), tmp_path, clock=ran.clock)
    monkeypatch.setattr(all_benchmarks, "source_version", lambda: "another")
    run_all(["one"], BenchSettings(), tmp_path, clock=ran.clock)
    assert ran.names == ["one", "one"]


@pytest.mark.parametrize("damage", ["", "{", '{"benchmarks": []}', '{"benchmarks": {"one": null}}'])
def test_a_damaged_index_runs_all(ran, tmp_path, damage):
    (tmp_path / "all.json").write_text(damage)
    assert run_all(["one"], BenchSettings(), tmp_path, clock=ran.clock)[0].state == "done"


def test_the_end_says_how_many_trials_and_how_long(ran, tmp_path):
    outcomes = run_all(["long", "one"], BenchSettings(quick=True), tmp_path, clock=ran.clock)
    rows = summary(outcomes).texts()
    assert [row[:4] for row in rows] == [["long", "done", "1 trial", "100.0"], ["one", "done", "1 trial", "1.0"]]
    report = json.loads((tmp_path / "long.json").read_text())
    assert report["tables"][0]["title"] == "Shown"
    assert {"seed", "command", "version", "machine"} <= set(report)
    assert json.loads((tmp_path / "all.json").read_text())["benchmarks"]["long"]["trials"] == "1 trial"


def test_one_that_cannot_run_does_not_stop_the_others(ran, tmp_path):
    outcomes = run_all(["bad", "one"], BenchSettings(), tmp_path, clock=ran.clock)
    assert [one.state for one in outcomes] == ["could not run", "done"]
    assert "expected data" in outcomes[0].why


def test_the_command_runs_all(ran, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("fusion.benchmarks.available", lambda: ["one", "bad"])
    assert main(["bench", "all", "--out", str(tmp_path / "out"), "--json", str(tmp_path / "all.json")]) == 0
    shown = capsys.readouterr().out
    assert "All benchmarks" in shown
    assert "could not run" in shown
    assert len(json.loads((tmp_path / "all.json").read_text())["benchmarks"]) == 2


def test_the_version_is_of_the_code():
    version, _, digest = all_benchmarks.source_version().partition("+")
    assert version
    assert len(digest) == 12


def test_the_interval_of_a_mean_holds_it():
    spread = Spread.of(np.random.default_rng(0).normal(size=200))
    assert spread.low < spread.mean < spread.high
    assert spread.high - spread.low == pytest.approx(4 * spread.sd / np.sqrt(200), rel=0.2)
    assert plain(spread)["interval_95"] == [spread.low, spread.high]


def test_the_frontier_is_what_nobody_beats():
    assert pareto.frontier([(1.0, 5.0), (2.0, 3.0), (3.0, 4.0), (2.0, 3.0), (0.5, np.nan)]) == [
        True,
        True,
        False,
        True,
        False,
    ]
    point = pareto.Point("a", "1", np.ones(3), np.array([1.0, 2.0, 3.0]), np.array([True, True, False]))
    assert pareto.table("t", [point], "near").texts()[0][:5] == ["a", "1", "3", "1.0", "2.000"]
    chart = pareto.chart("t", [point], 0.1)
    assert (chart.level, chart.front) == (0.1, [(1.0, 2.0)])
    assert "Cramér-Rao bound" in draw([chart])


def test_the_interval_of_a_median_holds_it():
    median = Quantile.of(np.arange(101.0), 2.0)
    assert median.value == 100.0
    assert 70 < median.low < 100 < median.high < 130
    assert plain(median) == {"median": 100.0, "n": 101, "interval_95": [median.low, median.high]}
    assert plain(Quantile.of([1.0, np.nan], share=0.9))["quantile_90"] == 1.0
    assert text_of(Quantile.of([])) == "–"


def test_a_bound_is_the_median_of_the_errors_it_allows():
    covariance = np.diag([1.0, 1.0, 1.0, 1e-6, 1e-6, 1e-6])  # 1 mm per axis
    bound = pareto.least_error([covariance] * 20, lambda case, delta: np.linalg.norm(delta[:, 3:], axis=1))
    assert bound == pytest.approx(1.538, rel=0.05)  # of a Gaussian in space


def test_methods_are_measured_on_one_thread_and_warm():
    seen = []

    def solve(case, seed):
        seen.append((case, thread_count()))
        return case

    before = thread_count()
    methods = [pareto.Method("a", "1", solve), pareto.Method("a", "2", solve), pareto.Method("b", "1", solve)]
    points = pareto.measure(
        methods[:1], ["x", "x", "y"], lambda case: case, lambda case, answer: (2.0, True), 0, lambda i, n, w: i, "t"
    )
    assert seen == [("x", 1), ("x", 1), ("x", 1), ("y", 1), ("y", 1)]
    assert thread_count() == before
    assert points[0].error.tolist() == [2.0] * 3
    assert [m.budget for m in pareto.swept(methods, quick=True)] == ["1", "1"]
    assert pareto.swept(methods, quick=False) == methods
