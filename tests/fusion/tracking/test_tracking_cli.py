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
