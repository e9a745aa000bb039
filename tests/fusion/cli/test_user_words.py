"""What a user wrote is judged by the option it was written for, and answered in the user's own units and words."""

from __future__ import annotations

import pytest
from commands import refused
from made_frames import plain_view

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
        ("--budget-ms -3", "argument --budget-ms: expected a number above 0, got '-3'"),
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
