"""The benchmark of tracks: sequences that share a grasp are what they are without, and every sequence is counted."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import recording

from fusion.benchmarks.printing.tables import BenchSettings, Rate
from fusion.benchmarks.tracking import failing, tables
from fusion.benchmarks.tracking.bench import _claims, run
from fusion.benchmarks.tracking.methods import METHODS, WRONG_STARTS
from fusion.benchmarks.tracking.sequences import recorded
from fusion.benchmarks.tracking.tally import Tally
from scenes.errors import InputError
from scenes.synthesis.grasping.hiding import MOST_DRAWS, Placement


def test_sequences_share_a_grasp_and_nothing_else():
    placement = Placement(5)
    one, other = (
        recorded("box", motion, 2, seed, None, placement=placement)[1] for motion, seed in (("turn", 6), ("carry", 7))
    )
    again = recorded("box", "carry", 2, 7, None, placement=Placement(5))[1]
    for a, b in zip(other, again, strict=True):
        np.testing.assert_array_equal(a.depth, b.depth)
        np.testing.assert_array_equal(a.contacts.points, b.contacts.points)
    np.testing.assert_allclose(one[0].camera_from_object_truth, other[0].camera_from_object_truth)
    # another robot
    assert not np.allclose(one[0].world_from_hand, other[0].world_from_hand, atol=1e-4)


def test_what_cannot_be_placed_is_refused_again_without_a_search():
    placement, asked = Placement(3), []

    def find(rng):
        asked.append(rng.random())
        raise InputError("no view hides as much")

    for _ in range(2):
        with pytest.raises(InputError, match="hides"):
            placement.placed(find)
    assert len(set(asked)) == len(asked) == MOST_DRAWS


def test_every_family_has_its_tables_and_a_wrong_beginning_its_row():
    asked = {"family": "clean", "objects": ("box",), "motions": ("carry", "turn"), "frames": 3}
    report = run(BenchSettings(trials=1, methods=("track begun off",), **asked))
    titles = [table.title for table in report.tables]
    assert titles[0].startswith("clean, carry")
    assert titles[1].startswith("clean, turn")
    assert {row[0] for row in report.tables[0].rows} == {"track", "track begun off"}
    (wrong,) = [table for table in report.tables if "begin wrong" in table.title]
    assert [row[:3] for row in wrong.rows] == [["clean", "20 deg, 35 mm off", 2]]
    assert any("no longer ok in 10" in claim.what for claim in report.claims)


def test_a_track_by_touch_alone_has_its_row():
    report = run(
        BenchSettings(
            trials=1, methods=("track by touch",), family="clean", objects=("box",), motions=("carry",), frames=3
        )
    )
    assert {row[0] for row in report.tables[0].rows} == {"track", "track by touch"}


def test_a_wrong_beginning_counts_frames_until_doubted_and_right():
    tally = Tally(doubted=[1, 11], righted=[30], never=1, add_s=[0.04, 0.04, 0.03], ok=[True, True, True])
    tally.end_errors, tally.still_wrong_ok = [0.001], 1
    table = tables.begun_wrong({("lab", "carry"): dict.fromkeys(WRONG_STARTS, tally)})
    assert table is not None
    row = table.rows[0]
    assert (row[3], row[5], row[7]) == (Rate(1, 2), Rate(1, 2), 1)
    assert row[8] == Rate(1, 1)
    assert tables.begun_wrong({("lab", "carry"): {method: Tally() for method in WRONG_STARTS}}) is None


def test_single_frames_are_asked_at_a_sequences_end_too(monkeypatch):
    """What a track ends with is held against the same frames alone."""
    from types import SimpleNamespace

    from fusion.benchmarks.tracking import methods
    from fusion.estimation import estimate as estimating

    said = SimpleNamespace(pose=np.eye(4), covariance=np.eye(6), verdict="ok")
    monkeypatch.setattr(estimating, "estimate", lambda *args, **how: said)
    step = methods.stepper("estimate", SimpleNamespace(centroid=np.zeros(3)), 0, 17)
    frames = [SimpleNamespace(index=i, camera_from_object_truth=np.eye(4)) for i in range(18)]
    asked = [frame.index for frame in frames if step(frame) is not None]
    assert asked == [0, 5, 10, 13, 14, 15, 16, 17]


def test_what_sequences_differ_by_stands_beside_their_mean():
    one = Tally(
        add_s=[0.001] * 4,
        ok=[True] * 4,
        nees=[1.0, 1.0, 2.0, 2.0],
        means=[1.0, 2.0],
        held=3,
        ends=[0.1],
        rotation=[0.1],
    )
    single = Tally(ends=[0.2], rotation=[0.4, 0.2])
    table = tables.by_motion({("lab", "slip"): {"track": one, "estimate": single}})
    row = dict(zip([column.name for column in table.columns], table.rows[0], strict=True))
    assert row["sequences"] == 2
    assert row["95 % regions hold"] == Rate(3, 4)
    assert row["NEES / dof, mean"] == pytest.approx(1.5)
    assert row["+-"] == pytest.approx(0.5)
    assert row["single frames there"] == pytest.approx(np.rad2deg(0.2))


def test_a_tracks_end_is_held_against_the_same_frames():
    """A median of all would compare one object's frames with another's."""
    tallies = {method: Tally() for method in METHODS}
    tallies["track"] = Tally(ends=[0.01, 0.02, 0.30], add_s=[0.001] * 3, ok=[True] * 3, nees=[1.0] * 3)
    tallies["estimate"] = Tally(ends=[0.015, 0.025, 0.29])
    (claim,) = [one for one in _claims({("lab", "slip"): tallies}, []) if "end of a slip" in one.what]
    assert claim.value == pytest.approx(np.rad2deg(0.005))


def test_a_tracked_frames_time_is_that_of_a_sequence_by_itself():
    """Sequences side by side share cores, caches and memory."""
    table = tables.alone_table(
        [("lab", "carry", Tally(cpu=[4.0, 6.0, 50.0], wall=[5.0, 7.0, 51.0])), ("d435", "turn", Tally())]
    )
    (row,) = [dict(zip([column.name for column in table.columns], row, strict=True)) for row in table.rows]
    assert (row["family"], row["frames"], row["processor ms"], row["mean"]) == ("lab", 3, 6.0, 20.0)
    tallies = {method: Tally() for method in METHODS}
    claim = _claims({("lab", "slip"): tallies}, [4.0, 6.0, 50.0])[0]
    assert (claim.what, claim.value) == ("a tracked frame, median processor ms, alone", 6.0)


def test_a_family_without_a_sequence_is_named_and_misses_no_demand():
    some = Tally(add_s=[0.001], ok=[True], nees=[1.0], means=[1.0])
    followed = {("lab", "slip"): some, ("aligned", "shake"): Tally()}
    tracked = {key: {method: Tally() for method in METHODS} | {"track": tally} for key, tally in followed.items()}
    assert [row[0] for row in tables.by_family(tracked).rows] == ["lab"]
    assert "aligned" in tables.by_family(tracked).note
    asked = [claim.what for claim in _claims(tracked, [1.0])]
    assert any("lab" in what for what in asked)
    assert any("slip" in what for what in asked)
    assert not any("aligned" in what or "shake" in what for what in asked)


def test_a_sensor_fails_in_some_frames_and_the_others_stay(drill):
    """Of each failure: frames in which it changes depth, contacts, or what the robot says of itself."""
    frames = [replace(one, joints={"finger": 0.1 * one.index}) for one in recording(drill, 14)]
    before = [one.depth.copy() for one in frames]

    def changed(name):
        out = failing.FAILURES[name](list(frames), 4, np.random.default_rng(0))
        parts = "depth", "contacts", "joints", "camera_from_world"
        told = {one.index: one for one in out}
        return {
            part: [n for n, one in enumerate(frames) if n in told and differs(part, one, told[n])] for part in parts
        }

    def differs(part, one, other):
        a, b = (getattr(frame, part) for frame in (one, other))
        if part == "contacts":
            return not np.array_equal(a.points, b.points)
        return (a is None) != (b is None) or (a != b if isinstance(a, dict) else not np.array_equal(a, b))

    names = list(failing.FAILURES)
    some, later, every = list(range(4, 12)), list(range(4, 14)), list(range(1, 14))
    expected = [{}, {"depth": some}, {"depth": some}, {}, {"contacts": later}, {"contacts": later}, {"depth": some}]
    expected += [{"depth": some}, {"depth": every}, {"joints": later}, {"camera_from_world": later}]
    expected += [{"depth": every}, {"depth": every}]
    for name, parts in zip(names, expected, strict=True):
        assert {part: at for part, at in changed(name).items() if at} == parts, name
    assert [one.index for one in failing.FAILURES["8 frames are missing"](frames, 4, None)] == [0, 1, 2, 3, 12, 13]
    late = failing.FAILURES["images are two frames late"](frames, 4, None)
    assert late[7].depth is frames[5].depth
    assert late[0].depth is frames[0].depth
    for one, depth in zip(frames, before, strict=True):
        np.testing.assert_array_equal(one.depth, depth)


def test_every_failure_is_a_row_and_a_demand():
    settings = BenchSettings(quick=True, objects=("box",), frames=3, seed=2)
    report = failing.run(settings)
    (table,) = report.tables
    assert [row[0] for row in table.rows] == list(failing.FAILURES)
    assert len(report.claims) == len(failing.FAILURES)
    with pytest.raises(InputError, match="motion"):
        failing.run(BenchSettings(motions=("dance",)))
