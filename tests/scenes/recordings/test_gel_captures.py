"""Gels in captures: what is written is read back, and what does not fit is one line with file and frame."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from scenes.errors import CaptureError, InputError
from scenes.recordings.captures import read_capture, write_capture
from scenes.recordings.checking.validation import validate
from scenes.recordings.frames import Frame
from scenes.robot.digit import digit_gel
from scenes.robot.gels import Gel
from scenes.robot.hands import Hand
from scenes.robot.sensors import Sensor, read_sensors, write_sensors
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.library import make

NAME = "pad"


def gelled(gel: Gel) -> Hand:
    hand = five_finger_hand()
    return Hand(hand.robot, {NAME: Sensor(NAME, "index_distal", "gel", np.eye(4), gel=gel)})


def frame_of(hand: Hand, image) -> Frame:
    joints = dict.fromkeys(hand.joint_names, 0.1)
    return Frame(0, "f", hand=hand, joints=joints, world_from_hand=np.eye(4), gels={NAME: image})


@pytest.fixture
def gel(rng):
    colours = rng.integers(20, 200, (48, 36, 3), dtype=np.uint8)
    return replace(digit_gel((36, 48), colours), calibration={"format": "x"})


def test_files_of_a_gel_stay_in_the_capture(tmp_path, gel, rng):
    hand = gelled(gel)
    write_capture(tmp_path / "c", [frame_of(hand, gel.background)], make("box"), hand=hand)
    path = tmp_path / "c/hand/sensors.json"
    content = json.loads(path.read_text())
    for key in ("background", "calibration"):
        moved = tmp_path / Path(content[NAME]["gel"][key]).name
        (path.parent / content[NAME]["gel"][key]).rename(moved)
        content[NAME]["gel"][key] = str(moved)
        path.write_text(json.dumps(content))
        with pytest.raises(CaptureError, match=rf"gel: {key}: expected files inside .*--trust-paths"):
            read_capture(tmp_path / "c")[0]
        assert read_capture(tmp_path / "c", trust_paths=True)[0].gels
        moved.rename(path.parent / "gels" / moved.name)
        content[NAME]["gel"][key] = f"gels/{moved.name}"


def test_a_gel_is_written_and_read(tmp_path, gel, rng):
    hand = gelled(gel)
    image = rng.integers(0, 250, (48, 36, 3), dtype=np.uint8)
    write_capture(tmp_path / "c", [frame_of(hand, image)], make("box"), hand=hand)
    capture = read_capture(tmp_path / "c")
    np.testing.assert_array_equal(capture[0].gels[NAME], image)
    read = capture.hand.sensors[NAME].gel
    np.testing.assert_allclose(read.surface, gel.surface, atol=6e-7)
    np.testing.assert_allclose(read.points(1e-4), gel.points(1e-4), atol=2e-6)
    np.testing.assert_array_equal(read.background, gel.background)
    assert read.calibration == gel.calibration
    assert validate(tmp_path / "c") == []
    flat = Gel(20, 10, np.zeros((10, 20)), 1e-4)
    hand = gelled(flat)
    counts = rng.integers(0, 2000, (10, 20)).astype(np.uint16)
    write_capture(tmp_path / "d", [frame_of(hand, counts)], make("box"), hand=hand)
    np.testing.assert_array_equal(read_capture(tmp_path / "d")[0].gels[NAME], counts)


def test_images_that_do_not_fit_are_problems(tmp_path, gel, rng):
    hand = gelled(gel)
    folder = write_capture(tmp_path / "c", [frame_of(hand, gel.background[::-1].copy())], make("box"), hand=hand)
    file = folder / "tactile" / NAME / "000000.png"

    def said(image) -> str:
        cv2.imwrite(str(file), image)
        problems = validate(folder)
        assert len(problems) == 1, problems
        with pytest.raises(CaptureError, match=r"000000.png, frame 0: expected"):
            read_capture(folder)[0]
        return str(problems[0])

    assert "expected an image of 36x48 pixels as the gel's, got 10x20" in said(np.full((20, 10, 3), 7, np.uint8))
    assert "got red saturated in" in said(np.dstack([gel.background[:, :, :2], np.full((48, 36), 255, np.uint8)]))
    assert "of 8 bit in colour, or of 16 bit" in said(np.zeros((48, 36), np.uint8))
    assert "expected indentations up to the gel's" in said(np.full((48, 36), 60_000, np.uint16))
    file.write_bytes(b"\x89PNG\r\n\x1a\nxx")
    assert "expected a PNG image" in str(validate(folder)[0])


def test_a_colour_image_needs_its_background(tmp_path, gel):
    hand = gelled(replace(gel, background=None))
    folder = write_capture(tmp_path / "c", [frame_of(hand, gel.background)], make("box"), hand=hand)
    assert "expected the untouched background" in str(validate(folder)[0])


def test_an_image_of_no_gel_is_a_problem(tmp_path, gel):
    hand = gelled(gel)
    folder = write_capture(tmp_path / "c", [frame_of(hand, gel.background[::-1].copy())], make("box"), hand=hand)
    (folder / "tactile" / NAME).rename(folder / "tactile" / "thumb")
    assert "expected a gel of hand 'five_finger_hand' (pad), got 'thumb'" in str(validate(folder)[0])


GOOD = {"size": [36, 48], "mm_per_pixel": 0.1}


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (None, "expected the entry gel for a gel"),
        ([], "expected an object with size"),
        ({**GOOD, "size": [2, 48]}, "size: expected width and height"),
        ({**GOOD, "size": [36.5, 48]}, "size: expected width and height"),
        ({"size": [36, 48]}, "expected one of mm_per_pixel and camera"),
        ({**GOOD, "mm_per_pixel": 0}, "mm_per_pixel: expected"),
        ({**GOOD, "mm_per_pixel": "x"}, "expected 1 numbers"),
        ({"size": [36, 48], "camera": {"cam_K": [1] * 9}}, "distance: expected 1 finite numbers"),
        ({"size": [36, 48], "camera": {"cam_K": [0] * 9, "distance": 0.02}}, "expected focal lengths"),
        ({**GOOD, "thickness": -1}, "thickness: expected metres above 0"),
        ({**GOOD, "surface": "bumpy"}, 'expected "flat" or an object'),
        ({**GOOD, "surface": {"file": "none.png"}}, "found none"),
        ({**GOOD, "background": 3}, "expected a file name"),
        ({**GOOD, "background": "text.png"}, "expected a PNG image"),
        ({**GOOD, "background": "small.png"}, "expected an image of 36x48 pixels"),
        ({**GOOD, "calibration": "text.png"}, "expected JSON"),
    ],
)
def test_a_malformed_gel_is_one_line(tmp_path, entry, message):
    (tmp_path / "text.png").write_text("{")
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((4, 4, 3), np.uint8))
    path = tmp_path / "sensors.json"
    path.write_text(json.dumps({NAME: {"link": "l", "kind": "gel", "gel": entry}}))
    with pytest.raises(InputError, match=r"sensors.json: sensor 'pad'") as caught:
        read_sensors(path)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_sensors_keep_their_gels(tmp_path, gel):
    write_sensors(tmp_path / "sensors.json", {NAME: Sensor(NAME, "l", "gel", np.eye(4), gel=gel)})
    read = read_sensors(tmp_path / "sensors.json")[NAME].gel
    assert (read.width, read.height, read.thickness) == (36, 48, gel.thickness)
    np.testing.assert_allclose(read.rays, gel.rays)
