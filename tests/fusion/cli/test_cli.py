"""The command: exit codes, files, one line for every mistake, and nothing but that line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import refused
from made_frames import plain_view

from fusion.cli.main import main
from fusion.cli.options import length_and_angle, share
from fusion.cli.parser import build_parser
from scenes.files.formats.off import read_off, write_off
from scenes.files.formats.ply import write_ply
from scenes.geometry import poses
from scenes.recordings.bop import read_poses
from scenes.recordings.captures import read_capture, write_capture
from scenes.recordings.frames import Contacts, Frame
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.library import make

ROOT = Path(__file__).resolve().parents[3]
DATA = Path(os.environ.get("PALPATE_DATA", ROOT.parent / "shared" / "data"))


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Path:
    """Two frames of a box in front of nothing."""
    folder = tmp_path_factory.mktemp("cli") / "box"
    frames = [replace(plain_view(seed=i), index=i) for i in range(2)]
    return write_capture(folder, frames, make("box"))


@pytest.fixture(scope="module")
def contacts(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("touch") / "contacts.off"
    points, normals = make("drill").sample_surface(12, 3)
    turn = poses.exp([0.3, -0.2, 0.9, 0.2, 0.1, -0.3])
    write_off(path, poses.apply(turn, points), normals=normals @ turn[:3, :3].T)
    return path


def test_estimate_then_evaluate(capture, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["estimate", str(capture), "--out", str(out), "--json", str(tmp_path / "copy.json")]) == 0
    assert "ADD-S" in capsys.readouterr().out
    result = json.loads((out / "result.json").read_text())
    assert result == json.loads((tmp_path / "copy.json").read_text())
    assert result["version"] == 1
    assert [f["frame"] for f in result["frames"]] == [0, 1]
    first = result["frames"][0]
    keys = "frame verdict camera_from_object hand_from_object covariance modes unobservable visible_fraction time_ms"
    assert set(keys.split()) | {"trace", "contacts", "errors"} <= set(first)
    assert np.array(first["covariance"]).shape == (6, 6)
    assert {"stage", "ran", "why", "ms", "rows"} == set(first["trace"][0])
    assert result["errors"]["median_add_s_mm"] < 1.0
    rows = read_poses(out / "poses.csv")
    assert [row.im_id for row in rows] == [0, 1]
    np.testing.assert_allclose(rows[0].pose, first["camera_from_object"], atol=1e-9)
    assert (out / "report.html").stat().st_size > 10_000
    measured = tmp_path / "evaluated.json"
    assert main(["evaluate", str(out / "poses.csv"), str(capture), "--json", str(measured)]) == 0
    found = json.loads(measured.read_text())
    assert found["frames"][0]["add_s_mm"] == pytest.approx(first["errors"]["add_s_mm"], abs=1e-6)
    assert found["frames"][0]["nees"] == pytest.approx(first["errors"]["nees"], rel=1e-3)


def test_some_frames_only(capture, tmp_path, capsys):
    ask = ["estimate", str(capture), "--out", str(tmp_path), "--no-report", "--frames"]
    assert main([*ask, "1-7"]) == 0
    assert [row.im_id for row in read_poses(tmp_path / "poses.csv")] == [1]
    capsys.readouterr()
    assert "frames: expected some of the capture's 2 (0 to 1), got 4-7" in refused(capsys, *ask, "0,4-7")
    assert "frames: expected numbers and spans like 0,10-20, got '5-'" in refused(capsys, *ask, "5-")


def test_the_same_seed_gives_the_same_pose_in_another_process(capture, tmp_path):
    for name in ("a", "b"):
        command = [sys.executable, "-m", "fusion.cli.main", "estimate", str(capture), "--no-report", "--seed", "5"]
        subprocess.run([*command, "--out", str(tmp_path / name)], check=True, cwd=ROOT, capture_output=True)
    a, b = (json.loads((tmp_path / name / "result.json").read_text())["frames"] for name in ("a", "b"))
    assert [f["camera_from_object"] for f in a] == [f["camera_from_object"] for f in b]
    assert [f["covariance"] for f in a] == [f["covariance"] for f in b]


def test_priors(capture, tmp_path, capsys):
    model, truth = make("box"), read_capture(capture)[1].camera_from_object_truth
    base = ["estimate", str(capture), "--no-report", "--out", str(tmp_path / "o"), "--use", "touch"]
    for text in ("none", "gt", "gt+5mm,3deg", str(capture / "prior.json")):
        assert main([*base, "--prior", text]) in (0, 1)
    from fusion.results.runs import prior_setter

    frame = prior_setter("gt+33mm,16deg", 4)(read_capture(capture)[1], model)
    delta = poses.difference(frame.prior, truth, model.centroid)
    assert np.linalg.norm(delta[:3]) == pytest.approx(np.deg2rad(16))
    assert np.linalg.norm(delta[3:]) == pytest.approx(0.033)
    assert prior_setter("none", 0)(frame, model).prior is None
    capsys.readouterr()
    assert "expected a prior of frame 1" in refused(capsys, *base, "--prior", _only_frame_0(capture, tmp_path))
    assert "expected none, gt+NOISE" in refused(capsys, *base, "--prior", "nowhere.json")
    assert "33mm,16deg" in refused(capsys, *base, "--prior", "gt+much")


def _only_frame_0(capture: Path, tmp_path: Path) -> Path:
    content = json.loads((capture / "prior.json").read_text())
    (tmp_path / "prior.json").write_text(json.dumps({"0": content["0"]}))
    return tmp_path / "prior.json"


def test_compare_writes_table_json_and_plot(capture, tmp_path, capsys):
    argv = ["compare", str(capture), "--methods", "icp,fused", "--prior", "gt+5mm,3deg"]
    assert main([*argv, "--json", str(tmp_path / "c.json"), "--plot", str(tmp_path / "c.svg")]) == 0
    out = capsys.readouterr().out
    assert "icp" in out
    assert "fused" in out
    found = json.loads((tmp_path / "c.json").read_text())
    assert {row["method"] for row in found["rows"]} == {"icp", "fused"}
    assert len(found["rows"]) == 4
    assert found["summary"][1]["success"] == 1.0
    assert (tmp_path / "c.svg").read_text().startswith("<svg")


def test_validate(capture, tmp_path, capsys):
    assert main(["validate", str(capture), "--json", str(tmp_path / "v.json")]) == 0
    assert json.loads((tmp_path / "v.json").read_text()) == {
        "valid": True,
        "frames": 2,
        "problems": [],
        "warnings": [],
    }
    broken = tmp_path / "broken"
    write_capture(broken, [plain_view()], make("box"))
    (broken / "depth" / "000000.png").write_bytes(b"no image")
    (broken / "contacts.csv").write_text("frame,sensor,x,y,z\n0,a,1,2\n0,b,nan,0,0\n")
    capsys.readouterr()
    assert main(["validate", str(broken), "--json", str(tmp_path / "v.json")]) == 1
    assert len(json.loads((tmp_path / "v.json").read_text())["problems"]) == 3
    assert "3 problems" in capsys.readouterr().out


def test_localize_by_touch(contacts, tmp_path, capsys):
    argv = ["localize", str(contacts), "--object", "drill", "--trials", "2", "--max-contacts", "9"]
    assert main([*argv, "--json", str(tmp_path / "l.json")]) == 0
    found = json.loads((tmp_path / "l.json").read_text())
    assert found["method"] == "multistart"
    assert len(found["trials"]) == 2
    assert {"pose", "index_mm", "time_s", "modes", "verdict", "confidence"} <= set(found["trials"][0])
    main(["localize", str(contacts), "--object", "drill", "--json", str(tmp_path / "l.json")])
    trial = json.loads((tmp_path / "l.json").read_text())["trials"][0]
    assert trial["index_mm"] < 1.0
    assert trial["sure_within_mm"] == pytest.approx(5.0)
    assert (trial["verdict"] == "ok") == (trial["confidence"] >= 0.95)
    capsys.readouterr()
    loose = ["localize", str(contacts), "--object", "drill", "--sure-within", "50", "--json", str(tmp_path / "l.json")]
    assert main(loose) == 0
    assert "sure" in capsys.readouterr().out
    assert json.loads((tmp_path / "l.json").read_text())["trials"][0]["confidence"] >= trial["confidence"]


def test_localize_with_a_cloud(contacts, tmp_path):
    turn = poses.exp([0.3, -0.2, 0.9, 0.2, 0.1, -0.3])
    points, _ = make("drill").sample_surface(2000, 5)
    write_ply(tmp_path / "cloud.ply", poses.apply(turn, points))
    argv = ["localize", str(contacts), "--object", "drill", "--cloud", str(tmp_path / "cloud.ply")]
    assert main([*argv, "--json", str(tmp_path / "l.json")]) == 0
    trial = json.loads((tmp_path / "l.json").read_text())["trials"][0]
    assert set(trial["senses"]) == {"vision", "touch", "fused"}
    assert trial["senses"]["fused"]["cloud_mm"] < 1.0
    assert 0.0 <= trial["confidence"] <= 1.0
    assert trial["index_mm"] < 1.0


def test_contacts_of_a_csv_need_no_sensor_and_no_frame(tmp_path):
    points = make("box").sample_surface(8, 0)[0]
    (tmp_path / "c.csv").write_text("x,y,z\n" + "\n".join(",".join(map(repr, p)) for p in points.tolist()) + "\n")
    assert main(["localize", str(tmp_path / "c.csv"), "--object", "box", "--json", str(tmp_path / "l.json")]) == 0
    assert json.loads((tmp_path / "l.json").read_text())["trials"][0]["index_mm"] < 0.1


def test_synth_makes_what_validate_likes(tmp_path, capsys):
    argv = ["synth", str(tmp_path / "s"), "--object", "box", "--hand", "none", "--occlusion", "30%", "--noise", "clean"]
    assert main(argv) == 0
    assert main(["validate", str(tmp_path / "s")]) == 0
    assert read_capture(tmp_path / "s").manifest.notes["noise"] == "clean"


def test_convert_there_and_back(tmp_path):
    cube = make("box")
    grasp = tmp_path / "grasp"
    grasp.mkdir()
    points = cube.sample_surface(300, 0)[0]
    write_off(grasp / "cloud.off", points, colours=np.full((300, 3), 7))
    write_off(grasp / "contacts.off", points[:3])
    write_off(grasp / "model.off", cube.vertices, cube.faces)
    assert main(["convert", str(grasp), str(tmp_path / "c")]) == 0
    converted = read_capture(tmp_path / "c")
    frame = converted[0]
    assert (converted.world, converted.hand, frame.camera, frame.prior) == ("robot base", None, None, None)
    assert np.array_equal(frame.cloud, points)
    assert np.array_equal(frame.contacts.points, points[:3])
    assert not frame.contacts.has_normal.any()
    assert not frame.contacts.sigma_known
    assert main(["validate", str(tmp_path / "c")]) == 0
    assert main(["convert", str(tmp_path / "c"), str(tmp_path / "back")]) == 0
    for name in ("cloud", "contacts"):
        there, back = read_off(grasp / f"{name}.off"), read_off(tmp_path / "back" / f"{name}.off")
        assert np.array_equal(there.points, back.points)
    assert main(["convert", str(tmp_path), str(tmp_path / "all")]) == 0
    assert {p.name for p in (tmp_path / "all").iterdir()} == {"grasp", "back"}
    assert main(["convert", str(grasp / "contacts.off"), str(tmp_path / "k.csv")]) == 0
    assert main(["convert", str(tmp_path / "k.csv"), str(tmp_path / "k.off")]) == 0
    assert np.array_equal(read_off(tmp_path / "k.off").points, points[:3])


@pytest.mark.skipif(not DATA.is_dir(), reason="no folder of recorded data beside the project")
@pytest.mark.parametrize("name", ["domino", "mustard", "spam"])
def test_recorded_grasps_convert(tmp_path, name):
    assert main(["convert", str(DATA / "icub-handover" / name), str(tmp_path / name)]) == 0
    assert main(["validate", str(tmp_path / name)]) == 0
    frame = read_capture(tmp_path / name)[0]
    assert len(frame.contacts) == 3
    assert len(frame.cloud) > 1000


def test_bad_use(capture, contacts, tmp_path, capsys):
    (empty := tmp_path / "empty.csv").write_text("frame,x,y,z\n")
    cases = [
        ((), "the following arguments are required: COMMAND"),
        (("dance",), "command: expected one of demo, "),
        (("estimate",), "the following arguments are required: CAPTURE"),
        (("estimate", capture, "--use", "smell"), "expected vision, touch or both, got smell"),
        (("estimate", capture, "--seed", "-1"), "expected a whole number from 0"),
        (("estimate", capture, "--tolerance", "fine"), "expected a length and an angle"),
        (("estimate", capture, "--budget-ms", "-1"), "expected a number from 0"),
        (("estimate", capture, "--object", "unicorn"), "expected a mesh file or one of"),
        (("estimate", tmp_path / "no"), "expected the folder of a capture, found nothing"),
        (("estimate", tmp_path), "found no capture.json"),
        (("validate", tmp_path / "no"), "expected the folder of a capture"),
        (("compare", capture, "--methods", "icp,magic"), "got magic"),
        (("compare", capture, "--methods", "icp", "--plot", "p.doc"), ".html or .svg"),
        (("synth", tmp_path / "s", "--object", "unicorn"), "expected a mesh file or one of"),
        (("synth", tmp_path / "s", "--object", "box", "--occlusion", "1.5"), "expected a share"),
        (("synth", tmp_path / "s", "--object", "box", "--noise", "loud"), "loud"),
        (
            ("synth", tmp_path / "s", "--object", "box", "--hand", "claw"),
            "expected five-finger, gripper, none or a URDF",
        ),
        (("synth", ROOT / "scenes", "--object", "box"), "holds other files"),
        (("localize", contacts), "expected --object NAME|MESH for contacts"),
        (("localize", tmp_path / "no.csv", "--object", "box"), "found no file"),
        (("localize", contacts, "--object", "box", "--method", "guess"), "expected one of multistart"),
        (("localize", contacts, "--object", "box", "--unit", "furlong", "--object", contacts), "furlong"),
        (("localize", contacts, "--object", contacts), "contacts.off"),
        (("localize", contacts, "--object", "box", "--cloud", tmp_path / "no.ply"), "no.ply"),
        (("localize", contacts, "--object", "box", "--json", "/proc/none/x.json"), "/proc/none"),
        (("evaluate", tmp_path / "no.csv", capture), "expected a poses.csv"),
        (("evaluate", capture / "contacts.csv", capture), "expected the header scene_id"),
        (("localize", capture / "contacts.csv", "--object", "box", "--frame", "7"), "expected a frame of 0, 1, got 7"),
        (("localize", empty, "--object", "box", "--frame", "7"), "expected at least one contact, found none"),
        (("localize", __file__, "--object", "box"), "ends in .csv, .off or .ply"),
        (("convert", tmp_path / "no", tmp_path / "c"), "found nothing"),
        (("convert", tmp_path, tmp_path / "c"), "found neither"),
        (("convert", contacts, tmp_path / "c.docx"), "expected files ending in"),
    ]
    for argv, message in cases:
        assert message in refused(capsys, *argv), argv


def _damaged(tmp_path: Path, name: str, frame: Frame, model=None, **options) -> Path:
    return write_capture(tmp_path / name, [frame], model or make("box"), **options)


def test_bad_captures(tmp_path, capsys):
    frame = plain_view()
    blank = _damaged(tmp_path, "blank", replace(frame, depth=np.zeros_like(frame.depth)))
    assert "frame 0: expected depth readings, got an image of zeros" in refused(capsys, "estimate", blank)
    assert "an image of zeros" in refused(capsys, "compare", blank)
    far = replace(frame, contacts=Contacts(frame.contacts.points * 1e3))
    assert "mm read as m?" in refused(capsys, "estimate", _damaged(tmp_path, "far", far))
    unit = _damaged(tmp_path, "unit", frame)
    (unit / "capture.json").write_text((unit / "capture.json").read_text().replace('"m"', '"mm"'))
    assert "is the unit right?" in refused(capsys, "estimate", unit)
    lost = _damaged(tmp_path, "lost", frame)
    (lost / "depth" / "000000.png").unlink()
    assert "expected a depth image, found none" in refused(capsys, "estimate", lost)
    none = _damaged(tmp_path, "nan", frame)
    text = (none / "contacts.csv").read_text().splitlines()
    cells = text[1].split(",")
    cells[2] = "nan"
    (none / "contacts.csv").write_text("\n".join([text[0], ",".join(cells), *text[2:]]))
    assert "contacts.csv, frame 0: line 2, column x: expected a finite number" in refused(capsys, "estimate", none)
    flat = _damaged(tmp_path, "flat", frame)
    write_ply(flat / "models/obj_000001.ply", np.eye(3), np.zeros((0, 3)))
    assert "obj_000001.ply" in refused(capsys, "estimate", flat)
    hand = five_finger_hand()
    held = replace(frame, hand=hand, joints={"shadow_FFJ3": 0.1}, world_from_hand=np.eye(4))
    assert "shadow_FFJ3" in refused(capsys, "estimate", _damaged(tmp_path, "hand", held, hand=hand))


def test_a_frame_with_a_start_is_answered_without_scipy(capture, tmp_path):
    # a tenth to a third of a second each, where an answer takes a tenth
    argv = ["estimate", str(capture), "--out", str(tmp_path / "out"), "-q"]
    code = f"import sys, fusion.cli.main as m; m.main({argv!r}); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    heavy = {"scipy.linalg", "scipy.spatial", "scipy.special", "scipy.stats", "numpy.f2py", "trimesh"}
    assert heavy & set(done.stdout.split()) == set()


def test_help_is_quick_to_load_and_the_pipe_may_close():
    code = "import sys, fusion.cli.parser as p; p.build_parser(); print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    heavy = {"numpy", "scipy", "numba", "open3d", "trimesh", "cv2", "rich", "plotly"} & set(loaded.split())
    assert heavy == set()
    # what is loaded before `main` runs cannot turn Ctrl-C into a line
    code = "import sys, fusion.cli.main; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert {"fusion.cli.parser", "fusion.cli.options"} & set(loaded.split()) == set()
    piped = f"set -o pipefail; {sys.executable} -m fusion.cli.main --help | true"
    done = subprocess.run(["bash", "-c", piped], cwd=ROOT, capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr


def test_an_estimate_of_known_meshes_loads_no_mesh_library(lab_frame, drill, tmp_path):
    # what the first run read, repaired and measured of the object and of the hand's links is kept by the files' bytes
    capture = write_capture(tmp_path / "held", [lab_frame], drill, hand=lab_frame.hand)
    code = "import sys; from fusion.cli.main import start; start(); print(*sys.modules)"
    command = [sys.executable, "-c", code, "estimate", str(capture), "--out", str(tmp_path / "out")]
    for _ in range(2):
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert {"numba", "cv2", "fusion.results.report.page"} <= loaded
    heavy = {"trimesh", "PIL", "scipy.optimize", "scipy.stats", "scipy.interpolate", "scipy.ndimage", "scipy.signal"}
    assert heavy & loaded == set()


def test_every_command_has_json_and_seed(capsys):
    actions = next(a for a in build_parser()._actions if a.dest == "command")
    wanted = {"demo", "synth", "validate", "estimate", "compare", "evaluate", "localize", "convert"}
    assert wanted <= set(actions.choices)
    for name, command in actions.choices.items():
        assert {"--json", "--seed"} <= set(command._option_string_actions), name
        with pytest.raises(SystemExit) as done:
            main([name, "--help"])
        assert done.value.code == 0
    with pytest.raises(SystemExit) as done:
        main(["--version"])
    assert done.value.code == 0
    assert "palpate" in capsys.readouterr().out


def test_quantities():
    assert length_and_angle("33mm,16deg") == pytest.approx((0.033, np.deg2rad(16)))
    assert length_and_angle("1,2") == pytest.approx((0.001, np.deg2rad(2)))
    assert length_and_angle("0.5cm, 0.1rad") == pytest.approx((0.005, 0.1))
    assert share("60%") == share("0.6") == 0.6


def test_near_misses_are_named(tmp_path, capsys):
    for argv, meant in (
        (["synth", tmp_path / "c", "--object", "dril"], "drill"),
        (["localize", tmp_path, "--object", "box", "--method", "Annealling"], "annealing"),
        (["estimat", tmp_path], "estimate"),
        (["bench", "tracing"], "tracking"),
        (["convert", tmp_path, tmp_path / "o", "--from", "ycbineoats"], "ycbineoat"),
        (["synth", tmp_path / "c", "--object", "box", "--noise", "labs"], "lab"),
        (["localize", tmp_path, "--object", "quaternion"], None),
    ):
        line = refused(capsys, *argv)
        assert ("did you mean" in line) == (meant is not None), line
        assert meant is None or line.endswith(f"did you mean {meant}?\n")


def test_where_it_cannot_be_written_is_said_before_the_work(capture, tmp_path, capsys):
    file = tmp_path / "file"
    file.write_text("mine")
    (tmp_path / "folder.ply").mkdir()
    for argv in (
        ["estimate", capture, "--out", file],
        ["estimate", capture, "--json", file / "x.json"],
        ["track", capture, "--out", file / "deeper"],
        ["grasp", capture, "--out", file],
        ["batch", capture.parent, "--out", file],
        ["demo", "--out", file],
        ["model", capture, "-o", tmp_path / "folder.ply"],
        ["compare", capture, "--plot", file / "x.svg"],
        ["convert", capture, file, "--to", "bop"],
        ["convert", capture, file / "x.tum"],
        ["convert", capture / "contacts.csv", tmp_path / "folder.ply"],
    ):
        line = refused(capsys, *argv)
        assert (
            "expected a folder to write to, found a file" in line or "expected a file to write, found a folder" in line
        )
    assert file.read_text() == "mine"


def test_the_folder_of_a_recording_says_how_to_convert_it(capture, tmp_path, capsys):
    assert main(["convert", str(capture), str(tmp_path / "set"), "--to", "bop"]) == 0
    capsys.readouterr()
    scene = tmp_path / "set" / "test" / "000000"
    for argv in (
        ["estimate", scene],
        ["track", tmp_path / "set"],
        ["batch", scene.parent],
        ["batch", tmp_path / "set"],
    ):
        assert f"`palpate convert {scene} OUT`" in refused(capsys, *argv)
    assert "expected a folder, or a file that ends in .glb or .tum" in refused(
        capsys, "convert", capture, tmp_path / "x.glbb"
    )


def test_contacts_in_millimetres_are_suspected_by_every_command(contacts, tmp_path, capsys):
    write_off(tmp_path / "mm.off", 1e3 * read_off(contacts).points)
    (tmp_path / "objects").mkdir()
    for name in ("box", "drill"):
        write_ply(tmp_path / "objects" / f"{name}.ply", make(name).vertices, make(name).faces)
    for command, *option in (("localize", "--object", "drill"), ("identify", "--objects", tmp_path / "objects")):
        assert "mm read as m?" in refused(capsys, command, tmp_path / "mm.off", *option)


def test_one_frame_that_cannot_be_used_is_left_out(tmp_path, capsys):
    frame = plain_view()
    blank = replace(frame, index=1, depth=np.zeros_like(frame.depth))
    last = replace(frame, index=2)
    capture = write_capture(tmp_path / "three", [frame, blank, last], make("box"))
    out = tmp_path / "out"
    assert main(["estimate", str(capture), "--out", str(out), "--no-report"]) == 1
    told = capsys.readouterr().err
    assert "left out: " in told
    assert "frame 1: expected depth readings, got an image of zeros" in told
    content = json.loads((out / "result.json").read_text())
    assert [entry["frame"] for entry in content["frames"]] == [0, 2]
    assert [entry["frame"] for entry in content["left_out"]] == [1]
    assert main(["validate", str(out / "result.json")]) == 0
    capsys.readouterr()
    assert main(["compare", str(capture), "--methods", "icp", "--json", str(tmp_path / "c.json")]) == 1
    assert "frame 1: expected depth readings" in capsys.readouterr().err
    rows = json.loads((tmp_path / "c.json").read_text())["rows"]
    assert [row["frame"] for row in rows] == [0, 2]
    (capture / "depth" / "000000.png").write_bytes(b"junk")
    (capture / "depth" / "000002.png").unlink()
    assert "depth/000000.png" in refused(capsys, "estimate", capture)
