"""Results that say what no answer is, or that are of another capture, are refused in one line."""

import json

import numpy as np
import pytest
from commands import refused
from made_frames import plain_view

from fusion.results.files import read_result
from scenes.errors import InputError
from scenes.recordings.captures import write_capture
from scenes.synthesis.library import make

POSE = np.eye(4).tolist()
MODE = {"pose": POSE, "weight": 1.0, "cost": 0.0}
GOOD = {"frame": 0, "verdict": "ok", "camera_from_object": POSE, "covariance": np.eye(6).tolist(), "modes": [MODE]}


def _written(folder, *entries, **more):
    path = folder / "result.json"
    path.write_text(json.dumps({"frames": list(entries), **more}))
    return path


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"verdict": "great"}, "frame 0: verdict: expected one of ok, ambiguous, lost, got 'great'"),
        ({"modes": [MODE | {"weight": -1}]}, "weight of a mode: expected a number from 0 to 1, got -1"),
        ({"modes": [MODE | {"weight": float("nan")}]}, "weight of a mode: expected a number from 0 to 1, got nan"),
        ({"covariance": (-np.eye(6)).tolist()}, "covariance: expected variances from 0, got -1"),
        ({"confidence": 3}, "confidence: expected a number from 0 to 1, got 3"),
        ({"frame": 0.7}, "frame: expected a whole number from 0, got 0.7"),
        ({"frame": float("inf")}, "frame: expected a whole number from 0, got inf"),
    ],
)
def test_answers_that_are_none(tmp_path, change, told):
    assert len(read_result(_written(tmp_path, GOOD))[1]) == 1
    with pytest.raises(InputError, match=f"result.json: {told}"):
        read_result(_written(tmp_path, GOOD | change))


def test_a_frame_has_one_answer_and_a_capture_s_place_is_a_text(tmp_path):
    with pytest.raises(InputError, match="frames: expected each frame once, got 0 twice"):
        read_result(_written(tmp_path, GOOD, GOOD))
    with pytest.raises(InputError, match="capture_path: expected a text, got 5"):
        read_result(_written(tmp_path, GOOD, capture_path=5))


def test_a_result_of_another_capture_is_not_shown_or_converted(tmp_path, capsys):
    one, other = (write_capture(tmp_path / name, [plain_view("box")], make("box")) for name in ("one", "other"))
    path = _written(tmp_path, GOOD, capture="one", capture_path=str(one))
    told = f"{other}: expected one, the capture of {path}, got other"
    assert told in refused(capsys, "view", other, path, "--no-browser")
    assert told in refused(capsys, "convert", other, tmp_path / "x.tum", "--result", path, "--fps", 10)


def test_a_link_to_nothing_is_refused_before_the_work(tmp_path, capsys):
    capture = write_capture(tmp_path / "c", [plain_view("box")], make("box"))
    (tmp_path / "link").symlink_to(tmp_path / "gone")
    said = refused(capsys, "estimate", capture, "--out", tmp_path / "link")
    assert "expected a folder to write to, found a link to nothing" in said
