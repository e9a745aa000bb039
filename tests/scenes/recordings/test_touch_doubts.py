"""What touch says and nobody means: warnings of `validate`; and what `estimate` says of what it passes over."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from commands import refused, run
from made_frames import plain_view, some_frame

from scenes.files.formats import images
from scenes.recordings.captures import write_capture
from scenes.recordings.checking.validation import validate
from scenes.recordings.frames import Contacts, EmptyRegions
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.library import make


def told(folder) -> list[str]:
    found = []
    assert validate(folder, doubts=found.append) == []
    return [str(doubt) for doubt in found]


def made(folder, **parts):
    """A capture of touch alone, with these parts."""
    return write_capture(folder / "c", [replace(plain_view(), **parts)], make("box"))


@pytest.fixture
def felt():
    """Two contacts of the view's, which are as they should be."""
    points = plain_view().contacts.points[:2]
    assert len(points) == 2
    return points


@pytest.mark.parametrize(
    ("sigmas", "said"),
    [
        ({"sigma_point": [0.06, 0.001]}, "expected a sigma_point up to 0.05 m, got 0.06: is it in metres?"),
        ({"sigma_point": [1e-6, 0.001]}, "expected a sigma_point from 1e-05 m, got 1e-06: is it in metres?"),
        (
            {"sigma_point": [0.001, 0.001], "sigma_normal": [0.1, 5.0]},
            "expected a sigma_normal up to 1 rad, got 5: is it in radians?",
        ),
        ({"sigma_point": [0.05, 1e-5], "sigma_normal": [1.0, 0.1]}, None),
    ],
)
def test_sigmas_of_no_sensor(tmp_path, felt, sigmas, said):
    capture = made(tmp_path, contacts=Contacts(felt, [[0.0, 0.0, 1.0]] * 2, **sigmas))
    assert told(capture) == ([] if said is None else [f"{capture / 'contacts.csv'}, frame 0: {said}"])


def test_a_contact_far_from_all_others(tmp_path, felt):
    capture = made(tmp_path, contacts=Contacts(np.concatenate([felt, felt[:1] + np.array([0.0, 0.0, 2.5])])))
    (said,) = told(capture)
    assert (
        said == f"{capture / 'contacts.csv'}, frame 0: expected contacts within 2 m of others, got one 2.5 m from any"
    )


def test_a_place_without_contact_as_large_as_a_room(tmp_path, felt):
    capture = made(tmp_path, no_contact=EmptyRegions(felt[:1], np.array([3.0]), ["a"]))
    (said,) = told(capture)
    assert said.endswith("no_contact.csv, frame 0: expected a radius up to 0.2 m, got 3: is it in metres?")


def held(folder):
    hand = five_finger_hand()
    return write_capture(folder / "c", [some_frame(0, hand)], make("box"), hand)


def test_a_sensor_that_the_hand_lacks(tmp_path):
    capture = held(tmp_path)
    before = told(capture)
    path = capture / "contacts.csv"
    lines = path.read_text().splitlines()
    cells = lines[1].split(",")
    cells[1] = cells[1] + "x"
    path.write_text("\n".join([lines[0], ",".join(cells), *lines[2:]]) + "\n")
    (said,) = [line for line in told(capture) if line not in before]
    assert said.startswith(f"{path}, frame 0: expected sensors of the hand (")
    assert said.endswith(f"), got {cells[1]!r}")


def test_a_fingertip_as_large_as_a_ball(tmp_path):
    capture = held(tmp_path)
    path = capture / "hand" / "sensors.json"
    content = json.loads(path.read_text())
    name = next(iter(content))
    content[name]["surface"] = {"sphere": {"radius": 8.0}}
    path.write_text(json.dumps(content))
    said = [line for line in told(capture) if "surface" in line]
    assert said == [f"{path}: expected a radius of {name}'s surface up to 0.2 m, got 8: is it in metres?"]


def test_a_mask_of_a_row_that_the_truth_lacks(tmp_path):
    capture = made(tmp_path)
    mask = np.zeros((240, 320), dtype=np.uint8)
    images.write_mask(capture / "mask_visib" / "000000_000009.png", mask > 0)
    (said,) = told(capture)
    where = capture / "mask_visib" / "000000_000009.png"
    assert (
        said
        == f"{where}, frame 0: expected a row of scene_gt.json, which has 1 of this frame, got row 9: it is not read"
    )


def edit(capture, change):
    path = capture / "capture.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


@pytest.mark.parametrize(
    "change",
    [
        lambda content: content.update(version=True),
        lambda content: content["object"].update(name=5),
        lambda content: content["object"].update(id=True),
    ],
)
def test_what_validate_refuses_in_capture_json_estimate_refuses(tmp_path, capsys, change):
    capture = made(tmp_path)
    edit(capture, change)
    assert validate(capture)
    assert f"{capture / 'capture.json'}: expected " in refused(capsys, "estimate", capture, "--out", tmp_path / "o")


@pytest.mark.parametrize("command", ["estimate", "track", "compare", "grasp"])
def test_commands_say_what_they_pass_over(tmp_path, capsys, command):
    capture = write_capture(tmp_path / "c", [plain_view(), replace(plain_view(), index=1)], make("box"))
    edit(capture, lambda content: content.update(notes={"stamps_ns": {"0": 5, "1": 3}}))
    images.write_mask(capture / "mask_visib" / "000007_000000.png", np.ones((240, 320), dtype=bool))
    more = {
        "estimate": ("--out", tmp_path / "o", "--no-report"),
        "track": ("--out", tmp_path / "o", "--no-report"),
        "compare": ("--methods", "icp"),
        "grasp": (),
    }
    assert run(command, capture, *more[command]) in (0, 1)
    err = capsys.readouterr().err
    assert "palpate: passed over: " in err
    assert "stamps_ns: expected times that run forwards" in err
    assert "000007_000000.png, frame 7: expected a frame of the capture" in err
