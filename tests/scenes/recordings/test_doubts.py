"""What may be right and seldom is: a warning of `validate`, once for all frames that are alike."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from commands import run
from made_frames import some_frame

from scenes.files.formats import images
from scenes.recordings.captures import write_capture
from scenes.recordings.checking.validation import validate
from scenes.synthesis.library import make


@pytest.fixture
def capture(tmp_path):
    return write_capture(tmp_path / "c", [some_frame(index) for index in range(3)], make("box"))


def told(folder, problems: int = 0) -> list[str]:
    found = []
    assert len(validate(folder, doubts=found.append)) == problems
    return [str(doubt) for doubt in found]


def edit(folder, name, change):
    content = json.loads((folder / name).read_text())
    for entry in content.values():
        change(entry)
    (folder / name).write_text(json.dumps(content))


def test_what_is_as_it_must_be_has_none(capture):
    assert told(capture) == []


@pytest.mark.parametrize(("cx", "cy"), [(0.0, 0.0), (63.0, 0.0), (80.0, 23.5), (31.5, -0.5)])
def test_a_principal_point_in_a_corner_or_beside_the_image(capture, cx, cy):
    edit(capture, "scene_camera.json", lambda entry: entry.update(cam_K=[80, 0, cx, 0, 82, cy, 0, 0, 1]))
    expected = f"expected a principal point about the middle, got {cx:g}, {cy:g} for 64x48 pixels"
    said = f"{expected}: was the image cut out of a larger one? (2 more frames alike)"
    assert told(capture) == [f"{capture / 'scene_camera.json'}, frame 0: {said}"]


@pytest.mark.parametrize(("filled", "what"), [(False, "none"), (True, "100% of the image")])
def test_a_mask_that_is_no_outline(tmp_path, filled, what):
    frames = [some_frame(index) for index in range(2)]
    masked = [replace(frame, mask=np.full_like(frame.mask, filled)) for frame in frames]
    folder = write_capture(tmp_path / "masked", masked, make("box"))
    said = f"expected a mask of the object's own pixels, got {what} (1 more frame alike)"
    assert told(folder) == [f"{folder / 'mask_visib'}, frame 0: {said}"]


@pytest.mark.parametrize(("cx", "cy"), [(0.0, 23.5), (50.0, 5.0)])
def test_a_principal_point_of_a_cut_out_is_none(capture, cx, cy):
    edit(capture, "scene_camera.json", lambda entry: entry.update(cam_K=[80, 0, cx, 0, 82, cy, 0, 0, 1]))
    assert told(capture) == []


@pytest.mark.parametrize(("scale", "median"), [(1e-3, "0.00625"), (6.0, "37.5")])
def test_depths_of_another_unit(capture, scale, median):
    """Nothing else tells of it: neither truth nor prior nor a cloud."""
    for name in ("scene_gt.json", "prior.json"):
        (capture / name).unlink()
    edit(capture, "scene_camera.json", lambda entry: entry.update(depth_scale=scale))
    (said,) = told(capture)
    where = f"{capture / 'depth' / '000000.png'}, frame 0"
    expected = f"expected depths from 0.05 to 20 m, got a median of {median}: is depth_scale millimetres per count?"
    assert said == f"{where}: {expected} (2 more frames alike)"


def test_holes_of_the_largest_count(capture):
    path = capture / "depth" / "000001.png"
    counts = images.read_counts(path)
    holes = counts == 0
    images.write_counts(path, np.where(holes, 65535, counts))
    expected = f"expected 0 where there is no reading, got 65535 in {holes.mean():.0%} of the pixels"
    assert told(capture) == [f"{path}, frame 1: {expected}"]


def test_few_of_the_largest_count_are_what_a_camera_reads(capture):
    path = capture / "depth" / "000001.png"
    counts = images.read_counts(path)
    counts[0, :20] = 65535
    images.write_counts(path, counts)
    assert told(capture) == []


def test_the_truth_of_another_object(capture, tmp_path, capsys):
    edit(capture, "scene_gt.json", lambda rows: rows[0].update(obj_id=7))
    expected = "expected the truth of obj_id 1, as capture.json has it, got 7 (2 more frames alike)"
    said = f"{capture / 'scene_gt.json'}, frame 0: {expected}"
    assert told(capture) == [said]
    assert run("validate", capture, "--json", tmp_path / "v.json") == 0
    assert capsys.readouterr().out == f"warning: {said}\n{capture}: 3 frames, no problem, 1 warning\n"
    entry = {"file": str(capture / "scene_gt.json"), "frame": 0, "message": expected}
    content = json.loads((tmp_path / "v.json").read_text())
    assert (content["valid"], content["problems"], content["warnings"]) == (True, [], [entry])


def test_the_truth_of_others_beside_the_object_is_none(capture):
    edit(capture, "scene_gt.json", lambda rows: rows.append({**rows[0], "obj_id": 7}))
    assert told(capture) == []
