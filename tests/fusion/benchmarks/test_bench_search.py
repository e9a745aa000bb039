"""The search benchmark: outcomes, tables, and what is kept of a miss."""

import json
import math
from dataclasses import replace

import numpy as np

from fusion import estimate
from fusion.benchmarks.families.table import FAMILIES
from fusion.benchmarks.frames import search
from fusion.benchmarks.frames.missed import keep_miss
from fusion.benchmarks.printing.tables import BenchSettings, Report
from fusion.benchmarks.strata import Answer, senses_table
from fusion.estimation.steps.judge import judge
from scenes.recordings.captures import read_capture


def tried(add_s, truth_add_s, gap, sense="fused", start=True, frame="mug/0"):
    told = search.Told(start, False, True)
    return search.Tried("lab", 0.3, frame, sense, told, True, add_s, truth_add_s, gap, "ok")


def test_whose_fault_an_answer_is():
    assert tried(0.001, 0.001, 5.0).outcome == search.RIGHT  # two places in one valley
    assert tried(0.020, 0.001, 5.0).outcome == search.MISSED
    assert tried(0.001, 0.020, 5.0).outcome == search.MISSED  # right, and yet not what the objective prefers
    assert tried(0.020, 0.001, 0.5).outcome == search.ALIKE
    assert tried(0.020, 0.001, -5.0).outcome == search.PREFERRED
    assert tried(0.020, math.nan, math.nan).outcome == search.ALIKE


def test_what_the_search_found_and_the_answer_left_is_told():
    told = search.Told(True, False, True)

    def made(add_s, gap, own_gap):
        return search.Tried(
            "lab", 0.3, "mug/0", "fused", told, True, add_s, 0.001, gap, "ok", math.nan, math.nan, own_gap
        )

    assert made(0.020, 0.2, 6.0).given_up
    assert not made(0.020, 6.0, 6.0).given_up  # missed
    assert not made(0.001, 0.2, 6.0).given_up  # right all the same
    assert not made(0.020, -5.0, -5.0).given_up  # what the objective prefers
    assert not tried(0.020, 0.001, 0.2).given_up  # not known


def test_tables_count_what_they_say():
    found = [tried(0.001, 0.001, 0.0), tried(0.02, 0.001, 4.0), tried(0.02, 0.001, 2.0), tried(0.02, 0.001, -8.0)]
    table = search.by_family(found, "fused", True)
    row = dict(zip([column.name for column in table.columns], table.texts()[0], strict=True))
    assert (row["family"], row["hidden"], row["frames"]) == ("lab", "30 %", "4")
    assert (row["< 5 mm"], row["missed"], row["missed, of all"]) == ("25 %", "50 %", "2")
    assert (row["objective prefers wrong"], row["data cannot tell"]) == ("25 %", "0 %")
    assert (row["gap of missed, nats"], row["gap of preferred"]) == ("3.0", "-8.0")
    assert not search.by_family(found, "vision", True).rows
    told = search.by_told([*found, tried(0.001, 0.001, 0.0, start=False)])
    rows = [dict(zip([c.name for c in told.columns if c.name], row, strict=False)) for row in told.texts()]
    assert [(r["sense"], r["start"], r["mask"], r["frames"]) for r in rows] == [
        ("fused", "yes", "no", "4"),
        ("fused", "no", "no", "1"),
    ]
    assert (rows[0]["95 % of missed"], rows[0]["asked"]) == ("15.0 to 85.0 %", "<= 0.5 %")
    assert [row[-3] for row in told.texts()] == ["MISSED", "met"]
    report = Report("search", "", "", 0)
    search._claims(report, found)
    assert [claim.value for claim in report.claims] == [0.5]


def test_what_is_told_of_a_family_in_its_own_words_first():
    every = search.told_of(FAMILIES["lab"], False)
    assert len(every) == len(set(every)) == 8
    assert every[0] == search.Told(True, False, True)
    assert len(search.told_of(FAMILIES["loose"], False)) == 4
    assert search.told_of(FAMILIES["desk"], True) == (search.Told(True, False, False), search.Told(False, False, False))


def test_fused_below_the_better_sense_is_counted():
    def answer(sense, add_s, verdict="ok", frame="mug/0"):
        return Answer("lab", 0.3, sense, True, add_s, 1.0, 0.5, verdict, frame=frame)

    answers = [answer("fused", 0.02), answer("vision", 0.02), answer("touch", 0.001)]
    answers += [answer(s, 0.001 if s == "fused" else 0.02, frame="mug/1") for s in ("fused", "vision", "touch")]
    table = senses_table(answers)
    row = dict(zip([column.name for column in table.columns], table.texts()[0], strict=True))
    assert (row["frames"], row["fused < 5 mm"], row["touch < 5 mm"]) == ("2", "50 %", "50 %")
    assert (row["fused wrong, a sense right"], row["of these ok"]) == ("50 %", "1")
    assert row["fused right, both wrong"] == "50 %"


def test_a_miss_is_a_capture_both_poses_and_a_picture(lab_frame, drill, tmp_path):
    answer = estimate(lab_frame, drill)
    costs = judge(lab_frame, drill, np.array([answer.pose, lab_frame.camera_from_object_truth]))
    words = {"family": "lab", "hidden": 0.8, "object": "drill", "trial": 0, "sense": "fused", "told": "no start, hand"}
    home = keep_miss(tmp_path, lab_frame, drill, words, answer, costs)
    kept = json.loads((home / "miss.json").read_text())
    assert kept["family"] == "lab"
    np.testing.assert_allclose(kept["poses"]["answer"], answer.pose)
    assert set(kept["costs"]) == {"answer", "truth"}
    assert (home / "miss.png").is_file()
    capture = read_capture(home / "capture")
    assert len(capture[0].contacts) == len(lab_frame.contacts)


def test_a_whole_run():
    settings = BenchSettings(trials=1, seed=3, quick=True, objects=("mug",), family="loose")
    report = search.run(settings)
    titles = [table.title for table in report.tables]
    assert "Is fused ever below the better sense?" in titles
    assert "By what is told" in titles
    assert len(report.claims) == 6


def test_what_is_missed_may_be_told_as_another_mode():
    beside = replace(tried(0.02, 0.001, 4.0), beside=True)
    assert beside.outcome == search.MISSED
    table = search.by_family([beside, tried(0.02, 0.001, 4.0)], "fused", True)
    row = dict(zip([column.name for column in table.columns], table.texts()[0], strict=True))
    assert (row["missed, of all"], row["told as another mode"]) == ("2", "1")
