"""Options that would do nothing are refused in one line, not passed over."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import pytest
from commands import refused, run
from made_frames import plain_view

from scenes.recordings.captures import write_capture
from scenes.synthesis.library import make


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("given")
    write_capture(folder / "c", [plain_view()], make("box"))
    assert run("estimate", folder / "c", "--out", folder / "r", "--no-report", "-q") in (0, 1)
    return folder


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (("estimate", "c", "--unit", "mm"), "--unit: expected --object MESH beside it"),
        (("batch", ".", "--unit", "mm"), "--unit: expected --object MESH beside it"),
        (("grasp", "r", "--unit", "mm"), "--unit: expected --object MESH beside it"),
        (("estimate", "c", "--object", "drill", "--unit", "mm"), "--unit: expected a mesh file as --object, got drill"),
        (("synth", "s", "--object", "drill", "--unit", "cm"), "--unit: expected a mesh file as --object, got drill"),
        (("estimate", "c", "--object", ""), "--object: expected a name or a path"),
        (("estimate", "c", "--out", ""), "--out: expected a name or a path"),
        (("estimate", "c", "--out="), "--out: expected a name or a path"),
        (("grasp", "r", "--prior", "none"), "--prior: expected a capture, which is estimated with it"),
        (("grasp", "r", "--use", "touch"), "--use: expected a capture, which is estimated with it"),
        (("grasp", "c", "--capture", "c"), "--capture: expected a result, whose capture it is"),
        (("synth", "s", "--object", "box", "--taxels", "pad"), "--taxels: expected --touch array beside it"),
        (
            ("synth", "s", "--object", "box", "--hand", "gripper", "--occluders", "border"),
            "--hand: expected occluders h",
        ),
        (("synth", "s", "--object", "box", "--occluders", "none", "--occlusion", 0.5), "occlusion: expected 0 without"),
        (
            ("calibrate-gel", "c", "--ball", 4, "--digit", "--sensor", "x"),
            "--sensor: expected --sensors FILE beside it",
        ),
    ],
)
def test_what_would_be_passed_over_is_refused(folder, monkeypatch, capsys, argv, said):
    monkeypatch.chdir(folder)
    assert refused(capsys, *argv).startswith(f"palpate: {said}")
    assert sorted(path.name for path in folder.iterdir()) == ["c", "r"]


def test_a_result_of_another_capture_is_refused(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    write_capture(tmp_path / "other", [plain_view()], make("box"))
    write_capture(tmp_path / "later", [replace(plain_view(), index=7)], make("box"))
    out = ("--out", tmp_path / "g", "--no-report", "--no-map")
    said = refused(capsys, "grasp", "r", "--capture", tmp_path / "other", *out)
    assert f"{tmp_path / 'other'}: expected c, the capture of r/result.json, got other" in said
    said = refused(capsys, "grasp", "r", "--capture", tmp_path / "later", *out)
    assert f"{tmp_path / 'later'}: expected the capture of r/result.json, got one without its frame 0" in said
    assert not (tmp_path / "g").exists()


def test_a_capture_that_has_moved_and_has_another_name_is_taken(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(folder / "c", tmp_path / "moved")
    (tmp_path / "r").mkdir()
    content = json.loads((folder / "r" / "result.json").read_text()) | {"capture_path": str(tmp_path / "gone")}
    (tmp_path / "r" / "result.json").write_text(json.dumps(content))
    assert run("grasp", "r", "--capture", "moved", "--out", "g", "--no-report", "--no-map") in (0, 1)


def test_a_capture_of_nothing_that_hides_says_so(tmp_path, capsys):
    told = tmp_path / "s.json"
    small = ("--object", "box", "--touch", "point", "--seed", 3)
    assert run("synth", tmp_path / "s", *small, "--occluders", "none", "--json", told) == 0
    assert "0 % hidden" in capsys.readouterr().out
    assert json.loads(told.read_text())["occlusion"] == 0.0
    manifest = json.loads((tmp_path / "s" / "capture.json").read_text())
    assert manifest["notes"]["occlusion"] == 0.0
    assert manifest["hand"] is None  # no frame has one
    assert run("validate", tmp_path / "s") == 0


def test_a_grasp_says_which_frames_it_left_out(folder, tmp_path, capsys):
    write_capture(tmp_path / "c", [plain_view(), replace(plain_view(), index=1)], make("box"))
    (tmp_path / "c" / "depth" / "000001.png").write_bytes(b"no image")
    assert run("grasp", tmp_path / "c", "--out", tmp_path / "g", "--no-report", "--no-map", "--samples", 0) == 1
    assert "frame 1" in capsys.readouterr().err
    content = json.loads((tmp_path / "g" / "grasp.json").read_text())
    assert [left["frame"] for left in content["left_out"]] == [1]
    assert [frame["posterior"]["samples"] for frame in content["frames"]] == [0]
