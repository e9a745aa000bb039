"""`--config`: what is printed reads back, what has no place is refused; and how loud a command is."""

from __future__ import annotations

import json
import logging
import re
from dataclasses import dataclass, field, fields, is_dataclass, replace

import pytest
from commands import refused, run
from made_frames import plain_view

from fusion.cli.config import CommandConfig, read_config, to_toml
from fusion.cli.main import main
from scenes.errors import InputError
from scenes.files.merged import merged
from scenes.recordings.captures import write_capture
from scenes.recordings.depth_cameras import DEPTH_CAMERAS
from scenes.synthesis.library import make


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return write_capture(tmp_path_factory.mktemp("captures") / "plain", [plain_view()], make("box"))


@dataclass(frozen=True)
class Leaf:
    size: float = 1.0
    count: int = 3
    name: str = "a"
    on: bool = True


@dataclass(frozen=True)
class Tree:
    pair: tuple[float, float] = (0.5, float("inf"))
    leaves: tuple[Leaf, ...] = (Leaf(), Leaf(2.0))
    leaf: Leaf = field(default_factory=Leaf)
    maybe: Leaf | None = field(default_factory=Leaf)


def written(tmp_path, text: str):
    path = tmp_path / "c.toml"
    path.write_text(text)
    return path


def test_what_is_printed_reads_back(tmp_path):
    defaults = CommandConfig.defaults()
    assert read_config(written(tmp_path, to_toml(defaults))) == defaults
    other = replace(
        defaults,
        estimate=replace(
            defaults.estimate,
            patterns=None,
            proposals=replace(defaults.estimate.proposals, starts_near=7, blur_limits=(0.1, 0.2)),
        ),
    )
    again = read_config(written(tmp_path, to_toml(other)))
    assert again.estimate == other.estimate


def test_any_tree_of_settings_will_do():
    tree = merged(Tree(), {"leaves": [{"count": 5}], "leaf": {"size": 2}, "maybe": False, "pair": [1, 2]}, "f")
    assert tree == Tree((1.0, 2.0), (Leaf(count=5),), Leaf(2.0), None)
    assert isinstance(tree.leaf.size, float)


def test_the_first_frame_of_a_track_is_an_estimate(tmp_path):
    text = "[estimate.proposals]\nstarts_near = 100\n[track.first.look.rows]\nmost = 400\n"
    settings = read_config(written(tmp_path, text))
    assert settings.estimate.proposals.starts_near == settings.track.first.proposals.starts_near == 100
    assert (settings.estimate.look.rows.most, settings.track.first.look.rows.most) == (500, 400)


def test_beliefs_of_a_file_are_read(tmp_path):
    text = '[beliefs]\nmesh_sigma = 0.001\ncamera = "l515"\n[beliefs.depth]\nscale_sigma = 0.02\n'
    beliefs = read_config(written(tmp_path, text)).beliefs
    assert (beliefs.mesh_sigma, beliefs.depth.scale_sigma) == (0.001, 0.02)
    assert beliefs.depth.bias_sigma == DEPTH_CAMERAS["l515"].bias_sigma


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "[estimate.proposals]\nstart_near = 3",
            r"c.toml: estimate: proposals: .*got 'start_near': did you mean starts_near\?",
        ),
        ("[estimates]", "did you mean estimate"),
        ("[estimate.proposals]\nstarts_near = 3.5", "starts_near: expected a whole number, got 3.5"),
        ("[estimate.proposals]\nstarts_near = true", "starts_near: expected a whole number, got True"),
        ("[estimate.proposals]\nblur_share = 'wide'", "blur_share: expected a number, got 'wide'"),
        ("[estimate.proposals]\nblur_share = nan", "expected a number, got nan"),
        ("[estimate.proposals]\nblur_limits = [1.0]", "blur_limits: expected 2 values, got 1"),
        ("[estimate]\njoint = 3", "joint: expected a table of settings, got 3"),
        ("[estimate]\njoint = false", "joint: expected a table of settings, got False"),
        ("[estimate.joint]\nrigs = [{ levels = 1 }]", r"rigs\[0\]: .*did you mean level"),
        ("[estimate", "malformed"),
    ],
)
def test_what_has_no_place_is_refused(tmp_path, text, message):
    with pytest.raises(InputError, match=message) as error:
        read_config(written(tmp_path, text))
    assert "\n" not in str(error.value)


def test_commands_take_it(tmp_path, capsys, capture):
    assert "cannot be opened" in refused(capsys, "estimate", capture, "--config", tmp_path / "none.toml")
    with pytest.raises(SystemExit) as end:
        main(["track", "--config", str(written(tmp_path, "[track]\nlevel_frames = 5")), "--show-config"])
    assert end.value.code == 0
    printed = capsys.readouterr().out
    assert re.search(r"^\[track\]\n(.*\n)*?level_frames = 5$", printed, re.MULTILINE)
    # a gate that takes nothing in is a setting that one sees at work
    config = written(tmp_path, "[estimate.confidence]\nsure = 2.0")
    run("estimate", capture, "--out", tmp_path / "o", "--no-report", "--config", config)
    assert "ambiguous" in capsys.readouterr().out
    run("compare", capture, "--methods", "fused", "--config", config)
    assert "1 ambiguous" in capsys.readouterr().out


