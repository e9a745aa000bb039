"""Beliefs are data: told by a capture, over it by a file, over that by flags; checked, kept, and written again."""

from __future__ import annotations

import json
from dataclasses import asdict, fields, replace

import numpy as np
import pytest
from made_frames import plain_view

from scenes.errors import CaptureError, InputError
from scenes.files.schema import schema
from scenes.recordings import beliefs as module
from scenes.recordings.beliefs import Beliefs, CalibrationModel, DepthModel, ImageModel, TouchModel
from scenes.recordings.captures import read_capture, write_capture
from scenes.recordings.checking.validation import validate
from scenes.recordings.depth_cameras import DEPTH_CAMERAS
from scenes.recordings.frames import Frame
from scenes.recordings.telling import beliefs_json, believed, of_joints
from scenes.synthesis.library import make
from vision.sight import Sight

OTHERS = Beliefs(
    DepthModel(bias_sigma=0.001), CalibrationModel(0.003, 0.01), TouchModel(0.005, 0.001), mesh_sigma=0.0007
)
NAMED = Beliefs(depth=DEPTH_CAMERAS["d435"])


def told(folder, beliefs):
    """capture.json with other beliefs, written by hand."""
    path = folder / "capture.json"
    content = json.loads(path.read_text())
    content["beliefs"] = beliefs
    path.write_text(json.dumps(content))
    return folder


@pytest.fixture
def capture(tmp_path):
    return write_capture(tmp_path / "c", [plain_view()], make("box"))


@pytest.mark.parametrize("beliefs", [OTHERS, NAMED, Beliefs(), None])
def test_a_capture_keeps_them(tmp_path, beliefs):
    frames = [replace(plain_view(seed=i), index=i, beliefs=beliefs) for i in range(2)]
    folder = write_capture(tmp_path / "c", frames, make("box"))
    read = read_capture(folder)
    assert read.beliefs == beliefs
    assert all(frame.beliefs == beliefs for frame in read)
    assert validate(folder) == []
    assert ("beliefs" in json.loads((folder / "capture.json").read_text())) == (beliefs is not None)


def test_what_is_not_said_is_the_library_s(capture):
    said = read_capture(told(capture, {"camera": "l515", "depth": {"scale_sigma": 0.01}, "mesh_sigma": 0.001})).beliefs
    assert said.depth == replace(DEPTH_CAMERAS["l515"], scale_sigma=0.01)
    assert (said.mesh_sigma, said.calibration, said.touch) == (0.001, CalibrationModel(), TouchModel())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"camera": "d434"}, r"capture.json: beliefs: camera: expected one of .*did you mean d435\?"),
        ({"camera": 3}, "got 3"),
        ([1], "expected a table of beliefs"),
        ({"mesh_sigmas": 0.001}, "did you mean mesh_sigma"),
        ({"mesh_sigma": 0.4}, r"mesh_sigma: expected a number above 0 and up to 0\.05, got 0\.4"),
        ({"mesh_sigma": "thick"}, "mesh_sigma: expected a number, got 'thick'"),
        ({"depth": {"bias_sigma": 0}}, "depth: bias_sigma: expected a number above 0"),
        ({"depth": {"axial_growth": -1}}, "axial_growth: expected a number from 0"),
        ({"depth": 3}, "depth: expected a table"),
        ({"calibration": {"rotation_sigma": 3.0}}, "rotation_sigma: expected a number above 0 and up to 0.8"),
        ({"touch": {"fingertip": 1}}, "did you mean fingertip_sigma"),
    ],
)
def test_what_is_no_belief_is_one_line(capture, content, message):
    folder = told(capture, content)
    with pytest.raises(CaptureError, match=message) as error:
        read_capture(folder)
    assert "\n" not in str(error.value)
    assert len(validate(folder)) == 1


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_no_size_is_refused_in_python_too(value):
    for kind in (DepthModel, CalibrationModel, TouchModel, Beliefs):
        for one in fields(kind):
            if isinstance(one.default, float):
                with pytest.raises(InputError, match=f"{one.name}: expected a number"):
                    kind(**{one.name: value})
    with pytest.raises(InputError, match="beliefs: expected"):
        Frame(0, beliefs={"mesh_sigma": 0.001})  # type: ignore[arg-type]


