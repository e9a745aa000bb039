"""Commands do not write over what they read, nor one of their files over another."""

from __future__ import annotations

import pytest
from commands import refused, run
from made_frames import some_frame

from scenes.recordings.captures import write_capture
from scenes.synthesis.library import make


@pytest.fixture
def capture(tmp_path):
    return write_capture(tmp_path / "c", [some_frame(index) for index in range(2)], make("box"))


def content(folder):
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.mark.parametrize(
    ("argv", "option"),
    [
        (("convert", "c/contacts.csv", "c/contacts.csv", "--frame", 0), "OUT"),
        (("convert", "c/contacts.csv", "link.csv", "--frame", 0), "OUT"),
        (("convert", "c", "c/scene.glb"), "OUT"),
        (("convert", "c", "c"), "OUT"),
        (("convert", "c/contacts.csv", "p.off", "--frame", 0, "--json", "p.off"), "OUT"),
        (("estimate", "c", "--json", "c/capture.json"), "--json"),
        (("estimate", "c", "--out", "c", "--json", "c/capture.json"), "--json"),
        (("estimate", "c", "--json", "c/own.json"), "--json"),
        (("estimate", "c", "--out", "x", "--json", "x/poses.csv"), "--json"),
        (("estimate", "c", "--json", "out/c/result.json"), "--json"),
        (("estimate", "c", "--object", "m.ply", "--json", "m.ply"), "--json"),
        (("estimate", "c", "--prior", "c/prior.json", "--json", "c/prior.json"), "--json"),
        (("track", "c", "--config", "s.toml", "--json", "s.toml"), "--json"),
        (("batch", ".", "--json", "c/contacts.csv"), "--json"),
        (("validate", "c", "--json", "c/joints.csv"), "--json"),
        (("validate", "c/capture.json", "--json", "c/capture.json"), "--json"),
        (("compare", "c", "--plot", "a.svg", "--json", "a.svg"), "--plot"),
        (("model", "c", "-o", "c/models/obj_000001.ply", "--poses", "truth"), "--output"),
        (("localize", "c/contacts.csv", "--object", "m.ply", "--json", "c/contacts.csv"), "--json"),
        (("grasp", "r", "--json", "r/result.json"), "--json"),
        (("grasp", "r", "--json", "c/capture.json"), "--json"),
        (("evaluate", "r/poses.csv", "c", "--json", "r/result.json"), "--json"),
        (("calibrate-gel", "m.ply", "--ball", 4, "--digit", "--like", "k.json", "-o", "k.json"), "OUT"),
        (("fit-confidence", "--from", "a.jsonl", "--write", "a.jsonl"), "--write"),
        (("synth", "new", "--object", "box", "--json", "new/capture.json"), "--json"),
        (("identify", "c/contacts.csv", "--objects", "s", "--json", "s/m.ply"), "--json"),
        (("convert", "c/contacts.csv", "p.off", "--frame", 0, "--json", "s/scene_gt.json"), "--json"),
        (("calibrate-gel", "s", "--ball", 4, "--digit", "-o", "s/background.png"), "OUT"),
    ],
)
def test_what_is_read_or_written_already_is_refused(capture, tmp_path, monkeypatch, capsys, argv, option):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link.csv").symlink_to(capture / "contacts.csv")
    (tmp_path / "m.ply").write_bytes((capture / "models" / "obj_000001.ply").read_bytes())
    for name in ("s.toml", "k.json", "a.jsonl"):
        (tmp_path / name).write_text("")
    (tmp_path / "s").mkdir()
    for name in ("m.ply", "scene_gt.json", "background.png"):
        (tmp_path / "s" / name).write_text("")
    (tmp_path / "r").mkdir()
    (tmp_path / "r" / "poses.csv").write_text("")
    (tmp_path / "r" / "result.json").write_text(f'{{"frames": [], "capture_path": "{capture}"}}')
    before = content(tmp_path)
    assert refused(capsys, *argv).startswith(f"palpate: {option}: expected ")
    assert content(tmp_path) == before


def test_files_beside_the_capture_and_results_inside_it_are_written(capture, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = content(capture)
    assert run("validate", "c", "--json", "v.json") == 0
    assert run("validate", "c/capture.json", "--json", "v.json") == 0
    assert run("convert", "c/contacts.csv", "c/points.off", "--frame", 0, "--json", "v.json") == 0
    assert run("convert", "c/contacts.csv", "v.csv", "--frame", 0) == 0
    assert run("convert", "c", "c/bop", "--to", "bop", "--json", "c/bop/counts.json") == 0
    assert run("convert", "c", "v.glb", "--json", "v.json") == 0
    assert {path: bytes_of for path, bytes_of in content(capture).items() if path in before} == before
