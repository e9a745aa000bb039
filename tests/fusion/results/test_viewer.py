"""The live view: a server that starts on a free port, shows what there is, and stops."""

import builtins
import json
import shutil
import socket
import urllib.request
from dataclasses import replace

import numpy as np
import pytest
from made_frames import plain_view

from fusion.cli.main import main
from fusion.estimation.answer import Estimate, Mode
from fusion.results.viewer import SIGMAS, ellipsoid
from scenes.geometry import poses
from scenes.recordings.captures import read_capture, write_capture
from scenes.synthesis.library import make

SMALL = np.diag([1e-3] * 3 + [1e-6, 4e-6, 9e-6])


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    folder = tmp_path_factory.mktemp("view") / "box"
    return write_capture(folder, [replace(plain_view(seed=i), index=i) for i in range(2)], make("box"))


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def test_it_serves_what_there_is_and_stops(capture):
    pytest.importorskip("viser")
    from fusion.results.viewer import FIELD, Viewer

    recorded = read_capture(capture)
    truth = recorded[0].camera_from_object_truth
    modes = (Mode(truth, 0.7, 0.0, SMALL), Mode(truth @ poses.exp([0, 0, 1, 0, 0, 0]), 0.3, 1.0, SMALL))
    viewer = Viewer(recorded, recorded.model, [Estimate(0, truth, SMALL, modes, "ambiguous")], free_port())
    try:
        with urllib.request.urlopen(viewer.url, timeout=20) as answer:
            assert answer.status == 200
        assert {"cloud", "object", "truth", "contacts", "modes/1", "ellipsoid"} <= set(viewer.shown)
        assert viewer.shown["object"].visible
        assert not viewer.shown["truth"].visible
        np.testing.assert_allclose(viewer.shown["object"].position, truth[:3, 3], atol=1e-6)
        middle, radius = viewer._framed
        corners = poses.apply(truth, recorded.model.vertices) - middle
        assert np.linalg.norm(corners, axis=1).max() <= radius * (1 + 1e-9)
        for aspect in (0.46, 1.55):  # a phone upright, a desktop: the object fills the window, and is inside
            eye = viewer._eye(FIELD, aspect)
            forward = (middle - eye) / np.linalg.norm(middle - eye)
            right = np.cross(forward, [0.0, -1.0, 0.0])
            right /= np.linalg.norm(right)
            up = np.cross(right, forward)
            seen = corners + middle - eye
            high = np.abs(seen @ up / (seen @ forward)) / np.tan(FIELD / 2)
            wide = np.abs(seen @ right / (seen @ forward)) / np.tan(FIELD / 2) / aspect
            assert 0.3 < max(high.max(), wide.max()) < 1.0
        viewer.toggles["object"].value = False
        viewer._apply_toggles()
        assert not viewer.shown["object"].visible
        assert "ambiguous" in viewer.words.content
        viewer.show(1)
        assert "object" not in viewer.shown
        assert "no answer" in viewer.words.content
    finally:
        url = viewer.url
        viewer.stop()
    with pytest.raises(OSError):
        urllib.request.urlopen(url, timeout=2)


def test_broken_frames_are_shown_without_what_is_broken(capture, tmp_path):
    pytest.importorskip("viser")
    from fusion.results.viewer import Viewer

    broken = tmp_path / "broken"
    shutil.copytree(capture, broken)
    for number in range(2):
        (broken / "depth" / f"{number:06d}.png").write_bytes(b"none")
    cameras = json.loads((broken / "scene_camera.json").read_text())
    recorded, told = read_capture(broken), []
    viewer = Viewer(recorded, recorded.model, (), free_port(), told.append)
    try:
        assert "contacts" in viewer.shown
        assert "cloud" not in viewer.shown
        viewer.slider.value = 1  # as in the browser, on a thread of the server's
        viewer.slider.value = 0
        viewer.slider.value = 1
        assert "frame 1: no answer" in viewer.words.content
        lines = [f"{broken / 'depth' / f'{n:06d}.png'}, frame {n}: expected a PNG image" for n in range(2)]
        assert lines[1] in viewer.words.content
        assert len(told) == 2
        assert all(line.startswith(start) for line, start in zip(told, lines))
        cameras["0"]["cam_K"] = "none"
        (broken / "scene_camera.json").write_text(json.dumps(cameras))  # another file than the one that was opened
        viewer.slider.value = 0
        assert "scene_camera.json" in viewer.words.content
    finally:
        viewer.stop()


def test_the_ellipsoid_has_the_covariances_axes():
    vertices, _ = ellipsoid(SMALL[3:, 3:])
    np.testing.assert_allclose(vertices.max(axis=0), SIGMAS * np.array([1e-3, 2e-3, 3e-3]), rtol=0.01)


def test_without_viser_one_line_names_the_extra(capture, capsys, monkeypatch):
    real = builtins.__import__

    def without(name, *args, **options):
        if name == "viser":
            raise ImportError(name)
        return real(name, *args, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    assert main(["view", str(capture), "--no-browser"]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "palpate[viewer]" in err


def test_bad_use_is_one_line(capture, tmp_path, capsys):
    for argv in ([str(tmp_path)], [str(capture), str(tmp_path)], [str(capture), "--port", "99999"]):
        assert main(["view", *argv, "--no-browser"]) == 2
        assert capsys.readouterr().err.count("\n") == 1
