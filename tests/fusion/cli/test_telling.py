"""--camera, --calibration, --joints, --mesh, --image: over --config, and that over what a capture says."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from commands import refused, run
from made_frames import plain_view

from fusion.cli.config import CommandConfig
from fusion.cli.main import main
from fusion.results.batch import Job
from fusion.results.runs import frame_setter
from scenes.files.merged import merged, read_toml
from scenes.recordings.beliefs import Beliefs, ImageModel
from scenes.recordings.captures import read_capture, write_capture
from scenes.recordings.depth_cameras import DEPTH_CAMERAS
from scenes.recordings.telling import believed
from scenes.synthesis.library import make

SAID = Beliefs(depth=DEPTH_CAMERAS["l515"], mesh_sigma=0.002)


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """A capture that tells of a camera and of a mesh."""
    folder = tmp_path_factory.mktemp("captures") / "plain"
    return write_capture(folder, [replace(plain_view(), beliefs=SAID)], make("box"))


def shown(capsys, tmp_path, *argv) -> Beliefs:
    """What --show-config prints of the beliefs, read back."""
    with pytest.raises(SystemExit) as end:
        main([*map(str, argv), "--show-config"])
    assert end.value.code == 0
    path = tmp_path / "shown.toml"
    path.write_text(capsys.readouterr().out)
    return merged(CommandConfig.defaults(), {"beliefs": read_toml(path)["beliefs"]}, "shown").beliefs


@pytest.mark.parametrize("command", ["estimate", "track"])
def test_flags_are_stronger_than_a_file_and_that_than_the_capture(capsys, tmp_path, capture, command):
    assert shown(capsys, tmp_path, command) == Beliefs()
    assert shown(capsys, tmp_path, command, capture) == SAID
    config = tmp_path / "c.toml"
    config.write_text('[beliefs]\ncamera = "d455"\n[beliefs.calibration]\ntranslation_sigma = 0.005\n')
    with_file = shown(capsys, tmp_path, command, capture, "--config", config)
    assert with_file.depth == DEPTH_CAMERAS["d455"]
    assert with_file.calibration.translation_sigma == 0.005
    assert with_file.mesh_sigma == SAID.mesh_sigma
    flags = ("--camera", "d435", "--calibration", "1,0.2", "--joints", "0.6", "--mesh", "0.1", "--image", "0.3")
    told = shown(capsys, tmp_path, command, capture, "--config", config, *flags)
    assert told.depth == DEPTH_CAMERAS["d435"]
    assert told.calibration.translation_sigma == pytest.approx(0.001)
    assert told.calibration.rotation_sigma == pytest.approx(np.deg2rad(0.2))
    assert told.touch.fingertip_sigma == pytest.approx(0.15 * np.deg2rad(0.6))
    assert told.mesh_sigma == pytest.approx(0.0001)
    assert told.image == ImageModel(0.3, 0.3)


def test_a_camera_of_one_s_own(capsys, tmp_path):
    camera = tmp_path / "mine.toml"
    camera.write_text('like = "azure-kinect"\nbias_sigma = 0.0005\n')
    mine = shown(capsys, tmp_path, "estimate", "--camera", camera)
    assert mine.depth == replace(DEPTH_CAMERAS["azure-kinect"], bias_sigma=0.0005)
    # what --show-config prints of a camera makes one, too
    with pytest.raises(SystemExit):
        main(["estimate", "--camera", str(camera), "--show-config"])
    table = capsys.readouterr().out.split("[beliefs.depth]\n")[1].split("\n\n")[0]
    camera.write_text(table)
    assert shown(capsys, tmp_path, "estimate", "--camera", camera).depth == mine.depth


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (("--camera", "d436"), "--camera: expected a TOML file or one of kinect-v1, .* got 'd436': did you mean d435"),
        (("--camera", "bad.toml"), "bad.toml: depth: expected a setting of .* did you mean bias_sigma"),
        (("--camera", "text.toml"), "expected TOML, got malformed text"),
        (("--mesh", "80"), "--mesh: expected a number above 0 and up to 50 mm, got '80'"),
        (("--image", "80"), "--image: expected a number above 0 and up to 50 px, got '80'"),
        (("--calibration", "0,0.3"), "--calibration: expected a length and an angle above 0 and up to 500 mm and 45.8"),
        (
            ("--calibration", "2000,0.3"),
            "an angle above 0 and up to 500 mm and 45.8 degrees, got '2000,0.3'",
        ),
        (("--joints", "90"), "--joints: expected a number above 0 and up to 38.2 degrees, got '90'"),
    ],
)
@pytest.mark.parametrize("command", ["estimate", "track", "batch", "compare"])
def test_what_is_no_belief_is_one_line(capsys, tmp_path, monkeypatch, capture, command, flags, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.toml").write_text("bias_sigmas = 1.0")
    (tmp_path / "text.toml").write_text("bias_sigma")
    target = capture.parent if command == "batch" else capture
    assert re.search(message, refused(capsys, command, target, *flags))


@pytest.mark.parametrize("flag", [("--joints", "much"), ("--calibration", "2"), ("--mesh", "-1"), ("--joints", "0")])
def test_numbers_that_are_none_are_bad_use(capsys, capture, flag):
    assert refused(capsys, "estimate", capture, *flag).startswith(f"palpate: argument {flag[0]}")


def test_they_reach_the_frame_and_the_batch_s_question():
    tables = (("--mesh", {"mesh_sigma": 0.001}),)
    frame = frame_setter("none", 0, tables)(replace(plain_view(), beliefs=SAID), make("box"))
    assert frame.beliefs == replace(SAID, mesh_sigma=0.001)
    assert frame_setter("none", 0)(plain_view(), make("box")).beliefs is None
    asked, other = Job("p", "n", "o", told=tables), Job("p", "n", "o")
    assert asked.fingerprint != other.fingerprint
    assert asked.fingerprint == Job("p", "n", "o", told=(("elsewhere", {"mesh_sigma": 0.001}),)).fingerprint


def test_a_printed_config_leaves_a_capture_its_own(capsys, tmp_path, capture):
    with pytest.raises(SystemExit):
        main(["estimate", "--show-config"])
    config = tmp_path / "all.toml"
    config.write_text(capsys.readouterr().out)
    assert shown(capsys, tmp_path, "estimate", capture, "--config", config) == SAID


def test_they_change_the_answer(tmp_path, capture):
    """A frame's own beliefs, and those told instead: a mesh of 2 mm is less sure than one of 0.1."""
    sizes = []
    for told in ((), ("--mesh", "0.1", "--camera", "clean")):
        assert run("estimate", capture, "--out", tmp_path, "--no-report", "-q", *told) == 0
        (entry,) = json.loads((tmp_path / "result.json").read_text())["frames"]
        sizes.append(np.trace(np.array(entry["covariance"])[3:, 3:]))
    assert sizes[1] < 0.5 * sizes[0]


def test_convert_writes_them_and_localize_needs_a_cloud(capsys, tmp_path, capture):
    contacts = capture / "contacts.csv"
    assert "expected --cloud FILE beside it" in refused(capsys, "localize", contacts, "--object", "box", "--mesh", 1)
    assert run("convert", contacts, tmp_path / "c", "--object", "box", "--camera", "d455", "--mesh", "1", "-q") == 0
    told = believed(None, [("", {"camera": "d455", "mesh_sigma": 0.001})])
    assert read_capture(tmp_path / "c").beliefs == told
    # to BOP and back: what is said of a recording stays with it
    assert run("convert", capture, tmp_path / "bop", "-q") == 0
    assert run("convert", tmp_path / "bop" / "test" / "000000", tmp_path / "back", "-q") == 0
    assert read_capture(tmp_path / "back").beliefs == SAID
    refused_line = refused(capsys, "convert", capture, tmp_path / "other", "--mesh", "1")
    assert "expected a recording that becomes a capture" in refused_line
