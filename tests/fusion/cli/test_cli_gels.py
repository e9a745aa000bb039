"""Gels on the command line: calibrate, make, localize, and the benchmark's tables on a few trials."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from commands import refused, run

from fusion.benchmarks.gels import bench, slip
from fusion.benchmarks.printing.tables import BenchSettings, Report
from scenes.files.formats import images
from scenes.recordings.captures import read_capture
from scenes.robot.sensors import Sensor, write_sensors
from scenes.synthesis.gels import ball_presses, lit_digit
from touch.gels.skin.photometry import Photometry


@pytest.fixture(scope="module")
def presses(tmp_path_factory):
    """A folder of a DIGIT's presses of a ball and its background."""
    folder = tmp_path_factory.mktemp("ball")
    rng = np.random.default_rng(2)
    gel = lit_digit(rng)
    images.write_rgb(folder / "background.png", gel.background)
    for number, image in enumerate(ball_presses(gel, 0.004, 0.0008, 4, rng)):
        images.write_rgb(folder / f"press_{number}.png", image)
    return folder, gel


def test_a_gel_is_calibrated(presses, tmp_path, capsys):
    folder, gel = presses
    out = tmp_path / "calibration.json"
    assert run("calibrate-gel", folder, "--ball", "4", "--digit", "-o", out, "--json", tmp_path / "j.json") == 0
    assert "4 presses of a 4 mm ball" in capsys.readouterr().out
    content = json.loads(out.read_text())
    assert Photometry.from_json(content, "c").ball == pytest.approx(0.004)
    assert json.loads((tmp_path / "j.json").read_text())["presses"] == 4
    # by the sensors file it is the same
    write_sensors(tmp_path / "sensors.json", {"g": Sensor("g", "l", "gel", np.eye(4), gel=replace(gel, lamps=None))})
    again = tmp_path / "again.json"
    assert run("calibrate-gel", folder, "--ball", "4", "--sensors", tmp_path / "sensors.json", "-o", again) == 0
    np.testing.assert_allclose(json.loads(again.read_text())["by_normal"], content["by_normal"], rtol=0.1, atol=0.05)


def test_sensors_of_a_kind_are_calibrated_together(presses, tmp_path, capsys):
    """The mean of two files counts each sensor once; files of other images are refused."""
    folder, _ = presses
    one, two, three = (tmp_path / f"{name}.json" for name in ("one", "two", "three"))
    assert run("calibrate-gel", folder, "--ball", "4", "--digit", "-o", one) == 0
    first = Photometry.from_json(json.loads(one.read_text()), "one")
    other = replace(first, by_normal=first.by_normal + 0.3, presses=7, sensors=2)
    two.write_text(json.dumps(other.to_json()))
    assert run("calibrate-gel", folder, "--ball", "4", "--digit", "--with", two, "-o", three) == 0
    assert "the mean of 3 sensors" in capsys.readouterr().out
    mean = Photometry.from_json(json.loads(three.read_text()), "three")
    np.testing.assert_allclose(mean.by_normal, first.by_normal + 0.2, atol=1e-9)
    assert (mean.sensors, mean.presses) == (3, 11)
    two.write_text(json.dumps(replace(other, size=(24, 32)).to_json()))
    line = refused(capsys, "calibrate-gel", folder, "--ball", "4", "--digit", "--with", two, "-o", three)
    assert "expected several of one size of image, got 24x32 and 240x320" in line


def test_what_cannot_be_calibrated_is_one_line(presses, tmp_path, capsys):
    folder, _ = presses
    rest = ("--digit", "-o", tmp_path / "c.json")
    assert "ball of 2 mm or less" in refused(capsys, "calibrate-gel", folder, "--ball", "1", *rest)
    single = folder / "press_0.png"
    assert "expected the untouched skin" in refused(capsys, "calibrate-gel", single, "--ball", "4", *rest)
    line = refused(capsys, "calibrate-gel", folder, "--ball", "4", "-o", tmp_path / "c.json")
    assert "expected one of --sensors FILE, --mm-per-pixel MM and --digit" in line
    small = tmp_path / "small"
    small.mkdir()
    images.write_rgb(small / "background.png", np.full((320, 240, 3), 90, np.uint8))
    images.write_rgb(small / "press.png", np.full((32, 24, 3), 90, np.uint8))
    assert "expected an image of 240x320 pixels" in refused(capsys, "calibrate-gel", small, "--ball", "4", *rest)
    images.write_rgb(small / "press.png", np.full((320, 240, 3), 255, np.uint8))
    assert "one colour all over" in refused(capsys, "calibrate-gel", small, "--ball", "4", *rest)
    assert not (tmp_path / "c.json").exists()


