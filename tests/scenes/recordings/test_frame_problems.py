"""What is well formed and still useless or doubtful is said by `validate`, and what no estimate should be made of."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from made_frames import hand_with_array, some_frame

from scenes.errors import CaptureError, InputError
from scenes.recordings import bop
from scenes.recordings.captures import read_capture, write_capture
from scenes.recordings.checking.validation import check_usable, scale_problem, validate
from scenes.recordings.frames import Contacts, Frame, Wrench
from scenes.recordings.manifest import frame_stamps
from scenes.synthesis.library import make


@pytest.fixture(scope="module")
def hand():
    return hand_with_array()


@pytest.fixture
def capture(tmp_path, hand):
    return write_capture(tmp_path / "c", [some_frame(0, hand)], make("box"), hand=hand)


def said(folder) -> list[str]:
    return [str(problem) for problem in validate(folder)]


def edited(folder, name, change):
    content = json.loads((folder / name).read_text())
    change(content)
    (folder / name).write_text(json.dumps(content))
    return said(folder)


def test_what_is_as_it_must_be_has_none(capture):
    assert said(capture) == []


@pytest.mark.parametrize("scale", [1e308, 1e4, 1e-5, 0.0, -1.0])
def test_a_depth_scale_that_makes_no_metres(capture, scale, recwarn):
    told = edited(capture, "scene_camera.json", lambda content: content["0"].update(depth_scale=scale))
    assert any(
        f"depth_scale: expected millimetres per count from 0.0001 to 1000, got {scale:g}" in line for line in told
    )
    assert not [warning for warning in recwarn if issubclass(warning.category, RuntimeWarning)]
    with pytest.raises(CaptureError, match="depth_scale"):
        read_capture(capture)[0]


def test_a_depth_scale_of_null_is_said_as_it_is(capture):
    told = edited(capture, "scene_camera.json", lambda content: content["0"].update(depth_scale=None))
    assert any("depth_scale: expected 1 finite number, got nothing (null)" in line for line in told)


@pytest.mark.parametrize(("at", "name", "value"), [(2, "cx", 5000.0), (5, "cy", -300.0)])
def test_a_principal_point_far_from_the_image(capture, at, name, value):
    told = edited(capture, "scene_camera.json", lambda content: content["0"]["cam_K"].__setitem__(at, value))
    size = 64 if name == "cx" else 48
    assert any(f"got {name} {value:g} for {size} pixels" in line for line in told)


def test_a_principal_point_beside_a_cut_out_is_none(capture):
    assert edited(capture, "scene_camera.json", lambda content: content["0"]["cam_K"].__setitem__(2, 80.0)) == []


@pytest.mark.parametrize(
    ("files", "lacks", "where"),
    [
        (["hand_poses.csv"], "pose", ", frame 0: expected the hand's pose, found none"),
        (["joints.csv"], "joints", ", frame 0: expected the hand's joints, found none"),
        (
            ["hand_poses.csv", "joints.csv"],
            "pose and joints",
            ": expected the hand's pose and joints in a frame at least, found none",
        ),
    ],
)
def test_a_hand_that_is_nowhere(capture, files, lacks, where):
    for name in files:
        (capture / name).unlink()
    assert [line for line in said(capture) if "the hand is left out" in line] == [
        f"{capture / files[0]}{where}: the hand is left out"
    ]
    assert read_capture(capture)[0].hand_lacks == lacks


def test_rows_that_are_written_again_and_again(capture):
    lines = (capture / "contacts.csv").read_text().splitlines()
    (capture / "contacts.csv").write_text("\n".join([*lines, *[lines[1]] * 200, ""]))
    expected = "expected contacts that were each felt once, got 200 of 203 rows repeated"
    assert said(capture) == [f"{capture / 'contacts.csv'}, frame 0: {expected}"]


def test_a_sigma_of_another_unit():
    model = make("box")
    points = np.array([[0.0, 0.0, 0.5], [0.03, 0.0, 0.5], [0.0, 0.04, 0.52]])
    frame = Frame(0, contacts=Contacts(points, sigma_point=[1.0, 1.0, 0.001]))
    expected = f"got a sigma_point of 1 m and an object of {model.diameter:.4g} m: mm read as m?"
    assert expected in (scale_problem(frame, model) or "")
    with pytest.raises(CaptureError, match="a sigma_point of 1 m"):
        check_usable(frame, model)
    assert scale_problem(Frame(0, contacts=Contacts(points, sigma_point=[1.0, 0.001, 0.001])), model) is None
    assert scale_problem(Frame(0, contacts=Contacts(points)), model) is None


def test_a_start_behind_the_camera():
    frame = replace(some_frame(0), camera_from_object_truth=None)
    behind = frame.prior.copy()
    behind[2, 3] = -3.0
    told = scale_problem(replace(frame, prior=behind), make("box"))
    assert told.startswith("expected a prior of an object before the camera, got one ")
    assert told.endswith(" m behind it: is it inverted, or of a camera that looks along -z?")
    assert "behind" not in (scale_problem(replace(frame, prior=behind, camera=None, depth=None, rgb=None, mask=None),
                                          make("box")) or "")  # fmt: skip


def test_a_number_that_is_none_is_named_by_its_place():
    pose = np.eye(4).ravel().tolist()
    pose[7] = float("nan")
    with pytest.raises(InputError, match="prior: expected 16 finite numbers, got nan as number 8 of them"):
        bop.prior_entry(pose)
    with pytest.raises(InputError, match="prior: expected 16 finite numbers, got 15: "):
        bop.prior_entry(pose[:-1])


@pytest.mark.parametrize(
    ("stamps", "message"),
    [
        ([1, 2, 3], r"expected nanoseconds by frame number, got \[1, 2, 3\]"),
        ({"0": 10, "1": 20}, "expected one of each of 3 frames, got 2, none of frame 2"),
        ({"0": 10, "1": "soon", "2": 30}, "expected whole nanoseconds, got 'soon' of frame 1"),
        ({"0": 10, "1": True, "2": 30}, "expected whole nanoseconds, got 'True' of frame 1"),
        ({"0": 10, "1": 30, "2": 20}, "expected times that run forwards, got frame 2 before frame 1"),
    ],
)
def test_times_that_are_none(tmp_path, stamps, message):
    with pytest.raises(InputError, match=f"stamps_ns: {message}"):
        frame_stamps({"stamps_ns": stamps}, (0, 1, 2))
    folder = write_capture(tmp_path / "c", [some_frame(i) for i in range(3)], make("box"))
    assert said(folder) == []
    (line,) = edited(folder, "capture.json", lambda content: content.update(notes={"stamps_ns": stamps}))
    assert line.startswith(f"{folder / 'capture.json'}: stamps_ns: expected ")


def test_times_that_are_some():
    assert frame_stamps({}, (0, 1)) is None
    assert frame_stamps({"stamps_ns": {"3": 5, "4": 5}}, (3, 4)) == {3: 5, 4: 5}
    # a recording that frames were taken out of
    assert frame_stamps({"stamps_ns": {"2": 1, "3": 5, "4": 5}}, (3, 4)) == {3: 5, 4: 5}


def test_a_missing_model_is_named_once(capture):
    (model,) = (capture / "models").glob("*.ply")
    model.unlink()
    (line,) = said(capture)
    assert line.count(str(model)) == 1


def test_pressures_of_what_is_no_array(capture, hand):
    """Such a frame is left out of an estimate."""
    _, array, third = list(hand.sensors)[:3]
    shutil.copytree(capture / "tactile" / array, capture / "tactile" / third)
    (told,) = said(capture)
    assert told.endswith(
        f"{third}/000000.csv, frame 0: expected an array of the hand ({array}), got {third}, of kind point"
    )
    content = json.loads((capture / "capture.json").read_text())
    content["hand"] = None
    (capture / "capture.json").write_text(json.dumps(content))
    (capture / "wrenches.csv").unlink()
    assert any("expected a hand with this array, found no hand" in line for line in said(capture))


def test_names_that_nobody_reads(capture):
    """A file, a column or a key that is written like one that is missing was meant to be that."""
    (capture / "contacts.csv").rename(capture / "contact.csv")
    (capture / "rgb/000000.png").rename(capture / "rgb/000000.PNG")
    shutil.copy(next((capture / "mask_visib").iterdir()), capture / "mask_visib/000009_000000.png")
    table = (capture / "contact.csv").read_text()
    shutil.copytree(capture / "clouds", capture / "Clouds")
    shutil.rmtree(capture / "clouds")
    (capture / "notes.txt").write_text("where and when")
    (capture / "depth/.hidden").write_text("")
    told = edited(capture, "capture.json", lambda content: content.update(belief={}, hands=content.pop("hand")))
    for expected in (
        "contact.csv: expected contacts.csv, got contact.csv: it is not read",
        "Clouds: expected clouds, got Clouds: it is not read",
        "rgb/000000.PNG: expected a name like 000000.png, got 000000.PNG: it is not read",
        "mask_visib/000009_000000.png, frame 9: expected a frame of the capture, which has none of this number",
        "capture.json: expected 'beliefs', got 'belief'",
        "capture.json: expected 'hand', got 'hands'",
    ):
        assert any(line.endswith(expected) for line in told), (expected, told)
    assert not any("notes.txt" in line or "hidden" in line for line in told)
    (capture / "contact.csv").unlink()
    (capture / "contacts.csv").write_text(table.replace(",nx,", ",n_x,").replace(",sigma_point,", ",sigma_pt,"))
    told = edited(
        capture, "capture.json", lambda content: content["object"].update(units=content["object"].pop("unit"))
    )
    for expected in ("the column nx, got n_x", "the column sigma_point, got sigma_pt", "object: expected 'unit', got"):
        assert any(expected in line for line in told), (expected, told)


def test_what_others_write_beside_a_capture_is_no_misnamed_part(capture):
    (capture / "scene_gt.json").unlink(missing_ok=True)
    for name in ("poses.csv", "result.json", "scene_gt_info.json"):
        (capture / name).write_text("")
    assert not any("it is not read" in line for line in said(capture))


def test_a_column_that_is_there_twice(capture):
    lines = (capture / "contacts.csv").read_text().splitlines()
    twice = [lines[0] + ",x", *(line + ",1.0" for line in lines[1:])]
    (capture / "contacts.csv").write_text("\n".join(twice))
    assert any("contacts.csv: expected each column once, got x 2 times" in line for line in said(capture))


def test_a_wrench_that_is_written_twice_is_said(tmp_path, hand):
    wrench = Wrench(next(iter(hand.sensors)), np.ones(3), np.zeros(3))
    folder = write_capture(tmp_path / "w", [replace(some_frame(0, hand), wrenches=(wrench,))], make("box"), hand=hand)
    assert said(folder) == []
    path = folder / "wrenches.csv"
    path.write_text(path.read_text() + path.read_text().splitlines()[1] + "\n")
    (problem,) = said(folder)
    assert f"wrenches.csv, frame 0: expected each sensor once, got {wrench.sensor} 2 times" in problem


@pytest.mark.parametrize("value", [float("nan"), np.eye(2), {"a": {1, 2}}])
def test_notes_are_what_json_can_hold(tmp_path, value):
    with pytest.raises(InputError, match="notes: mine: expected what JSON can hold, got") as error:
        write_capture(tmp_path / "n", [some_frame(0)], make("box"), notes={"mine": value})
    assert "\n" not in str(error.value)
    assert not (tmp_path / "n").exists()