def test_every_setting_of_a_run_can_be_set(tmp_path):
    """One at a time, changed: what is read is what was written."""

    def changed(settings, name):
        value = getattr(settings, name)
        if isinstance(value, bool):
            return replace(settings, **{name: not value})
        return replace(settings, **{name: value + 1}) if isinstance(value, int | float) else settings

    defaults = CommandConfig.defaults()
    for part in fields(defaults.estimate):
        value = getattr(defaults.estimate, part.name)
        if is_dataclass(value):
            for leaf in fields(value):
                value = changed(value, leaf.name)
            other = replace(defaults.estimate, **{part.name: value})
        else:
            other = changed(defaults.estimate, part.name)
        text = to_toml(replace(defaults, estimate=other)).split("\n[track]")[0]
        assert read_config(written(tmp_path, text)).estimate == other, part.name


def test_the_pose_is_printed_and_quiet_is_quiet(tmp_path, capsys, capture):
    out = tmp_path / "o"
    assert run("estimate", capture, "--out", out, "--no-report") == 0
    printed = capsys.readouterr().out
    (entry,) = json.loads((out / "result.json").read_text())["frames"]
    place = [1e3 * row[3] for row in entry["camera_from_object"][:3]]
    assert f"position {place[0]:.2f} {place[1]:.2f} {place[2]:.2f} mm, rotation vector" in printed
    assert "camera_from_object (m): [[" in printed
    assert run("estimate", capture, "--out", out, "--no-report", "-q") == 0
    assert capsys.readouterr().out == ""
    assert run("estimate", capture, "--out", out, "--no-report", "-vv") == 0
    told = capsys.readouterr().err
    assert "frame 0: ok in" in told
    assert "search: " in told
    contacts = capture / "contacts.csv"
    run("localize", contacts, "--object", "box", "--trials", 2)
    assert "object in the contacts' frame, trial" in capsys.readouterr().out


def test_each_package_has_a_silent_logger():
    import fusion
    import scenes
    import touch
    import vision

    for package in (scenes, vision, touch, fusion):
        handlers = logging.getLogger(package.__name__).handlers
        assert any(isinstance(handler, logging.NullHandler | logging.StreamHandler) for handler in handlers)


def test_versions_and_the_doctor(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["--version"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("palpate ")
    assert any(re.fullmatch(r"  numpy \d+\..*", line) for line in lines)
    assert not any("not installed" in line for line in lines[1:])
    assert run("doctor", "--json", tmp_path / "d.json") == 0
    printed = capsys.readouterr().out
    assert printed.endswith("all is well\n")
    checks = json.loads((tmp_path / "d.json").read_text())["checks"]
    assert {"numpy", "OpenCV", "threads", "compiled kernels", "cache of lattices"} <= {c["what"] for c in checks}


@pytest.mark.parametrize(
    ("table", "line", "told"),
    [
        ("estimate.prediction", "hand_step = 0", "prediction: hand_step: expected whole pixels from 1, got 0"),
        ("estimate.contour.outline", "around = 0", "around: expected steps above 0, got 0"),
        ("estimate.confidence", "bluntest = -1.0", "bluntest: expected a finite number above 0, got -1"),
        ("estimate.confidence", "widest = -0.5", "widest: expected a finite number above 0, got -0.5"),
        ("estimate.confidence", "tolerance = 0", "confidence: tolerance: expected a finite number above 0, got 0"),
        ("estimate.modes", "most = 0", "modes: most: expected a finite number above 0, got 0"),
        ("estimate.joint", "modes = 0", "joint: modes: expected a finite number above 0, got 0"),
        ("estimate.joint", "spacing = 0.0", "joint: spacing: expected a finite number above 0, got 0"),
        ("estimate.joint", "rigs = []", "joint: rigs: expected one size of shared errors or more, got none"),
        ("estimate.joint", "rigs = [{level = -1.0, share = 0.5}]", "level: expected a finite number above 0, got -1"),
        ("estimate.look", "most_others = 0", "look: most_others: expected a finite number above 0, got 0"),
        ("estimate.joint", "spacing = 1e-320", "spacing: expected 0 or a number from 1e-12 to 1e+12 in size"),
        ("estimate.contour", "another = 1e308", "another: expected 0 or a number from 1e-12 to 1e+12 in size"),
    ],
)
def test_numbers_that_break_what_is_computed_are_refused(tmp_path, table, line, told):
    with pytest.raises(InputError, match=re.escape(told)):
        read_config(written(tmp_path, f"[{table}]\n{line}\n"))


@pytest.mark.parametrize("flags", [("--tolerance", "1e157,1"), ("--sure-within", "1e160"), ("--sure-within", "5000")])
def test_limits_that_hold_everything_are_refused(capture, tmp_path, capsys, flags):
    said = refused(capsys, "estimate", str(capture), "--out", str(tmp_path), "--no-report", "-q", *flags)
    assert "expected metres up to the object's diameter" in said


def test_a_result_without_modes_means_its_pose(capture, tmp_path, capsys):
    assert main(["estimate", str(capture), "--out", str(tmp_path), "--no-report", "-q"]) == 0
    content = json.loads((tmp_path / "result.json").read_text())
    content["frames"][0]["modes"] = []
    (tmp_path / "result.json").write_text(json.dumps(content))
    asked = ["grasp", str(tmp_path), "--capture", str(capture), "--out", str(tmp_path), "--no-report", "-q"]
    assert main(asked) == 0
    assert "expected a number from 0 to 100, got 1e+308" in refused(capsys, *asked, "--friction", "1e308")
    content["frames"][0]["covariance"] = None
    (tmp_path / "result.json").write_text(json.dumps(content))
    assert "expected covariances, found none of frame 0" in refused(capsys, *asked)
