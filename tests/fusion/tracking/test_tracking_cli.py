"""`palpate track` on a short sequence, and the benchmark's bookkeeping."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from commands import refused

from fusion.benchmarks.tracking.methods import Said
from fusion.benchmarks.tracking.tally import Tally, count_slips, losses
from fusion.cli.main import main
from scenes.geometry import poses
from scenes.synthesis import library
from scenes.synthesis.recording import SynthesisSettings, synthesize


@pytest.fixture(scope="module")
def capture(tmp_path_factory, hand):
    folder = tmp_path_factory.mktemp("track") / "cylinder"
    settings = SynthesisSettings(rgb=False)
    synthesize(folder, library.make("cylinder"), hand, 3, 0.4, noise="clean", seed=7, motion="carry", settings=settings)
    return folder


def test_track_writes_what_estimate_writes(capture, tmp_path, capsys):
    out = tmp_path / "out"
    code = main(["track", str(capture), "--out", str(out), "--json", str(tmp_path / "t.json")])
    assert code == 0
    growing = {"poses.csv", "result.jsonl", "times.jsonl", "track.checkpoint"}
    assert {p.name for p in out.iterdir()} == {*growing, "result.json", "report.html", "report"}
    content = json.loads((tmp_path / "t.json").read_text())
    assert [f["frame"] for f in content["frames"]] == [0, 1, 2]
    assert [f["tracking"]["how"] for f in content["frames"]] == ["started", "tracked", "tracked"]
    assert all(f["tracking"]["slip"] is False for f in content["frames"])
    assert content["errors"]["success_add_s_below_5mm"] == 1.0
    assert (out / "poses.csv").read_text().startswith("scene_id,im_id,obj_id,score,R,t,time")
    shown = capsys.readouterr().out
    assert "3 frames: 1 started, 2 tracked" in shown


def test_track_refuses_what_is_no_capture_and_unknown_senses(capture, tmp_path, capsys):
    assert main(["track", str(tmp_path / "nothing")]) == 2
    assert main(["track", str(capture), "--use", "smell"]) == 2
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 2
    assert all(line.startswith("palpate: ") for line in errors)


def test_two_tracks_into_one_folder_are_refused(capture, tmp_path, capsys):
    """The second at once, and the first ends as if it had been alone."""
    from fusion.results.track.running import TrackRun
    from fusion.tracking.tracker import Tracker
    from scenes.recordings.captures import read_capture

    out, read = tmp_path / "out", read_capture(capture)
    model = read.model
    with TrackRun(read, model, out, lambda: Tracker(model), lambda frame, model: frame, {}) as first:
        steps = first.steps()
        next(steps)
        for more in ([], ["--resume"]):
            assert "expected a folder for one track, found one at work" in refused(
                capsys, "track", capture, "--out", out, *more
            )
        assert len(list(steps)) == 2
    assert [json.loads(line)["frame"] for line in (out / "times.jsonl").read_text().splitlines()] == [0, 1, 2]
    assert main(["track", str(capture), "--out", str(out), "--no-report", "-q"]) == 0


def test_slips_are_counted_once_and_alarms_by_their_beginning():
    model = library.make("mug")

    def frame(turn):
        pose = poses.make_pose(poses.exp_rotation([turn, 0.0, 0.0]))
        return SimpleNamespace(world_from_hand=np.eye(4), camera_from_object_truth=pose)

    frames = [frame(0.1 * min(max(i - 10, 0), 3)) for i in range(40)]
    said = [Said(np.eye(4), slip=i in (12, 13, 25, 26, 33), moved=i == 11) for i in range(40)]
    tally = Tally()
    count_slips(tally, model, frames, said, {"slips": [{"first": 11, "last": 13}]})
    assert (tally.slips, tally.hits, tally.alarms, tally.steady) == (1, 1, 2, 40 - 6)
    assert (tally.moved_hits, tally.moved_alarms) == (1, 0)


def test_losses_are_counted_when_they_end():
    assert losses([0.001, 0.02, 0.03, 0.002, 0.02]) == [2]
    assert losses([0.001]) == []


@pytest.mark.parametrize("asked", ["none", "gt", "FILE", None])
def test_a_prior_holds_until_the_track_has_begun(capture, tmp_path, monkeypatch, asked):
    """The first frame is lost; the capture's own prior of the second is not what was asked for."""
    import shutil
    from dataclasses import replace

    from fusion.tracking import tracker
    from scenes.recordings.captures import read_capture

    folder, file = tmp_path / "c", tmp_path / "first.json"
    shutil.copytree(capture, folder)
    truths = [frame.camera_from_object_truth for frame in read_capture(folder)]
    own = poses.make_pose(translation=[0.01, 0.0, 0.0]) @ truths[1]
    (folder / "prior.json").write_text(json.dumps({i: own.tolist() for i in range(3)}))
    file.write_text(json.dumps({0: truths[0].tolist()}))
    seen, usual = [], tracker.estimate

    def noted(frame, *args, **named):
        seen.append(frame.prior)
        answer = usual(frame, *args, **named)
        return replace(answer, verdict="lost") if frame.index == 0 else answer

    monkeypatch.setattr(tracker, "estimate", noted)
    prior = [] if asked is None else ["--prior", str(file) if asked == "FILE" else asked]
    assert main(["track", str(folder), "--out", str(tmp_path / "o"), "--no-report", "-q", *prior]) in (0, 1)
    first = {"none": None, "gt": truths[0], "FILE": truths[0], None: own}[asked]
    then = {"none": None, "gt": truths[1], "FILE": None, None: own}[asked]
    for found, expected in zip(seen, (first, then)):
        assert (found is None) is (expected is None)
        assert expected is None or np.allclose(found, expected, atol=1e-6)
