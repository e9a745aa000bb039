"""The profile of a frame: every stage is named, times add up, and ICP stands beside."""

import pytest

from fusion.benchmarks.frames import profile
from fusion.benchmarks.printing.tables import BenchSettings


def test_stages_and_icp_of_one_frame(monkeypatch):
    monkeypatch.setattr(profile, "RUNS", 1)
    shown = []
    settings = BenchSettings(quick=True, family="desk", objects=("box",), show=shown.append)
    report = profile.run(settings)
    assert shown == report.tables
    titles = ["fused, with a start", "vision, with a start", "fused, without a start", "vision, without a start"]
    assert [table.title for table in report.tables] == titles
    for table in report.tables:
        times = {row[0]: row[-1] for row in table.rows}
        assert {"look", "solve together", "judge", profile.BETWEEN} <= set(times)
        whole, others = times.pop(profile.WHOLE), ("ICP", "of ICP", profile.BY_CLOCK)
        assert whole == pytest.approx(sum(ms for name, ms in times.items() if name not in others))
        assert times["ICP"] > 0
        assert times[profile.BY_CLOCK] > 0
    assert {claim.target for claim in report.claims} == {25.0, 15.0, 0.5}


def test_the_quickest_run_of_each_counts_and_they_take_turns():
    done = []

    def work(name, times):
        done.append(name)
        return sum(range(100_000 * next(times)))

    slow, quick = iter([4, 3, 2, 1]), iter([1, 1, 1, 1])
    found = profile._quickest([lambda: work("slow", slow), lambda: work("quick", quick)])
    assert found[0][2] in [sum(range(100_000 * k)) for k in (1, 2, 3)]
    assert done == ["slow", "quick"] * 4
    assert all(spent > 0 and clock > 0 for spent, clock, _ in found)