def test_a_wrong_radius_is_noticed_beside_another_calibration(presses, tmp_path, capsys):
    folder, _ = presses
    rng = np.random.default_rng(21)
    other = lit_digit(rng)
    (tmp_path / "other").mkdir()
    images.write_rgb(tmp_path / "other" / "background.png", other.background)
    for number, image in enumerate(ball_presses(other, 0.004, 0.0008, 2, rng)):
        images.write_rgb(tmp_path / "other" / f"{number}.png", image)
    like = tmp_path / "like.json"
    assert run("calibrate-gel", folder, "--ball", "4", "--digit", "-o", like) == 0
    said = capsys.readouterr().out
    assert "(--like FILE, another finger's calibration, tells more)" in said
    assert "by its brightness the ball's radius is 4." in said
    assert "lamps then have 7" in said
    assert run("calibrate-gel", folder, "--ball", "5", "--digit", "-o", tmp_path / "doubted.json") == 0
    assert "5 mm is right only if no light but the lamps' reaches the skin" in capsys.readouterr().out
    rest = ("--digit", "--like", like, "-o", tmp_path / "c.json")
    line = refused(capsys, "calibrate-gel", tmp_path / "other", "--ball", "8", *rest)
    assert "expected presses of a 8 mm ball, got ones of" in line
    alone = refused(capsys, "calibrate-gel", tmp_path / "other", "--ball", "8", "--digit", "-o", tmp_path / "c.json")
    assert "by the presses' brightness, got 8 mm" in alone
    assert not (tmp_path / "c.json").exists()
    assert run("calibrate-gel", tmp_path / "other", "--ball", "4", *rest) == 0
    capsys.readouterr()
    for text in ("{", "[]", "[" * 100_000, '{"format": "x"}'):
        like.write_text(text)
        assert "expected a gel's calibration" in refused(capsys, "calibrate-gel", folder, "--ball", "4", *rest)
    like.unlink()
    assert "cannot be read" in refused(capsys, "calibrate-gel", folder, "--ball", "4", *rest)


def test_gels_are_made_and_localized(tmp_path, capsys):
    capture = tmp_path / "c"
    arguments = ("--object", "drill", "--occlusion", "0.5", "--touch", "gel,point", "--noise", "clean", "--seed", "3")
    assert run("synth", capture, *arguments) == 0
    frame = read_capture(capture)[0]
    assert len(frame.gels) == 5
    assert all(image.ndim == 3 for image in frame.gels.values())
    assert run("validate", capture) == 0
    capsys.readouterr()
    assert run("localize", capture, "--json", tmp_path / "j.json") == 0
    assert "world_from_object (m)" in capsys.readouterr().out
    found = json.loads((tmp_path / "j.json").read_text())
    assert found["method"] == "gels"
    assert found["trials"][0]["verdict"] in ("ok", "ambiguous")
    assert len(found["trials"][0]["all_modes"]) == found["trials"][0]["modes"]
    assert np.linalg.eigvalsh(found["trials"][0]["covariance"]).min() > 0.0
    capsys.readouterr()
    assert "its gels are used" in refused(capsys, "localize", capture, "--method", "icp")
    plain = tmp_path / "plain"
    assert run("synth", plain, "--object", "box", "--noise", "none") == 0
    capsys.readouterr()
    assert "expected gels' images in tactile/" in refused(capsys, "localize", plain)


def test_the_same_seed_makes_the_same_gels(tmp_path):
    from scenes.synthesis.hands import five_finger_hand
    from scenes.synthesis.library import make
    from scenes.synthesis.recording import synthesize_frames

    made = [synthesize_frames(make("box"), five_finger_hand(), 1, 0.3, ("gel", "point"), "lab", 5)[0] for _ in range(2)]
    for name, image in made[0].gels.items():
        np.testing.assert_array_equal(image, made[1].gels[name])
    # asking for gels changes nothing else
    without = synthesize_frames(make("box"), five_finger_hand(), 1, 0.3, ("point",), "lab", 5)[0]
    np.testing.assert_array_equal(without.depth, made[0].depth)
    np.testing.assert_array_equal(without.contacts.points, made[0].contacts.points)


def test_the_benchmark_fills_its_tables(monkeypatch):
    monkeypatch.setattr(bench, "OBJECTS", ("l_block",))
    report = Report("gel", "t", "one", 1)
    bench.add_presses(report, BenchSettings(trials=1, seed=1), 1)
    bench.add_calibration(report, BenchSettings(trials=2, seed=1))
    assert [len(table.rows) for table in report.tables] == [3, 3, 2]
    assert all(np.isfinite(claim.value) for claim in report.claims)


def test_slides_fill_their_table(monkeypatch):
    monkeypatch.setattr(slip, "OBJECTS", ("hammer",))
    report = Report("gel", "t", "one", 1)
    slip.add_slides(report, BenchSettings(trials=1, seed=1))
    assert [len(table.rows) for table in report.tables] == [1]
    assert all(np.isfinite(claim.value) for claim in report.claims)


def test_recorded_grasps_are_asked_for_by_their_folder(tmp_path, capsys):
    assert "expected folders of grasps" in refused(capsys, "bench", "gel", "--data", tmp_path)