def test_a_capture_has_one_camera(tmp_path):
    frames = [replace(plain_view(), beliefs=None), replace(plain_view(), index=1, beliefs=NAMED)]
    with pytest.raises(InputError, match="expected frames of the same beliefs, got others in 1"):
        write_capture(tmp_path / "c", frames, make("box"))


def test_the_later_table_is_laid_over_the_earlier():
    tables = [
        ("capture", {"camera": "d455", "mesh_sigma": 0.001, "depth": {"scale_sigma": 0.01}}),
        ("flag", {"camera": "d435"}),
        ("flag", of_joints(np.deg2rad(0.6))),
    ]
    made = believed(OTHERS, tables)
    assert made.depth == DEPTH_CAMERAS["d435"]  # another camera: nothing of the first is left
    assert made.mesh_sigma == 0.001
    assert made.calibration == OTHERS.calibration
    assert made.touch.fingertip_sigma == pytest.approx(0.15 * np.deg2rad(0.6))
    assert believed(None, [("", beliefs_json(made))]) == made


KINDS = (("depth", DepthModel), ("calibration", CalibrationModel), ("touch", TouchModel), ("image", ImageModel))


def test_the_schema_and_the_classes_are_one():
    table = schema("capture")["properties"]["beliefs"]["properties"]
    assert table["camera"]["enum"] == list(DEPTH_CAMERAS)
    for name, kind in KINDS:
        assert set(table[name]["properties"]) == {one.name for one in fields(kind)}
    assert schema("topics")["properties"]["beliefs"] == schema("capture")["properties"]["beliefs"]
    sizes = [value for _, kind in KINDS for value in asdict(kind())]
    assert set(module.LARGEST) == {*sizes, "mesh_sigma"}


def test_noise_grows_as_the_makers_say():
    """Standard deviation (mm) at arm's length and beyond: data sheets and measurements named in depth_cameras."""
    at = np.array([0.6, 1.0, 2.0])
    noise = {name: 1e3 * model.independent_sigma(at) for name, model in DEPTH_CAMERAS.items()}
    assert noise["l515"][1] == pytest.approx(2.5, abs=0.1)
    assert 1e3 * DEPTH_CAMERAS["l515"].independent_sigma(np.array([9.0]))[0] == pytest.approx(15.5, abs=0.5)
    assert noise["azure-kinect"][1] == pytest.approx(1.0, abs=0.2)
    # of one focal length and matcher, noise goes with one over the baseline (50 and 95 mm)
    growth = DEPTH_CAMERAS["d435"].axial_growth / DEPTH_CAMERAS["d455"].axial_growth
    assert growth == pytest.approx(95 / 50, rel=0.01)
    assert DEPTH_CAMERAS["kinect-v1"] == DepthModel()
    for values in noise.values():
        assert (np.diff(values) > 0).all()


def test_the_form_of_the_noise_reaches_the_compiled_look_up():
    """A noise told as growing from 0 m and the same number told as constant cost the same at one depth."""
    frame, box = plain_view(), make("box")
    pose = frame.camera_from_object_truth
    away = pose.copy()
    away[2, 3] -= 0.03  # nearer: the camera sees past it, but for noise
    depth = float(pose[2, 3])
    grown = DepthModel(axial_floor=0.001, axial_from=0.0, axial_growth=0.2)
    constant = DepthModel(axial_floor=0.001 + 0.2 * depth**2, axial_growth=0.0)
    costs = [Sight(frame, box, model).costs(np.array([pose, away])) for model in (grown, constant, DepthModel())]
    np.testing.assert_allclose(costs[0], costs[1], atol=2.0)
    assert costs[2][1] > costs[0][1] + 20.0
