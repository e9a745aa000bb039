"""`palpate track` writes as it goes: it is killed, stopped and damaged, and its files are what they would have been."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from commands import refused, run
from long_recordings import there_and_back

from fusion.results.files import read_covariances, read_result
from fusion.results.track import summary
from fusion.results.track.checkpoints import CHECKPOINT, Checkpoint
from fusion.results.track.files import FRAMES, POSES, TIMES
from scenes.recordings.bop import read_poses

FRAMES_MADE = 26
SAME = (POSES, FRAMES)


@pytest.fixture(scope="module")
def capture(tmp_path_factory, hand):
    return there_and_back(tmp_path_factory.mktemp("c") / "carried", hand, FRAMES_MADE, made=6)


@pytest.fixture(scope="module")
def whole(capture, tmp_path_factory):
    """The folder of a track that nothing stopped."""
    out = tmp_path_factory.mktemp("whole")
    assert run("track", capture, "--out", out, "--no-report") == 0
    return out


def start(capture, out, *more):
    words = [sys.executable, "-m", "fusion.cli.main", "track", capture, "--out", out, "--no-report", *more]
    # every frame waits a little, so that there is a middle to be stopped in
    return subprocess.Popen([str(w) for w in words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for(path, count, process):
    """Until the file has so many lines."""
    end = time.monotonic() + 120
    while time.monotonic() < end and process.poll() is None:
        if path.is_file() and path.read_bytes().count(b"\n") >= count:
            return
        time.sleep(0.002)
    raise AssertionError(process.communicate())


def test_a_killed_track_goes_on_to_the_byte(capture, whole, tmp_path):
    out = tmp_path / "killed"
    process = start(capture, out, "--checkpoint", "0.1")
    wait_for(out / FRAMES, 7, process)
    process.send_signal(signal.SIGKILL)
    process.wait()
    left = (out / FRAMES).read_bytes()
    assert left.endswith(b"\n")
    assert (whole / FRAMES).read_bytes().startswith(left)
    assert not (out / "result.json").exists()
    done = Checkpoint.read(out).done
    assert 1 <= done < FRAMES_MADE
    with (out / FRAMES).open("ab") as file:  # as of a machine that lost power in the middle of a line
        file.write(b'{"frame": 99, "verd')
    assert run("track", capture, "--out", out, "--no-report", "--resume") == 0
    for name in SAME:
        assert (out / name).read_bytes() == (whole / name).read_bytes(), name
    assert (out / TIMES).read_bytes().count(b"\n") == FRAMES_MADE
    entries = [json.loads((folder / "result.json").read_text())["frames"] for folder in (out, whole)]
    assert [e["frame"] for e in entries[0]] == [e["frame"] for e in entries[1]]


def test_ctrl_c_keeps_what_is_done_and_says_how_to_go_on(capture, whole, tmp_path):
    out = tmp_path / "stopped"
    process = start(capture, out)
    wait_for(out / FRAMES, 4, process)
    process.send_signal(signal.SIGINT)
    said, told = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in told
    assert f"--out {out} --no-report --resume" in told
    content = json.loads((out / "result.json").read_text())
    done = content["track"]["frames_answered"]
    assert 4 <= done < FRAMES_MADE
    assert content["track"]["complete"] is False
    assert f"interrupted after {done} of {FRAMES_MADE} frames" in told
    assert f"{done} frames: 1 started" in said
    assert len(read_poses(out / POSES)) == len(content["frames"]) == done
    assert run("track", capture, "--out", out, "--no-report", "--resume") == 0
    for name in SAME:
        assert (out / name).read_bytes() == (whole / name).read_bytes(), name
    assert run("track", capture, "--out", out, "--no-report", "--resume") == 0  # nothing is left: the same once more
    assert (out / POSES).read_bytes() == (whole / POSES).read_bytes()


def test_another_question_is_not_a_resumption(capture, whole, tmp_path, capsys):
    import shutil

    out = tmp_path / "copy"
    shutil.copytree(whole, out)
    ask = ("track", capture, "--out", out, "--no-report", "--resume")
    assert "expected seed 0, as the track began, got 5" in refused(capsys, *ask, "--seed", 5)
    assert "expected senses vision,touch, as the track began, got vision" in refused(capsys, *ask, "--use", "vision")
    assert "expected object " in refused(capsys, *ask, "--object", "mug")
    (out / POSES).write_bytes((out / POSES).read_bytes()[:100])
    assert "that the track had written, got 100" in refused(capsys, *ask)
    (out / CHECKPOINT).write_bytes(b"nothing")
    assert "expected a track's checkpoint" in refused(capsys, *ask)
    assert (whole / POSES).read_bytes().startswith((out / POSES).read_bytes())


def test_a_recording_that_has_grown_is_gone_on_with(capture, whole, tmp_path, hand):
    import shutil

    short = tmp_path / capture.name
    there_and_back(short, hand, 9, made=6)
    out = tmp_path / "out"
    assert run("track", short, "--out", out, "--no-report") == 0
    shutil.rmtree(short)
    shutil.copytree(capture, short)
    assert run("track", short, "--out", out, "--no-report", "--resume") == 0
    for name in SAME:
        assert (out / name).read_bytes() == (whole / name).read_bytes(), name


@pytest.mark.parametrize("changed", [0, FRAMES_MADE - 1])
def test_another_recording_of_the_same_name_is_not_gone_on_with(capture, whole, tmp_path, capsys, changed):
    """One frame tells: of a recording that begins alike, or ends alike."""
    import shutil

    out, other = tmp_path / "out", tmp_path / capture.name
    shutil.copytree(whole, out)
    shutil.copytree(capture, other)
    shutil.copy(capture / "depth" / "000003.png", other / "depth" / f"{changed:06d}.png")
    said = refused(capsys, "track", other, "--out", out, "--no-report", "--resume")
    assert f"expected frame {changed} to show what it showed to the track, got other readings" in said
    assert (out / POSES).read_bytes() == (whole / POSES).read_bytes()


def test_a_recording_that_was_moved_is_gone_on_with(capture, whole, tmp_path):
    """Under another name, and with its truth told anew."""
    import shutil

    out, moved = tmp_path / "out", tmp_path / "elsewhere" / "renamed"
    shutil.copytree(whole, out)
    shutil.copytree(capture, moved)
    (moved / "scene_gt.json").unlink()
    assert run("track", moved, "--out", out, "--no-report", "--resume") == 0
    assert (out / POSES).read_bytes() == (whole / POSES).read_bytes()


def test_a_broken_file_in_the_middle_is_said_and_done_without(capture, tmp_path, capsys):
    import shutil

    broken = tmp_path / "broken"
    shutil.copytree(capture, broken)
    (broken / "depth" / "000004.png").write_bytes(b"no picture")
    (broken / "depth" / "000006.png").unlink()
    out = tmp_path / "out"
    assert run("track", broken, "--out", out, "--no-report") == 0
    told = capsys.readouterr().err
    assert "frame 4 is tracked without what is broken" in told
    assert "000006.png, frame 6: expected a depth image, found none" in told
    frames = json.loads((out / "result.json").read_text())["frames"]
    assert [f["frame"] for f in frames] == list(range(FRAMES_MADE))
    assert any("000004.png" in note for note in frames[4]["notes"])
    assert not any(stage["rows"] for stage in frames[4]["trace"] if stage["stage"] == "look")
    (broken / "depth" / "000000.png").write_bytes(b"no picture")  # what a track begins with must be whole
    assert "000000.png" in refused(capsys, "track", broken, "--out", out, "--no-report")


def test_a_frame_that_cannot_be_used_at_all_is_left_out(capture, tmp_path, capsys):
    import shutil

    broken = tmp_path / "broken"
    shutil.copytree(capture, broken)
    cameras = json.loads((broken / "scene_camera.json").read_text())
    cameras["5"]["cam_K"] = [14000.0, 0, 79.5, 0, 14000.0, 59.5, 0, 0, 1]
    (broken / "scene_camera.json").write_text(json.dumps(cameras))
    code = run("track", broken, "--out", tmp_path / "out", "--no-report")
    said = capsys.readouterr()
    assert code == 0
    content = json.loads((tmp_path / "out" / "result.json").read_text())
    answered = {f["frame"]: f for f in content["frames"]}
    # the hand and its contacts may have it, and be right; the picture is not looked at, and that is said
    assert any("its image is not looked at: focal lengths of 14000" in note for note in answered[5]["notes"]), said.err
    assert not any(stage["rows"] for stage in answered[5]["trace"] if stage["stage"] == "look")
    assert answered[5]["verdict"] != "ok" or answered[5]["errors"]["add_s_mm"] < 5.0
    assert not any("focal" in note for index, f in answered.items() if index != 5 for note in f["notes"])


def test_times_are_apart_and_a_short_track_has_them_in_its_result(whole):
    assert all(row.time == -1.0 for row in read_poses(whole / POSES))
    assert "_ms" not in (whole / FRAMES).read_text().replace("pixel_rms_mm", "").replace("time_ms", "X")
    content = json.loads((whole / "result.json").read_text())
    assert all(f["time_ms"] > 0 and all("ms" in stage for stage in f["trace"]) for f in content["frames"])
    assert set(content["track"]["step_ms"]) == {"p50", "p90", "p99", "max"}
    assert content["track"]["latency_ms"]["p50"] is None
    assert len(content["frames"][-1]["next_touch"]) > 0


def test_a_long_track_names_the_file_of_its_frames(capture, whole, tmp_path, monkeypatch):
    monkeypatch.setattr(summary, "MOST_IN_RESULT", 10)
    out, copy = tmp_path / "out", tmp_path / "elsewhere" / "t.json"
    assert run("track", capture, "--out", out, "--no-report", "--json", copy) == 0
    for path in (out / "result.json", copy):
        content, answers = read_result(path)
        assert content["frames"] == []
        assert content["errors"]["frames_with_truth"] == FRAMES_MADE
        short = read_result(whole / "result.json")[1]
        assert [a.frame for a in answers] == [a.frame for a in short]
        assert all(np.array_equal(a.pose, b.pose) for a, b in zip(answers, short))
        assert sorted(read_covariances(path)) == [a.frame for a in short]
    assert (out / "result.json").stat().st_size < 5_000


def memory_mb():
    with open("/proc/self/status", encoding="ascii") as file:
        return int(next(line for line in file if line.startswith("VmRSS")).split()[1]) / 1024


@pytest.mark.skipif(not os.path.exists("/proc/self/status"), reason="memory is read where Linux tells it")
@pytest.mark.parametrize("count", [120, pytest.param(5000, marks=pytest.mark.slow)])
def test_memory_is_flat(count, tmp_path, hand, monkeypatch):
    from fusion.results.track.running import TrackRun

    folder = there_and_back(tmp_path / "long", hand, count, made=6, rgb=True)
    seen = {}
    step = TrackRun._step

    def measured(self, *args):
        done = step(self, *args)
        if self.done % 20 == 0:
            seen[self.done] = memory_mb()
        return done

    monkeypatch.setattr(TrackRun, "_step", measured)
    assert run("track", folder, "--out", tmp_path / "out") == 0
    grown = seen[count] - seen[40]
    assert grown < 4.0 + 0.002 * count, seen  # an hour: below 220 MB more
