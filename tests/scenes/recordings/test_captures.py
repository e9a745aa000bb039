"""Captures: what is written reads back, and whatever is broken is named with its file, frame and column."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from made_frames import hand_with_array, some_frame

from scenes.errors import CaptureError, InputError, PalpateError
from scenes.files.formats.images import read_mask
from scenes.files.formats.ply import read_cloud, write_ply
from scenes.recordings.captures import read_capture, write_capture
from scenes.recordings.checking.validation import validate
from scenes.recordings.frames import Contacts, Frame
from scenes.synthesis.library import make


def same(a, b) -> None:
    assert (a is None) == (b is None)
    if a is not None:
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12)


@pytest.mark.parametrize("world", ["camera", "robot base"])
@pytest.mark.parametrize("with_hand", [False, True])
@pytest.mark.parametrize("unit", ["m", "mm"])
def test_round_trip(tmp_path, world, with_hand, unit):
    hand = hand_with_array() if with_hand else None
    frames = [some_frame(i, hand, world) for i in (0, 7)]
    model = make("cylinder")
    write_capture(tmp_path / "c", frames, model, hand, world, depth_scale=0.1, model_unit=unit, notes={"seed": 3})
    capture = read_capture(tmp_path / "c")
    assert (len(capture), capture.frame_ids, capture.world) == (2, (0, 7), world)
    assert capture.manifest.notes == {"seed": 3}
    np.testing.assert_allclose(capture.model.vertices[capture.model.faces], model.vertices[model.faces], atol=1e-12)
    assert capture.model.name == "cylinder"
    assert len(capture.model.symmetries.discrete) == len(model.symmetries.discrete)
    np.testing.assert_allclose(capture.model.symmetries.axes[0].direction, [0, 0, 1], atol=1e-12)
    for wrote, read in zip(frames, capture, strict=True):
        assert read.index == wrote.index
        assert read.camera == wrote.camera
        same(read.camera_from_world, wrote.camera_from_world)
        assert np.abs(read.depth - wrote.depth).max() <= 0.051e-3
        assert read.depth.dtype == np.float32
        assert np.array_equal(read.depth == 0, wrote.depth == 0)
        assert np.array_equal(read.rgb, wrote.rgb)
        assert np.array_equal(read.mask, wrote.mask)
        assert np.array_equal(read.cloud, wrote.cloud)
        assert np.array_equal(read.cloud_colours, wrote.cloud_colours)
        assert read.joints == wrote.joints
        same(read.world_from_hand, wrote.world_from_hand)
        same(read.camera_from_object_truth, wrote.camera_from_object_truth)
        same(read.prior, wrote.prior)
        for name in ("points", "normals", "sigma_point", "sigma_normal", "forces"):
            same(getattr(read.contacts, name), getattr(wrote.contacts, name))
        assert read.contacts.sensors == wrote.contacts.sensors
        assert read.contacts.sigma_known
        same(read.no_contact.points, wrote.no_contact.points)
        assert [w.sensor for w in read.wrenches] == [w.sensor for w in wrote.wrenches]
        for a, b in zip(read.wrenches, wrote.wrenches):
            same(np.concatenate([a.force, a.torque]), np.concatenate([b.force, b.torque]))
        for name, pressure in wrote.tactile.items():
            same(read.tactile[name], pressure)
    assert [p for p in validate(tmp_path / "c") if "its limits" not in p.message] == []


def test_only_touch_is_a_capture(tmp_path):
    contacts = Contacts(np.eye(3) * 0.03)
    write_capture(tmp_path / "c", [Frame(index=4, contacts=contacts)], make("box"))
    capture = read_capture(tmp_path / "c")
    assert capture.frame_ids == (4,)
    frame = capture[0]
    assert frame.camera is None
    assert frame.depth is None
    assert not frame.contacts.sigma_known
    assert not frame.contacts.has_normal.any()
    assert validate(tmp_path / "c") == []


def test_writing_replaces_a_capture_and_nothing_else(tmp_path):
    folder = tmp_path / "c"
    write_capture(folder, [some_frame(0), some_frame(1)], make("box"))
    write_capture(folder, [some_frame(5)], make("mug"))
    assert read_capture(folder).frame_ids == (5,)
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.tex").write_text("years of work")
    with pytest.raises(CaptureError, match="holds other files"):
        write_capture(other, [some_frame(0)], make("box"))
    assert (other / "thesis.tex").read_text() == "years of work"
    with pytest.raises(InputError, match="at least one frame"):
        write_capture(folder, [], make("box"))
    assert read_capture(folder).frame_ids == (5,)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["c", "other"], "no partial folder stays behind"


@pytest.mark.parametrize(
    "foreign",
    ["thesis.tex", "depth/notes.txt", "models/mug.blend", "hand/hand.xacro", "photos/000000.png", "rgb/a.png"],
)
def test_files_of_ones_own_in_a_capture_are_not_lost(tmp_path, foreign):
    folder = tmp_path / "c"
    write_capture(folder, [some_frame(0)], make("box"), hand=hand_with_array())
    for name in ("poses.csv", "result.json", "result.jsonl", "times.jsonl", "report.html", "scene_gt_info.json"):
        (folder / name).write_text("results")
    (folder / "depth/.DS_Store").write_text("where icons are")
    (folder / foreign).parent.mkdir(exist_ok=True)
    (folder / foreign).write_text("years of work")
    before = sorted(folder.rglob("*"))
    with pytest.raises(CaptureError, match=rf"holds other files: {foreign}$"):
        write_capture(folder, [some_frame(5)], make("mug"))
    assert sorted(folder.rglob("*")) == before
    assert (folder / foreign).read_text() == "years of work"
    (folder / foreign).unlink()
    write_capture(folder, [some_frame(5)], make("mug"))
    assert not (folder / "poses.csv").exists()


def test_a_linked_folder_in_a_capture_is_not_lost(tmp_path):
    folder = tmp_path / "c"
    write_capture(folder, [some_frame(0)], make("box"))
    (tmp_path / "elsewhere").mkdir()
    (folder / "data").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(CaptureError, match=r"holds other files: data$"):
        write_capture(folder, [some_frame(0)], make("box"))
    assert (folder / "data").is_symlink()


def test_depth_out_of_range_is_refused_not_wrapped(tmp_path):
    far = replace(some_frame(0), depth=np.full((48, 64), 7.0, dtype=np.float32))
    with pytest.raises(CaptureError, match=r"up to 6\.55 m"):
        write_capture(tmp_path / "c", [far], make("box"), depth_scale=0.1)
    write_capture(tmp_path / "c", [far], make("box"), depth_scale=1.0)
    assert read_capture(tmp_path / "c")[0].depth[0, 0] == np.float32(7.0)


@pytest.mark.parametrize("scale", [-1, 0, float("nan"), "1", True, 1e4, {0: -1.0}])
def test_scales_and_worlds_that_reading_would_refuse_are_not_written(tmp_path, scale):
    with pytest.raises(InputError, match=r"depth_scale: expected millimetres per count from 0\.0001 to 1000, got"):
        write_capture(tmp_path / "c", [some_frame(0)], make("box"), depth_scale=scale)
    with pytest.raises(InputError, match="world: expected one of camera, robot base, got 'robot'"):
        write_capture(tmp_path / "c", [some_frame(0)], make("box"), world="robot")
    assert not (tmp_path / "c").exists()


def test_what_cannot_be_written_names_the_folder_asked_for(tmp_path):
    with pytest.raises(InputError, match=rf"^{tmp_path / 'c'}: expected frame numbers .* got 0 again$"):
        write_capture(tmp_path / "c", [some_frame(0), some_frame(0)], make("box"))
    far = replace(some_frame(0), depth=np.full((48, 64), 7.0, dtype=np.float32))
    with pytest.raises(CaptureError, match=rf"^{tmp_path / 'c/depth/000000.png'}: expected depths up to"):
        write_capture(tmp_path / "c", [far], make("box"), depth_scale=0.1)


def edit(path: Path, change) -> None:
    content = json.loads(path.read_text())
    content = change(content) or content
    path.write_text(json.dumps(content))


def edit_text(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def set_cell(path: Path, line: int, column: str, value: str) -> None:
    rows = [row.split(",") for row in path.read_text().splitlines()]
    rows[line - 1][rows[0].index(column)] = value
    path.write_text("\n".join(",".join(row) for row in rows) + "\n")


def put(key, value):
    return lambda content: content.__setitem__(key, value)


DAMAGES = {
    "no capture.json": (lambda c: (c / "capture.json").unlink(), "found no capture.json"),
    "capture.json is not JSON": (lambda c: (c / "capture.json").write_text("{"), "capture.json: expected JSON"),
    "other format": (lambda c: edit(c / "capture.json", put("format", "bop")), 'expected "format"'),
    "other version": (lambda c: edit(c / "capture.json", put("version", 9)), "expected version 1, got 9"),
    "unknown world": (lambda c: edit(c / "capture.json", put("world", "moon")), "a world of camera or robot base"),
    "unknown unit": (lambda c: edit_text(c / "capture.json", '"m"', '"furlong"'), "a unit of m, cm, mm, inch"),
    "no model": (lambda c: shutil.rmtree(c / "models"), "expected the object's mesh"),
    "model of no triangles": (
        lambda c: write_ply(c / "models/obj_000001.ply", np.eye(3), np.zeros((0, 3))),
        "obj_000001.ply",
    ),
    "model in millimetres": (lambda c: edit_text(c / "capture.json", '"m"', '"mm"'), "is the unit right?"),
    "no hand": (lambda c: (c / "hand/hand.urdf").unlink(), "expected a hand URDF"),
    "hand is no URDF": (lambda c: (c / "hand/hand.urdf").write_text("<robot"), "hand.urdf"),
    "camera without K": (
        lambda c: edit(c / "scene_camera.json", lambda d: d["0"].pop("cam_K") and None),
        "scene_camera.json, frame 0: expected an object with cam_K",
    ),
    "a frame beyond counting": (
        lambda c: edit(c / "scene_camera.json", lambda d: d.update({"9" * 25: d["0"]})),
        "expected frame numbers below 2",
    ),
    "short K": (lambda c: edit(c / "scene_camera.json", lambda d: put("cam_K", [1, 2])(d["0"])), "cam_K: expected 9"),
    "negative focal length": (
        lambda c: edit(c / "scene_camera.json", lambda d: put("cam_K", [-1, 0, 0, 0, 1, 0, 0, 0, 1])(d["0"])),
        "focal lengths above 0",
    ),
    "camera of images of another size": (
        lambda c: edit(c / "scene_camera.json", lambda d: d["0"].update(width=640, height=480)),
        "scene_camera.json, frame 0: width, height: expected the image's 64x48 pixels, got 640x480",
    ),
    "depth_scale zero": (
        lambda c: edit(c / "scene_camera.json", lambda d: put("depth_scale", 0)(d["0"])),
        "depth_scale: expected millimetres per count from 0.0001 to 1000, got 0",
    ),
    "camera missing": (
        lambda c: edit(c / "scene_camera.json", lambda d: d.pop("1") and None),
        "scene_camera.json, frame 1: expected a camera",
    ),
    "camera moved in the camera's world": (
        lambda c: edit(
            c / "scene_camera.json",
            lambda d: d["0"].update(cam_R_w2c=np.eye(3).ravel().tolist(), cam_t_w2c=[0, 0, 100]),
        ),
        'when the world is "camera"',
    ),
    "depth missing": (lambda c: (c / "depth/000001.png").unlink(), "000001.png, frame 1: expected a depth image"),
    "depth of 8 bit": (
        lambda c: cv2.imwrite(str(c / "depth/000000.png"), np.ones((48, 64), np.uint8)),
        "000000.png, frame 0: expected a depth image of 16 bit, 1 channel, got 8 bit, 1 channel",
    ),
    "depth of 3 channels": (
        lambda c: cv2.imwrite(str(c / "depth/000000.png"), np.ones((48, 64, 3), np.uint16)),
        "got 16 bit, 3 channels",
    ),
    "depth truncated": (lambda c: (c / "depth/000000.png").write_bytes(b"\x89PNG"), "expected a PNG image"),
    "depth empty file": (lambda c: (c / "depth/000000.png").write_bytes(b""), "expected a PNG image, got 0 bytes"),
    "mask of another size": (
        lambda c: cv2.imwrite(str(c / "mask_visib/000001_000000.png"), np.ones((10, 10), np.uint8)),
        "expected 64x48 pixels like depth, got 10x10",
    ),
    "cloud is no PLY": (lambda c: (c / "clouds/000000.ply").write_text("hello"), "clouds/000000.ply"),
    "cloud of NaN": (
        lambda c: write_ply(c / "clouds/000000.ply", np.full((9, 3), np.nan)),
        "expected a point cloud, got 9 points, none of them finite",
    ),
    "truth sheared": (
        lambda c: edit(c / "scene_gt.json", lambda d: put("cam_R_m2c", [2, 0, 0, 0, 1, 0, 0, 0, 1])(d["1"][0])),
        "scene_gt.json, frame 1: cam_R_m2c: expected a rotation matrix",
    ),
    "prior of another frame": (
        lambda c: edit(c / "prior.json", put("12", [])),
        "prior.json, frame 12: expected a frame",
    ),
    "prior with NaN": (
        lambda c: edit_text(c / "prior.json", '"0":', '"0": [[NaN,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]], "x":'),
        "prior.json",
    ),
    "NaN contact": (
        lambda c: set_cell(c / "contacts.csv", 3, "y", "nan"),
        "contacts.csv, frame 0: line 3, column y: expected a finite number, got nan",
    ),
    "contact without x": (
        lambda c: set_cell(c / "contacts.csv", 2, "x", ""),
        "column x: expected a number, got nothing",
    ),
    "contact of letters": (lambda c: set_cell(c / "contacts.csv", 5, "z", "high"), "expected a number, got 'high'"),
    "contact of no frame": (lambda c: set_cell(c / "contacts.csv", 2, "frame", "99"), "contacts.csv, frame 99"),
    "contact of half a frame": (lambda c: set_cell(c / "contacts.csv", 2, "frame", "0.5"), "expected a whole number"),
    "half a normal": (lambda c: set_cell(c / "contacts.csv", 2, "ny", ""), "expected all of nx, ny, nz or none"),
    "sigma of zero": (lambda c: set_cell(c / "contacts.csv", 2, "sigma_point", "0"), "column sigma_point: expected"),
    "no column": (
        lambda c: edit_text(c / "contacts.csv", "frame,sensor,x", "frame,sensor,X"),
        "contacts.csv: expected the column x, got frame,sensor,X",
    ),
    "row too short": (lambda c: (c / "contacts.csv").open("a").write("0,a,1\n"), "expected 13 cells, got 3"),
    "contacts empty": (lambda c: (c / "contacts.csv").write_text(""), "contacts.csv: expected the header"),
    "contacts in bytes": (lambda c: (c / "contacts.csv").write_bytes(b"\xff\xfe\x00"), "expected UTF-8 text"),
    "joints of another hand": (
        lambda c: set_cell(c / "joints.csv", 2, "joint", "shadow_FFJ3"),
        "shadow_FFJ3",
    ),
    "joint twice": (
        lambda c: set_cell(c / "joints.csv", 3, "joint", (c / "joints.csv").read_text().splitlines()[1].split(",")[1]),
        "expected each joint once",
    ),
    "joint NaN": (lambda c: set_cell(c / "joints.csv", 2, "position", "nan"), "column position: expected a finite"),
    "sensors that are a list": (
        lambda c: edit(c / "capture.json", lambda d: put("sensors", ["a"])(d["hand"])),
        "expected the path of a file as the hand's sensors",
    ),
    "model that is half a letter": (
        lambda c: edit(c / "capture.json", lambda d: put("model", "\ud800")(d["object"])),
        "expected the name of a file",
    ),
    "frame of a googol": (
        lambda c: set_cell(c / "joints.csv", 2, "frame", "1e100"),
        "column frame: expected a whole number from 0 to",
    ),
    "hand pose scaled": (lambda c: set_cell(c / "hand_poses.csv", 2, "m00", "7"), "expected a rotation matrix"),
    "radius negative": (lambda c: set_cell(c / "no_contact.csv", 2, "radius", "-1"), "column radius: expected"),
    "wrench of no sensor": (lambda c: set_cell(c / "wrenches.csv", 2, "sensor", "nose"), "got 'nose'"),
    "tactile of no sensor": (
        lambda c: shutil.copytree(next((c / "tactile").iterdir()), c / "tactile/nose"),
        "got 'nose'",
    ),
    "taxel of half": (
        lambda c: set_cell(next((c / "tactile").glob("*/000000.csv")), 2, "taxel", "0.5"),
        "column taxel: expected a whole number",
    ),
    "taxel twice": (
        lambda c: set_cell(next((c / "tactile").glob("*/000000.csv")), 3, "taxel", "0"),
        "000000.csv, frame 0: line 3: expected each taxel once, got 0 twice",
    ),
    "a frame of 5000 digits": (
        lambda c: edit_text(c / "prior.json", '"0":', f'"{"1" * 5000}": [], "0":'),
        "prior.json: expected frame numbers as keys, got '1111",
    ),
    "symmetry of nothing": (
        lambda c: edit(c / "models/models_info.json", lambda d: put("symmetries_discrete", [[1, 2]])(d["1"])),
        "symmetries_discrete: expected 16",
    ),
    "symmetries that are one number": (
        lambda c: edit(c / "models/models_info.json", lambda d: put("symmetries_continuous", 7)(d["1"])),
        "symmetries_continuous: expected a list",
    ),
}


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Path:
    hand = hand_with_array()
    frames = [some_frame(i, hand) for i in (0, 1)]
    return write_capture(tmp_path_factory.mktemp("sound") / "c", frames, make("box"), hand)


def read_everything(folder: Path) -> None:
    capture = read_capture(folder)
    assert capture.model
    assert len(list(capture)) == 2


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_named(tmp_path, sound, name):
    damage, message = DAMAGES[name]
    folder = tmp_path / "c"
    shutil.copytree(sound, folder)
    damage(folder)
    with pytest.raises(PalpateError) as caught:
        read_everything(folder)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    problems = validate(folder)
    assert any(message in str(problem) for problem in problems), problems
    assert all("\n" not in str(problem) for problem in problems)


def test_validation_finds_every_problem(tmp_path, sound):
    folder = tmp_path / "c"
    shutil.copytree(sound, folder)
    chosen = ("depth missing", "NaN contact", "joints of another hand", "truth sheared", "no model", "depth of 8 bit")
    for name in chosen:
        DAMAGES[name][0](folder)
    problems = validate(folder)
    for name in chosen:
        assert sum(DAMAGES[name][1] in str(problem) for problem in problems) == 1, (name, problems)


def test_depth_scales_by_frame_are_complete(tmp_path):
    frames = [some_frame(0), some_frame(1)]
    write_capture(tmp_path / "c", frames, make("box"), depth_scale={0: 0.1, 1: 0.25})
    cameras = json.loads((tmp_path / "c" / "scene_camera.json").read_text())
    assert [cameras[key]["depth_scale"] for key in ("0", "1")] == [0.1, 0.25]
    with pytest.raises(InputError, match="frame 1: expected a depth_scale of every frame"):
        write_capture(tmp_path / "d", frames, make("box"), depth_scale={0: 0.1})
    assert not (tmp_path / "d").exists()


def test_cloud_files(tmp_path):
    points = np.random.default_rng(0).normal(size=(20, 3))
    points[3] = np.nan
    write_ply(tmp_path / "a.ply", points)
    read, colours = read_cloud(tmp_path / "a.ply")
    assert np.array_equal(read, np.delete(points, 3, axis=0))
    assert colours is None


@pytest.mark.parametrize("colour", [(0, 0, 255), (0, 1, 0), (255, 0, 0), (9, 9, 9, 0)])
def test_a_mask_is_whatever_is_not_black(tmp_path, colour):
    image = np.zeros((4, 5, len(colour)), np.uint8)
    if len(colour) == 4:
        image[..., 3] = 255  # black and opaque is black
    image[1:3, 2:4] = colour
    cv2.imwrite(str(tmp_path / "mask.png"), image)
    expected = np.zeros((4, 5), bool)
    expected[1:3, 2:4] = True
    assert np.array_equal(read_mask(tmp_path / "mask.png"), expected)


def test_another_objects_mask_is_not_this_ones(tmp_path, sound):
    """A frame whose ground truths leave the object out has no mask; one without ground truths has that of row 0."""
    folder = tmp_path / "c"
    shutil.copytree(sound, folder)
    assert read_capture(folder).frame(1).mask is not None
    edit(folder / "scene_gt.json", lambda d: put("obj_id", 77)(d["1"][0]))
    assert read_capture(folder).frame(1).mask is None
    assert read_capture(folder).frame(0).mask is not None
    edit(folder / "scene_gt.json", lambda d: d.pop("1") and None)
    assert read_capture(folder).frame(1).mask is not None


def test_how_contacts_face_is_kept_where_nobody_told_how_well_they_are_placed(tmp_path):
    """The angle alone was told of the first, nothing of the second."""
    felt = Contacts(np.eye(3)[:2] * 0.01, np.eye(3)[:2], sigma_normal=[0.3, np.nan])
    frame = replace(some_frame(0, None, "camera"), contacts=felt, no_contact=None)
    read = read_capture(write_capture(tmp_path / "c", [frame], make("box"))).frame(0).contacts
    same(read.sigma_normal, felt.sigma_normal)
    assert not read.sigma_told.any()
