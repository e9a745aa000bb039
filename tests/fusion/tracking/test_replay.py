"""Real time without waiting for it: which frames come, which are passed over, and how late answers are."""

import numpy as np
import pytest
from commands import refused, run
from long_recordings import there_and_back

from fusion.results.track.replay import InTurn, RealTime


class Clock:
    """Seconds that pass when somebody works or sleeps."""

    def __init__(self):
        self.now = 100.0
        self.slept = []

    def __call__(self):
        return self.now

    def sleep(self, seconds):
        self.slept.append(seconds)
        self.now += seconds


def replayed(costs, numbers, hertz=10.0, first=0, reading=0.0):
    """(frame, passed over, latency in ms) of each frame worked on; costs: seconds of work by frame."""
    clock, out = Clock(), []
    pace = RealTime(numbers, hertz, first, clock, clock.sleep)
    for one in pace:
        with pace.stopped():
            clock.now += reading
        clock.now += costs.get(numbers[one.position], 0.01)
        passed = [numbers[i] for i in one.behind]
        out.append((numbers[one.position], passed, round(1e3 * pace.latency(one.due), 6)))
    return out, clock


def test_who_is_quick_misses_nothing_and_waits_for_the_camera():
    seen, clock = replayed({}, range(5))
    assert seen == [(i, [], pytest.approx(10.0)) for i in range(5)]
    assert clock.slept == pytest.approx([0.09] * 4)


def test_who_is_slow_takes_the_newest():
    seen, _ = replayed({0: 0.35, 3: 0.12, 4: 0.12}, range(8))
    # while frame 0 took 350 ms, frames 1 to 3 came; frame 3 was then 50 ms old
    assert seen[0] == (0, [], pytest.approx(350.0))
    assert seen[1] == (3, [1, 2], pytest.approx(170.0))
    assert seen[2] == (4, [], pytest.approx(190.0))
    assert [frame for frame, _, _ in seen] == [0, 3, 4, 5, 6, 7]


def test_the_last_frames_of_a_recording_are_not_waited_for_twice():
    seen, _ = replayed({1: 5.0}, range(6))
    assert seen[-1] == (5, [2, 3, 4], pytest.approx(1e3 * (5.1 - 0.5 + 0.01)))
    every = [frame for number, passed, _ in seen for frame in (*passed, number)]
    assert every == list(range(6))


def test_gaps_in_a_recording_are_gaps_in_time():
    seen, clock = replayed({}, [3, 4, 14, 15])
    assert [frame for frame, _, _ in seen] == [3, 4, 14, 15]
    assert clock.slept == pytest.approx([0.09, 0.99, 0.09])


def test_reading_files_takes_no_time():
    seen, _ = replayed({}, range(5), reading=3.0)
    assert seen == [(i, [], pytest.approx(10.0)) for i in range(5)]


def test_it_goes_on_in_the_middle():
    seen, _ = replayed({}, range(9), first=6)
    assert [frame for frame, _, _ in seen] == [6, 7, 8]
    assert [one.position for one in InTurn(range(9), 7)] == [7, 8]
    assert list(RealTime([], 30.0)) == []


def test_the_command_tells_latencies_and_what_was_left_out(tmp_path, hand, capsys, monkeypatch):
    import json

    from fusion.results.track.running import TrackRun
    from fusion.tracking.tracker import Tracker

    folder = there_and_back(tmp_path / "c", hand, 12, made=4)
    clock = Clock()
    step = Tracker.step

    def slow(self, frame):
        clock.now += 0.25 if frame.index == 4 else 0.02
        return step(self, frame)

    monkeypatch.setattr(Tracker, "step", slow)
    monkeypatch.setattr("fusion.results.track.running.RealTime", lambda n, h, f: RealTime(n, h, f, clock, clock.sleep))
    monkeypatch.setattr(TrackRun, "_look_before", lambda self, in_real_time: None)
    out = tmp_path / "out"
    assert run("track", folder, "--out", out, "--no-report", "--realtime", 10) == 0
    content = json.loads((out / "result.json").read_text())
    assert content["track"]["hertz"] == 10.0
    assert content["track"]["frames_skipped"] == {"behind": 1, "unreadable": 0}
    assert [f["frame"] for f in content["frames"]] == [0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11]
    late = content["track"]["latency_ms"]
    assert late["p50"] == pytest.approx(20.0, abs=0.01)
    assert late["max"] == pytest.approx(250.0, abs=0.01)
    said = capsys.readouterr().out
    assert "1 left out (behind)" in said
    assert "ms from a frame's arrival at 10 Hz to its answer: p50 20.0, p90" in said
    assert np.isfinite([f["camera_from_object"] for f in content["frames"]]).all()
    assert "expected a number above 0" in refused(capsys, "track", folder, "--realtime", "0")


@pytest.mark.parametrize("hertz", [1e-300, 5e-324, 1e-9])
def test_a_replay_of_years_is_refused(hertz):
    from scenes.errors import InputError

    with pytest.raises(InputError, match=r"realtime: expected so many frames a second .*, got "):
        RealTime([3, 4, 2**62], hertz)
    assert len(list(RealTime([7], hertz, 0))) == 1
