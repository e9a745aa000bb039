"""A key that stands twice in a capture's JSON is refused with file and key: one of the two would be lost."""

from __future__ import annotations

import json

import pytest
from commands import refused, run
from made_frames import some_frame

from scenes.files.formats.json_text import parsed
from scenes.recordings.captures import write_capture
from scenes.recordings.checking.validation import validate
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.library import make


@pytest.fixture
def capture(tmp_path):
    hand = five_finger_hand()
    return write_capture(tmp_path / "c", [some_frame(0, hand)], make("box"), hand)


def twice(path, key, again=None):
    """The first entry of the file once more, as `again`."""
    entry = json.dumps(json.loads(path.read_text())[key])
    path.write_text(f'{{"{again or key}": {entry}, {path.read_text().lstrip()[1:]}')


@pytest.mark.parametrize(
    ("name", "key", "again"),
    [
        ("prior.json", "0", None),
        ("scene_camera.json", "0", "00"),
        ("scene_gt.json", "0", None),
        ("capture.json", "object", None),
        ("hand/sensors.json", None, None),
        ("models/models_info.json", "1", None),
    ],
)
def test_a_key_that_stands_twice_is_refused_everywhere(capture, capsys, name, key, again):
    path = capture / name
    key = key or next(iter(json.loads(path.read_text())))
    twice(path, key, again)
    problems = [str(problem) for problem in validate(capture) if "expected each" in str(problem)]
    assert problems
    assert all(name in problem and key in problem for problem in problems)
    said = refused(capsys, "estimate", capture, "--out", capture.parent / "o")
    assert "expected each" in said
    assert name in said


def test_a_key_twice_within_a_frame(capture):
    path = capture / "scene_camera.json"
    path.write_text(path.read_text().replace('"cam_K"', '"cam_K": [1], "cam_K"'))
    problem, *_ = validate(capture)
    assert str(problem).startswith(f"{path}: ")
    assert "each key once, got 'cam_K' twice" in str(problem)


def test_other_objects_may_have_the_same_keys(capture):
    assert parsed('{"a": {"b": 1}, "c": {"b": 1}}') == {"a": {"b": 1}, "c": {"b": 1}}
    assert run("validate", capture) == 0
