"""Out of a capture: trajectories, 3-D scenes, and the choices of the command."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from commands import refused, run
from hypothesis import given, settings
from hypothesis import strategies as st
from made_frames import plain_view

from scenes.errors import CaptureError
from scenes.formats.tum import read_tum, write_tum
from scenes.geometry import poses
from scenes.recordings.bop import PoseRow, write_poses
from scenes.recordings.captures import write_capture
from scenes.synthesis.library import make


@pytest.fixture
def capture(tmp_path):
    frames = [replace(plain_view(seed=i), index=3 * i) for i in range(3)]
    write_capture(tmp_path / "c", frames, make("box"))
    return tmp_path / "c", [frame.camera_from_object_truth for frame in frames]


@settings(derandomize=True, deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1), st.integers(0, 2**62))
def test_tum_there_and_back(tmp_path_factory, seed, start):
    rng = np.random.default_rng(seed)
    found = {i: poses.exp(rng.normal(size=6)) for i in range(3)}
    stamps = {i: start + 33_333_333 * i for i in found}
    path = tmp_path_factory.mktemp("tum") / "t.txt"
    write_tum(path, found, stamps)
    back = read_tum(path)
    assert list(back) == list(stamps.values())
    for i, pose in found.items():
        np.testing.assert_allclose(back[stamps[i]], pose, atol=1e-14)


def test_a_broken_trajectory_names_its_line(tmp_path):
    (tmp_path / "t.txt").write_text("# time\n1.0 0 0 0 0 0 1\n")
    with pytest.raises(CaptureError, match=r"t.txt, line 2: expected a time and 7 numbers"):
        read_tum(tmp_path / "t.txt")


def test_the_truth_as_a_trajectory(capture, tmp_path):
    folder, truths = capture
    assert run("convert", folder, tmp_path / "t.txt", "--to", "tum", "--fps", "10") == 0
    back = read_tum(tmp_path / "t.txt")
    assert list(back) == [0, 300_000_000, 600_000_000]
    np.testing.assert_allclose(list(back.values()), truths, atol=1e-12)


def test_frames_a_second_beside_the_recordings_own_times_are_refused(capture, tmp_path, capsys):
    """They had done nothing, without a word."""
    manifest = json.loads((capture[0] / "capture.json").read_text())
    manifest["notes"] = {"stamps_ns": {"0": 0, "3": 5, "6": 9}}
    stamped = tmp_path / "stamped"
    shutil.copytree(capture[0], stamped)
    (stamped / "capture.json").write_text(json.dumps(manifest))
    line = refused(capsys, "convert", stamped, tmp_path / "t.tum", "--fps", "10")
    where = f"{stamped / 'capture.json'}, which has them (stamps_ns): leave it out"
    assert f"--fps: expected a recording without times, got {where}" in line
    assert not (tmp_path / "t.tum").exists()
    assert run("convert", stamped, tmp_path / "t.tum") == 0
    assert list(read_tum(tmp_path / "t.tum")) == [0, 5, 9]


@pytest.mark.parametrize("fps", ["1e-300", "1e-9", "1e10", "1e300"])
def test_frames_a_second_that_no_stamps_can_tell(capture, tmp_path, capsys, fps):
    line = refused(capsys, "convert", capture[0], tmp_path / "t.tum", "--fps", fps)
    assert "--fps: expected frames a second from 0.001 to 1e+09, got 1e" in line
    assert not (tmp_path / "t.tum").exists()


def test_the_poses_of_a_result(capture, tmp_path, capsys):
    folder, truths = capture
    moved = truths[1] @ poses.exp([0.1, 0, 0, 0, 0.01, 0])
    result = tmp_path / "r"
    result.mkdir()
    rows = [PoseRow(0, 3, 1, 0.5, moved, 0.1), PoseRow(0, 3, 1, 0.2, truths[1], 0.1)]
    write_poses(result / "poses.csv", rows)
    for where in (result, result / "poses.csv"):
        assert run("convert", folder, tmp_path / "t.tum", "--result", where) == 0
        (stamp, pose), *others = read_tum(tmp_path / "t.tum").items()
        assert (stamp, others) == (100_000_000, [])
        np.testing.assert_allclose(pose, moved, atol=1e-12)
    entry = {"frame": 6, "camera_from_object": moved.tolist(), "verdict": "ok"}
    (result / "result.json").write_text(json.dumps({"capture": "c", "frames": [entry]}))
    assert run("convert", folder, tmp_path / "t.tum", "--result", result) == 0
    assert list(read_tum(tmp_path / "t.tum")) == [200_000_000]
    # a result by itself finds its capture
    assert run("convert", result, tmp_path / "u.tum") == 0
    assert (tmp_path / "u.tum").read_text() == (tmp_path / "t.tum").read_text()
    capsys.readouterr()
    (result / "result.json").write_text(json.dumps({"frames": [entry | {"frame": 5}]}))
    argv = ("convert", folder, tmp_path / "t.tum", "--result", result)
    assert "got one without its frame 5" in refused(capsys, *argv)
    (result / "result.json").write_text("{}")
    assert "expected a result.json as estimate writes it" in refused(capsys, *argv)
    assert "expected result.json or poses.csv in it" in refused(capsys, *argv[:-1], tmp_path)


def test_glb_holds_object_cloud_and_contacts_where_they_are(capture, tmp_path):
    folder, truths = capture
    moved = truths[1] @ poses.exp([0, 0, 0, 0.01, 0, 0])
    write_poses(tmp_path / "poses.csv", [PoseRow(0, 3, 1, 1.0, moved, 0.1)])
    argv = ("convert", folder, tmp_path / "s.glb", "--result", tmp_path / "poses.csv")
    assert run(*argv) == 0
    scene = trimesh.load(tmp_path / "s.glb")
    assert {"object_000003", "truth_000003", "cloud", "contact_0", "contact_4"} <= set(scene.graph.nodes_geometry)
    upright = poses.make_pose(np.diag([1.0, -1.0, -1.0]))
    np.testing.assert_allclose(scene.graph["object_000003"][0], upright @ moved, atol=1e-6)
    np.testing.assert_allclose(scene.graph["truth_000003"][0], upright @ truths[1], atol=1e-6)
    size = np.ptp(np.array(scene.geometry["object"].vertices), axis=0)
    np.testing.assert_allclose(size, np.ptp(make("box").vertices, axis=0), atol=1e-6)
    # the cloud lies on the object at its truth
    cloud = np.array(scene.geometry["cloud"].vertices)
    inside = poses.apply(poses.inverse(upright @ truths[1]), cloud)
    assert np.abs(make("box").field.distance(inside)).max() < 1e-3


def test_glb_with_a_hand(lab_frame, drill, hand, tmp_path):
    frame = replace(lab_frame, index=0)
    write_capture(tmp_path / "c", [frame], drill, hand, world="robot base")
    assert run("convert", tmp_path / "c", tmp_path / "s", "--to", "glb") == 0
    scene = trimesh.load(tmp_path / "s", file_type="glb")
    upright = poses.make_pose(poses.exp_rotation([-np.pi / 2, 0, 0]))
    np.testing.assert_allclose(scene.graph["hand"][0], upright @ frame.world_from_hand, atol=1e-6)
    vertices = hand.mesh(frame.joints)[0]
    bounds = [vertices.min(axis=0), vertices.max(axis=0)]
    np.testing.assert_allclose(scene.geometry["hand"].bounds, bounds, atol=1e-6)
    assert len(scene.geometry["cloud"].vertices) <= 50_000


def test_bad_use(capture, tmp_path, capsys):
    folder, _ = capture
    for argv, message in (
        (("convert", folder, tmp_path / "x", "--to", "fbx"), "--to: expected one of bop, glb, tum, off, got 'fbx'"),
        (("convert", folder, tmp_path / "x", "--from", "csv"), "--from: expected one of bop, ycbineoat, ros"),
        (("convert", folder, tmp_path / "x", "--to", "glb", "--frame", 1), "expected a frame of"),
        (("convert", folder, tmp_path / "x", "--to", "tum", "--result", tmp_path / "no"), "no"),
        (("convert", folder, tmp_path, "--to", "bop"), "expected a new or empty folder to write to"),
    ):
        assert message in refused(capsys, *argv), argv
    (folder / "scene_gt.json").unlink()
    assert "expected ground truth or --result" in refused(capsys, "convert", folder, tmp_path / "x", "--to", "tum")


def test_the_help_lists_the_formats(capsys):
    with pytest.raises(SystemExit):
        run("convert", "--help")
    text = capsys.readouterr().out
    for name in ("bop", "ycbineoat", "ros", "tacman", "handover", "images", "glb", "tum"):
        assert f"{name} (" in " ".join(text.split())
