"""What a user wrote is judged by the option it was written for, and answered in the user's own units and words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from commands import refused, run
from made_frames import plain_view

from fusion import estimate
from scenes.recordings.captures import write_capture
from scenes.synthesis.library import make


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return write_capture(tmp_path_factory.mktemp("words") / "box", [plain_view()], make("box"))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--tolerance -1,2", "argument --tolerance: expected a length and an angle like 33mm,16deg, got '-1,2'"),
        ("--calibration -1,2", "argument --calibration: expected a length and an angle like 33mm,16deg, got '-1,2'"),
        ("--tolerance 0,0", "argument --tolerance: expected a length and an angle above 0 like 1mm,2deg, got '0,0'"),
        ("--mesh 1e9", "argument --mesh: expected a number above 0 and up to 50 mm, got '1e9'"),
        ("--mesh -.5", "argument --mesh: expected a number above 0, got '-.5'"),
        ("--budget-ms -3", "argument --budget-ms: expected a number from 0, got '-3'"),
    ],
)
def test_numbers_are_answered_as_they_were_written(capsys, capture, words, message):
    assert message in refused(capsys, "estimate", capture, *words.split())


@pytest.mark.parametrize("command", ["estimate", "convert", "identify"])
def test_a_unit_that_is_none_is_refused_also_where_nothing_has_one(capsys, tmp_path, capture, command):
    words = {
        "estimate": [capture],
        "convert": [capture / "contacts.csv", tmp_path / "out", "--object", "drill"],
        "identify": [capture / "contacts.csv", "--objects", "box,drill"],
    }[command]
    line = refused(capsys, command, *words, "--unit", "furlong")
    assert line == "palpate: unit: expected one of m, cm, mm, inch, got 'furlong'\n"
    assert not (tmp_path / "out").exists()


def test_a_result_that_is_not_there_says_what_was_expected(capsys, tmp_path, capture):
    poses = tmp_path / "poses.csv"
    poses.write_text("scene_id,im_id,obj_id,score,R,t,time\n0,0,1,1,1 0 0 0 1 0 0 0 1,0 0 500,-1\n")
    line = refused(capsys, "evaluate", poses, capture, "--result", tmp_path / "nothere")
    assert f"{tmp_path / 'nothere'}: expected a result.json, it cannot be opened: No such file or directory" in line


def test_times_that_nobody_recorded_are_said(capsys, tmp_path, capture):
    assert run("convert", capture, tmp_path / "t.tum") == 0
    assert "the recording has no times (stamps_ns): frames are written as if 30 came in a second" in (
        capsys.readouterr().err
    )
    assert run("convert", capture, tmp_path / "t.tum", "--fps", "10") == 0
    assert capsys.readouterr().err == ""


def test_times_that_are_none_are_not_replaced(capsys, tmp_path):
    folder = write_capture(tmp_path / "box", [plain_view()], make("box"), notes={"stamps_ns": {"0": "noon"}})
    line = refused(capsys, "convert", folder, tmp_path / "t.tum")
    assert "capture.json: stamps_ns: expected whole nanoseconds, got 'noon' of frame 0" in line


def test_a_hand_that_is_left_out_is_said(tmp_path, hand):
    frame = replace(plain_view(), hand=hand, joints=dict.fromkeys(hand.joint_names, 0.1), world_from_hand=np.eye(4))
    told = []
    for known in (frame, replace(frame, joints=None), replace(frame, world_from_hand=None)):
        found = estimate(known, make("box"))
        told.append([note for note in found.notes if note.startswith("the hand is left out")])
    assert told == [[], ["the hand is left out: no joints known"], ["the hand is left out: no pose known"]]
