"""Folders of images, YCBInEOAT sequences, tacman's contact sets, lists of contacts: each becomes a capture."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from commands import refused, run
from image_folders import SIZE, K, images, sequence

from scenes.files.formats.off import write_off
from scenes.recordings.captures import read_capture
from scenes.synthesis.library import make


@pytest.mark.parametrize("masks", [None, "gt_mask", "masks"])
@pytest.mark.parametrize("named", [True, False])
def test_ycbineoat(tmp_path, masks, named):
    names = ["1581120424100262102", "1581120424148532296", "1581120424194796323"]
    counts, truths = sequence(tmp_path / "s", names, named, masks)
    assert run("convert", tmp_path / "s", tmp_path / "c", "--object", "box") == 0
    capture = read_capture(tmp_path / "c")
    assert capture.frame_ids == (0, 1, 2)
    assert capture.manifest.notes["stamps_ns"] == {str(i): int(name) for i, name in enumerate(names)}
    for i, frame in enumerate(capture):
        assert np.array_equal(np.rint(frame.depth * 1e3), counts[i])
        assert int(frame.rgb[0, 0, 0]) == i
        assert (frame.mask is None) == (masks is None)
        assert masks is None or np.array_equal(frame.mask, counts[i] > 1500)
        np.testing.assert_allclose(frame.camera_from_object_truth, truths[i], atol=1e-12)
        np.testing.assert_allclose(frame.camera.matrix, K)
    # the times of the images are those of the trajectory
    assert run("convert", tmp_path / "c", tmp_path / "t.tum") == 0
    rows = (tmp_path / "t.tum").read_text().splitlines()
    assert rows[1].startswith("1581120424.100262102 0.0 0.1 0.6 ")


def test_a_gap_between_times_is_a_gap_in_numbers(tmp_path):
    names = [str(1581120424100262102 + milliseconds * 1_000_000) for milliseconds in (0, 48, 94, 1140)]
    sequence(tmp_path / "s", names, True)
    argv = ("convert", tmp_path / "s", tmp_path / "c", "--object", "box", "--json", tmp_path / "j.json")
    assert run(*argv) == 0
    assert read_capture(tmp_path / "c").frame_ids == (0, 1, 2, 24)
    remarks = json.loads((tmp_path / "j.json").read_text())["remarks"]
    assert remarks == ["1 gap in time: frame numbers leave out 21 periods of 48 ms"]


def test_poses_of_depth_images_that_are_not_there_are_dropped(tmp_path):
    names = [f"{i:07d}" for i in range(4)]
    _, truths = sequence(tmp_path / "s", names, True)
    (tmp_path / "s" / "depth" / "0000002.png").unlink()
    (tmp_path / "s" / "annotated_poses" / "0000003.txt").unlink()
    argv = ("convert", tmp_path / "s", tmp_path / "c", "--object", "box", "--json", tmp_path / "j.json")
    assert run(*argv) == 0
    assert json.loads((tmp_path / "j.json").read_text())["dropped"] == [
        {"what": what, "why": "no depth image of that name", "count": 1} for what in ("rgb", "poses")
    ]
    capture = read_capture(tmp_path / "c")
    for frame, truth in zip(capture, (truths[0], truths[1], None), strict=True):
        assert (frame.camera_from_object_truth is None) == (truth is None)
        assert truth is None or np.allclose(frame.camera_from_object_truth, truth, atol=1e-12)


def test_malformed_sequences(tmp_path, capsys):
    folder = tmp_path / "s"
    sequence(folder, ["000000", "000001"])
    argv = ("convert", folder, tmp_path / "c")
    assert "expected --object NAME|MESH for a YCBInEOAT sequence" in refused(capsys, *argv)
    argv += ("--object", "box")
    (folder / "annotated_poses" / "0000002.txt").write_text("1")
    assert "expected a pose for each of 2 images, got 3" in refused(capsys, *argv)
    (folder / "annotated_poses" / "0000002.txt").unlink()
    bad = np.eye(4)
    bad[0, 0] = np.nan
    np.savetxt(folder / "annotated_poses" / "0000001.txt", bad)
    assert "0000001.txt: expected 16 finite numbers" in refused(capsys, *argv)
    np.savetxt(folder / "annotated_poses" / "0000001.txt", 2 * np.eye(4))
    assert "0000001.txt: expected last row 0 0 0 1" in refused(capsys, *argv)
    (folder / "cam_K.txt").write_text("1 2 3")
    assert "cam_K.txt: expected 9 finite numbers" in refused(capsys, *argv)
    assert not (tmp_path / "c").exists()


def test_a_folder_of_images(tmp_path, capsys):
    images(tmp_path / "s")
    cv2.imwrite(str(tmp_path / "s" / "rgb" / "z.png"), np.zeros((*SIZE, 3), np.uint8))
    base = ("convert", tmp_path / "s", tmp_path / "c", "--object", "box")
    assert "expected camera.json or --intrinsics" in refused(capsys, *base)
    assert run(*base, "--intrinsics", "80,82,31.5,23.5", "--depth-scale", "0.5", "--json", tmp_path / "j.json") == 0
    said = json.loads((tmp_path / "j.json").read_text())
    assert said["dropped"] == [{"what": "rgb", "why": "no depth image of that name", "count": 1}]
    first = read_capture(tmp_path / "c")
    assert [round(float(f.depth[0, 0]) * 1e4) for f in first] == [2000, 2005, 2010]
    camera = {"fx": 80, "fy": 82, "cx": 31.5, "cy": 23.5, "depth_scale": 0.5}
    for content in (camera, {"cam_K": K.ravel().tolist(), "depth_scale": 0.5}):
        (tmp_path / "s" / "camera.json").write_text(json.dumps(content))
        assert run(*base) == 0
        again = read_capture(tmp_path / "c")
        assert (again[2].camera, again[2].depth[0, 0]) == (first[2].camera, first[2].depth[0, 0])
    capsys.readouterr()
    for content, message in (
        ({"fx": 80}, "camera.json: expected fx, fy, cx, cy or cam_K"),
        ({**camera, "fx": -1}, "focal lengths above 0"),
        ({**camera, "depth_scale": "mm"}, "depth_scale"),
        ([], "camera.json"),
    ):
        (tmp_path / "s" / "camera.json").write_text(json.dumps(content))
        assert message in refused(capsys, *base)
    assert "expected FX,FY,CX,CY in pixels, got '80,82'" in refused(capsys, *base, "--intrinsics", "80,82")
    assert "expected --intrinsics beside it" in refused(capsys, *base, "--depth-scale", "1")
    assert "expected a number above 0" in refused(capsys, *base, "--depth-scale", "0")


def test_intrinsics_keep_the_depth_scale_of_camera_json(tmp_path, capsys):
    images(tmp_path / "s")
    base = ("convert", tmp_path / "s", tmp_path / "c", "--object", "box", "--intrinsics", "80,82,31.5,23.5")
    for content, more, depth in (
        ({"depth_scale": 0.5}, (), 0.2),
        ({"fx": 9, "fy": 9, "cx": 9, "cy": 9, "depth_scale": 0.5}, (), 0.2),
        ({"fx": 9, "fy": 9, "cx": 9, "cy": 9, "depth_scale": 0.5}, ("--depth-scale", 2), 0.8),
        ({}, (), 0.4),
    ):
        (tmp_path / "s" / "camera.json").write_text(json.dumps(content))
        assert run(*base, *more) == 0
        frame = read_capture(tmp_path / "c")[0]
        assert frame.depth[0, 0] == pytest.approx(depth)
        np.testing.assert_allclose(frame.camera.matrix, K)
    capsys.readouterr()
    (tmp_path / "s" / "camera.json").write_text('{"depth_scale": -1}')
    assert "camera.json: depth_scale: expected" in refused(capsys, *base)


@pytest.mark.parametrize(
    ("told", "message"),
    [
        ({"width": 64, "height": 48}, None),
        ({"width": 640, "height": 480}, "camera.json: expected width x height 64x48 as the images of "),
        ({"width": 48, "height": 64}, "got 48x64"),
        ({"width": 64}, "camera.json: expected width and height, got width alone"),
        ({"width": 64, "height": 47.5}, "camera.json: expected width and height in whole pixels, got 64, 47.5"),
        ({"distortion": [0, 0, 0, 0, 0], "dist_coeffs": [[0.0, 0.0]], "D": None, "coeffs": []}, None),
        ({"distortion": [0.1, -0.2, 0, 0]}, "camera.json: distortion: expected images without distortion, got"),
        ({"dist_coeffs": [[0, 0, 0, 1e-3, 0]]}, "dist_coeffs: expected images without distortion, got coefficients"),
        ({"distortion": {"k1": 0.1, "k2": 0}}, "up to 0.1: undistort them, and leave the coefficients out"),
        ({"distortion": [float("nan")]}, "distortion"),
        ({"distortion": "plumb"}, "distortion: expected numbers, got plumb"),
        ({"distortion": [[1], [1, 2]]}, "distortion: expected numbers, got [[1], [1, 2]]"),
    ],
)
def test_a_camera_json_of_other_images_or_of_a_bent_lens(tmp_path, capsys, told, message):
    images(tmp_path / "s")
    (tmp_path / "s" / "camera.json").write_text(json.dumps({"fx": 80, "fy": 82, "cx": 31.5, "cy": 23.5, **told}))
    base = ("convert", tmp_path / "s", tmp_path / "c", "--object", "box")
    if message is None:
        assert run(*base) == 0
    else:
        assert message in refused(capsys, *base)
        assert not (tmp_path / "c").exists()


@pytest.mark.parametrize(
    "names",
    [
        [f"frame_{i}" for i in (1, 2, 9, 10, 11, 100)],
        ["a2b9", "a2b10", "a10b1", "b1"],
        ["1305031102.16", "1305031102.5", "1305031103.05", "1305031103.1"],
        ["2", "10", "1234567"],
    ],
)
def test_images_are_in_the_order_of_the_numbers_in_their_names(tmp_path, names):
    images(tmp_path / "s", names)
    assert run("convert", tmp_path / "s", tmp_path / "c", "--object", "box", "--intrinsics", "80,80,32,24") == 0
    capture = read_capture(tmp_path / "c")
    assert [int(frame.rgb[0, 0, 0]) for frame in capture] == list(range(len(names)))


def test_poses_in_order_are_in_the_order_of_their_numbers(tmp_path):
    _, truths = sequence(tmp_path / "s", [f"frame_{i}" for i in range(12)])
    place = tmp_path / "s" / "annotated_poses"
    for i in range(12):
        (place / f"{i:07d}.txt").rename(place / f"pose{i}.txt")
    assert run("convert", tmp_path / "s", tmp_path / "c", "--object", "box") == 0
    for frame, truth in zip(read_capture(tmp_path / "c"), truths, strict=True):
        np.testing.assert_allclose(frame.camera_from_object_truth, truth, atol=1e-12)


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("images", ("--instance 1", "--object-id 1", "--models .", "--topics a.json", "--hand h.urdf", "--frame 0")),
        ("images", ("--result poses.csv", "--fps 10")),
        ("ycbineoat", ("--intrinsics 80,80,32,24", "--object-id 0", "--frame 1")),
        ("bop", ("--intrinsics 80,80,32,24", "--depth-scale 1", "--topics a.json", "--hand h.urdf")),
        ("tum", ("--depth-scale 1", "--instance 0", "--object box", "--frame 0")),
        ("glb", ("--fps 10", "--intrinsics 80,80,32,24")),
        ("off", ("--result poses.csv", "--frame 0")),
    ],
)
def test_options_that_a_format_does_not_use_are_refused(tmp_path, capsys, kind, options):
    if kind == "ycbineoat":
        sequence(tmp_path / "s", ["0", "1"])
    elif kind == "bop":
        (tmp_path / "s").mkdir()
        (tmp_path / "s" / "scene_camera.json").write_text("{}")
    else:
        images(tmp_path / "s")
    argv = ["convert", tmp_path / "s", tmp_path / "c"]
    if kind == "images" or kind == "ycbineoat":
        argv += ["--object", "box"]
    elif kind != "bop":
        assert run(*argv, "--object", "box", "--intrinsics", "80,80,32,24") == 0
        capsys.readouterr()
        argv = ["convert", tmp_path / "c", tmp_path / "e", "--to", kind]
    for option in options:
        name, value = option.split()
        line = refused(capsys, *argv, name, value)
        assert line.startswith(f"palpate: {name}: expected a conversion ")
        assert f"converted {'to' if kind in ('tum', 'glb', 'off') else 'from'} {kind}" in line


def test_depth_scale_of_a_sequence(tmp_path):
    counts, _ = sequence(tmp_path / "s", ["0", "1"])
    argv = ("convert", tmp_path / "s", tmp_path / "c", "--object", "box", "--depth-scale", "0.25")
    assert run(*argv) == 0
    assert np.array_equal(np.rint(read_capture(tmp_path / "c")[1].depth * 4e3), counts[1])


def test_numbers_in_names_are_kept(tmp_path):
    images(tmp_path / "s", ("0007", "0012"))
    assert run("convert", tmp_path / "s", tmp_path / "c", "--object", "box", "--intrinsics", "80,80,32,24") == 0
    assert read_capture(tmp_path / "c").frame_ids == (7, 12)


def test_an_empty_folder_of_images(tmp_path, capsys):
    (tmp_path / "s" / "depth").mkdir(parents=True)
    argv = ("convert", tmp_path / "s", tmp_path / "c", "--object", "box", "--intrinsics", "80,80,32,24")
    assert "in depth/, found none" in refused(capsys, *argv)
    assert "palpate convert" in refused(capsys, "estimate", tmp_path / "s")


@pytest.fixture
def tacman(tmp_path):
    """The layout of the repositories: the programs ran two folders below the root."""
    root, model = tmp_path / "repo", make("box")
    for name in ("models", "measurements", "configurationFiles"):
        (root / name).mkdir(parents=True)
    points, normals = model.sample_surface(20, 0)
    write_off(root / "models" / "box.off", model.vertices, model.faces)
    write_off(root / "models" / "stick.off", 2 * model.vertices, model.faces)
    write_off(root / "measurements" / "measBox.off", points)
    write_off(root / "measurements" / "cloud.off", points, colours=np.full((20, 3), 9))
    write_off(root / "measurements" / "fingers.off", points[:3], normals=normals[:3])
    (root / "configurationFiles" / "box.ini").write_text(
        "modelFile           ../../models/box.off\n"
        "measurementsFile    ../../measurements/measBox.off  // contacts\n"
        "# a comment\nnumMeas             15\nR                   (0.0001, 0.0001, 0.0001)\n"
    )
    return root


def test_tacman_sets(tacman, tmp_path, capsys):
    ini, out = tacman / "configurationFiles" / "box.ini", tmp_path / "c"
    assert run("convert", ini, out, "--json", tmp_path / "j.json") == 0
    capture = read_capture(out)
    assert (len(capture[0].contacts), capture.world, capture.model.name) == (15, "robot base", "box")
    assert capture.manifest.notes["settings"]["R"] == "(0.0001, 0.0001, 0.0001)"
    assert json.loads((tmp_path / "j.json").read_text())["dropped"] == [
        {"what": "contacts", "why": "beyond numMeas 15", "count": 5}
    ]
    ini.write_text(
        "modelFile0 ../../models/box.off\nmodelFile1 ../../models/stick.off\n"
        "measurementsFile ../../measurements/cloud.off\nfingersFile ../../measurements/fingers.off\n"
    )
    capsys.readouterr()
    assert "expected one modelFile, got modelFile0, modelFile1: choose with --object-id" in refused(
        capsys, "convert", ini, tmp_path / "d"
    )
    assert run("convert", ini, tmp_path / "d", "--object-id", "1") == 0
    capture = read_capture(tmp_path / "d")
    assert (capture.model.name, len(capture[0].cloud), len(capture[0].contacts)) == ("stick", 20, 3)
    assert capture[0].contacts.has_normal.all()
    assert run("convert", ini.parent, tmp_path / "all", "--object", "box") == 0
    assert [path.name for path in (tmp_path / "all").iterdir()] == ["box"]


def test_a_cloud_that_becomes_contacts_is_warned_of(tacman, tmp_path, capsys):
    ini, points = tacman / "configurationFiles" / "box.ini", make("box").sample_surface(1140, 0)[0]
    write_off(tacman / "measurements" / "cloud.off", points)
    lines = "modelFile ../../models/box.off\nmeasurementsFile ../../measurements/cloud.off\n"
    for number, (more, says) in enumerate(
        (
            (
                "",
                "all 1140 points become contacts, more than fingers feel: is it a cloud?; a cloud needs a fingersFile",
            ),
            ("numMeas 1000\n", "all 1000 points become contacts"),
            ("fingersFile ../../measurements/cloud.off\n", "fingersFile and measurementsFile are both"),
            ("numMeas 40\n", None),
            ("fingersFile ../../measurements/fingers.off\n", None),
        )
    ):
        ini.write_text(lines + more)
        for source, out in ((ini, tmp_path / f"{number}"), (ini.parent, tmp_path / f"all{number}")):
            assert run("convert", source, out, "--json", tmp_path / "j.json") == 0
            remarks = json.loads((tmp_path / "j.json").read_text())["remarks"]
            assert len(remarks) == (says is not None)
            assert says is None or (says in remarks[0] and "box.ini" in remarks[0] and says in capsys.readouterr().out)
    listed = tacman / "measurements" / "cloud.off"
    assert run("convert", listed, tmp_path / "l", "--object", "box", "--json", tmp_path / "j.json") == 0
    assert "cloud.off: all 1140 points" in json.loads((tmp_path / "j.json").read_text())["remarks"][0]


def test_malformed_tacman_sets(tacman, tmp_path, capsys):
    ini = tacman / "configurationFiles" / "box.ini"
    (tacman / "measurements" / "measBox.off").write_text("OFF\n3 0 0\n1 2 3\n")
    assert "measBox.off" in refused(capsys, "convert", ini, tmp_path / "c")
    (tacman / "measurements" / "measBox.off").unlink()
    assert "expected the file ../../measurements/measBox.off that it names" in refused(
        capsys, "convert", ini, tmp_path / "c"
    )
    ini.write_text("modelFile ../../models/box.off\n")
    assert "expected measurementsFile, got modelFile" in refused(capsys, "convert", ini, tmp_path / "c")


def test_a_list_of_contacts_with_an_object_is_a_capture(tacman, tmp_path, capsys):
    contacts = tacman / "measurements" / "measBox.off"
    assert "expected --object NAME|MESH for a capture" in refused(capsys, "convert", contacts, tmp_path / "c")
    assert run("convert", contacts, tmp_path / "c", "--object", tacman / "models" / "box.off") == 0
    assert len(read_capture(tmp_path / "c")[0].contacts) == 20


def test_recorded_contact_sets_convert(contact_data, tmp_path):
    pairs = {"Box15_sim": "box", "Lego_exp": "legoBox", "Tetra30_sim": "tetrahedron"}
    for name, model in pairs.items():
        argv = ("convert", contact_data / "contacts" / f"{name}.off", tmp_path / name)
        assert run(*argv, "--object", contact_data / "models" / f"{model}.off") == 0
        assert run("validate", tmp_path / name) == 0
