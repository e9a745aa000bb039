"""Recorded frames: what they can be judged by, how they are found, and one whole run on a small folder made here."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from commands import refused
from made_frames import plain_view
from shared_data import DATA

from fusion.benchmarks.printing.tables import BenchSettings, Report
from fusion.benchmarks.real import absent, bench, frames
from fusion.benchmarks.real.diagnosis import diagnose
from fusion.benchmarks.real.hidden import FROM, behind_fingers, hidden_trials
from fusion.benchmarks.real.sheet import HIGH, TEXT, WIDE, tile
from fusion.benchmarks.real.trials import AT_REFERENCE, METHODS, NO_START, OURS, STARTS, methods_of, trial, trials
from fusion.cli.main import main
from scenes.errors import InputError
from scenes.files.formats.off import write_off
from scenes.formats.bop import scene as bop_scene
from scenes.geometry import poses
from scenes.recordings.captures import read_capture, write_capture
from scenes.recordings.frames import Contacts
from scenes.synthesis.library import make

NEAR = STARTS[1]


def masked(name="drill"):
    """An exact view before nothing, its mask, neither touch nor start."""
    frame = plain_view(name)
    return replace(frame, mask=frame.depth > 0, prior=None, contacts=Contacts(np.zeros((0, 3))))


@pytest.fixture(scope="module")
def one():
    return frames.recorded("drill", masked(), make("drill"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A frame with its true pose, one with a pose that is none, one without a mask, and a grasp."""
    root = tmp_path_factory.mktemp("data")
    drill, frame = make("drill"), masked()
    shifted = poses.make_pose(translation=[0.0, 0.0, 0.004]) @ frame.camera_from_object_truth
    write_capture(root / "real" / "true", [frame], drill)
    write_capture(root / "real" / "shifted", [replace(frame, camera_from_object_truth=shifted)], drill)
    write_capture(root / "real" / "bare", [replace(frame, mask=None)], drill)
    grasp = root / "icub-handover" / "box"
    grasp.mkdir(parents=True)
    box = make("box")
    points, _ = box.sample_surface(400, seed=1)
    write_off(grasp / "cloud.off", points[:397])
    write_off(grasp / "contacts.off", points[397:])
    write_off(grasp / "model.off", box.vertices, box.faces)
    return root


def test_the_truth_lies_on_what_was_seen(one):
    assert one.truth is not None
    assert one.residual(one.truth) < 1e-4
    assert one.overlap(one.truth) == pytest.approx(1.0, abs=0.01)
    assert one.floor < 1e-4
    moved = poses.make_pose(translation=[0.0, 0.0, 0.02]) @ one.truth
    assert 0.005 < one.residual(moved) < 0.021
    assert one.wrong(0.006, 0.0, 1.0)
    assert one.wrong(float("nan"), 0.0, 1.0)
    assert not one.wrong(0.004, 1.0, 0.0)


def test_a_pose_off_what_was_seen_is_not_the_truth():
    frame = masked()
    true = frame.camera_from_object_truth
    shifted = poses.make_pose(translation=[0.0, 0.0, 0.004]) @ true
    found = frames.recorded("drill", replace(frame, camera_from_object_truth=shifted), make("drill"))
    assert found.truth is None
    assert found.given_residual > 0.0015
    assert np.abs(found.reference[:3, 3] - true[:3, 3]).max() < 0.0005
    assert found.wrong(0.0, 0.006, 1.0)
    assert found.wrong(0.0, 0.001, 0.5)
    assert not found.wrong(float("nan"), 0.004, 0.7)
    # a data set that vouches for its poses is believed
    assert frames.recorded("d", replace(frame, camera_from_object_truth=shifted), make("drill"), True).truth is not None


def test_what_is_hidden_does_not_count_against_an_outline(one):
    frame, pose = one.frame, one.truth
    half = np.zeros(frame.mask.shape, dtype=bool)
    half[:, : int(np.median(np.nonzero(frame.mask)[1]))] = True
    wall = replace(frame, depth=np.where(half, np.float32(0.3), frame.depth), mask=frame.mask & ~half)
    assert frames.overlap(one.renderer, wall, pose, 0.015) == pytest.approx(1.0, abs=0.02)
    # a mask of what is in front is not the object
    assert frames.overlap(one.renderer, replace(frame, mask=frame.mask & ~half), pose, 0.015) < 0.7


@pytest.mark.parametrize(
    ("change", "why"),
    [({"depth": None}, "depth"), ({"mask": None}, "mask"), ({"mask": np.zeros((240, 320), dtype=bool)}, "0 pixels")],
)
def test_frames_that_cannot_be_judged_say_why(change, why):
    assert why in frames.recorded("x", replace(masked(), **change), make("drill"))


def test_starts_are_as_far_as_said_and_the_same_for_all(one):
    found = list(trials(one, (NEAR,), 2, seed=3))
    assert {t.method for t in found} == set(methods_of(NEAR, True))
    by_try = {number: [t.prior for t in found if t.number == number] for number in (0, 1)}
    for priors in by_try.values():
        assert all(np.array_equal(prior, priors[0]) for prior in priors)
        delta = poses.difference(priors[0], one.reference, one.model.centroid)
        assert np.rad2deg(np.linalg.norm(delta[:3])) == pytest.approx(5.0)
        assert np.linalg.norm(delta[3:]) == pytest.approx(0.010)
    assert not np.array_equal(by_try[0][0], by_try[1][0])
    masked_ours = [t for t in found if t.method == OURS and t.mask]
    assert all(t.add_s < 0.005 and not t.wrong and t.overlap > 0.9 for t in masked_ours)


def test_without_a_start_local_methods_begin_in_the_mask():
    assert "fpfh_ransac" in methods_of(NO_START, True)
    assert "icp" in methods_of(NO_START, True)
    assert "icp" not in methods_of(NO_START, False)
    assert "small_gicp" not in methods_of(NO_START, True)
    assert methods_of(AT_REFERENCE, False) == (OURS, "icp")


def test_fingers_hide_what_is_asked_and_touch_what_they_hide(one):
    before = one.frame
    for share in (0.3, 0.8):
        behind = behind_fingers(one, share, np.random.default_rng(5))
        assert share <= behind.share < share + 0.25
        after = behind.frame
        changed = after.depth != before.depth
        assert not (after.mask & changed & (after.depth > 0)).any()
        # fingers are before the object, and nothing of what is left is touched
        covered = before.mask & ~after.mask & (after.depth > 0)
        assert (after.depth[covered] < before.depth[covered]).all()
        off = one.model.field.distance(poses.apply(poses.inverse(one.reference), behind.felt))
        assert np.abs(off).max() < 0.005
        again = behind_fingers(one, share, np.random.default_rng(5))
        assert np.array_equal(after.depth, again.frame.depth)
        assert np.array_equal(behind.felt, again.felt)


def test_methods_behind_fingers_start_alike_and_only_two_are_told_of_contacts(one):
    found = list(hidden_trials(one, (0.3,), 1, seed=3))
    assert {(t.start, t.mask) for t in found} == {(start, mask) for start in FROM for mask in (True, False)}
    assert {t.method for t in found if t.start.angle is None and not t.mask} == {"vision", "fused"}
    for t in found:
        told = t.row.estimate
        if told is not None:
            assert bool(told.contacts) == (t.method == "fused")
    assert not list(hidden_trials(replace(one, reference=None), (0.3,), 1, seed=3))


def test_a_frame_is_asked_for_what_it_does_not_show_and_for_nothing_else(one):
    other = frames.recorded("box", masked("box"), make("box"))
    twice = replace(one, name="drill again")
    assert [m.name for m in absent.others_of(one, [one, twice, other, other], 6)] == ["box"]
    assert absent.others_of(one, [one, twice], 6) == []
    put = absent.in_its_place(one, other.model)
    middles = [poses.apply(p, m.centroid[None])[0] for p, m in ((put, other.model), (one.reference, one.model))]
    np.testing.assert_allclose(*middles, atol=1e-12)
    np.testing.assert_array_equal(put[:3, :3], one.reference[:3, :3])
    found = list(absent.absent_trials(one, [one, other], 6, 0))
    assert [(t.model, t.start) for t in found] == [("box", False), ("box", True)]
    assert not any(t.sure for t in found)


def test_an_ok_where_nothing_is_misses_the_demand(one, monkeypatch):
    other = frames.recorded("box", masked("box"), make("box"))
    said = iter(["ok", "ambiguous", "lost", "lost"])
    answer = absent.estimate

    def estimate(*given, **told):
        return replace(answer(*given, **told), verdict=next(said))

    monkeypatch.setattr(absent, "estimate", estimate)
    report = Report("real", "", "", 0)
    absent.look_for_others(report, [one, other], BenchSettings(quick=True))
    (claim,) = report.claims
    assert claim.value == 0.25
    assert not claim.met
    none, placed = report.tables[0].rows
    assert [row[2] for row in (none, placed)] == ["1 / 0 / 1", "0 / 1 / 1"]


def test_a_wrong_answer_is_looked_at_again(one):
    t = trial(one, one.frame, NO_START, "icp")
    far = replace(t, method=OURS, pose=poses.make_pose(translation=[0.0, 0.0, 0.05]) @ one.truth)
    why = diagnose(one, far, seed=0)
    assert why.excess > 0  # the truth explains the pixels better
    assert why.skipped_right


def test_a_tile_shows_the_outline_and_says_where_an_answer_is_that_is_not_there(one):
    t = trial(one, one.frame, NEAR, "icp")
    t = replace(t, pose=one.truth, wrong=False, verdict="ok")
    right = tile(one, "mask, no start", t)
    assert right.shape == (HIGH + TEXT, WIDE, 3)
    away = poses.make_pose(translation=[5.0, 0.0, 0.0]) @ one.truth
    wrong = tile(one, "mask, no start", replace(t, pose=away, wrong=True))
    assert (right[:HIGH, :, 1].astype(int) - right[:HIGH, :, 0] > 100).sum() > 100  # green
    assert (wrong[:HIGH, :, 0].astype(int) - wrong[:HIGH, :, 1] > 100).sum() > 50  # red words


def test_a_whole_run(folder, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["bench", "real", "--data", str(folder), "--trials", "1", "--seed", "2", "--out", str(out)]
    assert main([*words, "--json", str(tmp_path / "real.json")]) == 0
    assert "bare: no mask" in " ".join(capsys.readouterr().out.split())
    report = json.loads((tmp_path / "real.json").read_text())
    told, cases, each, _, behind, grasps = report["tables"]
    assert [(row["frame"], row["it is the truth"]) for row in told["rows"]] == [("shifted", False), ("true", True)]
    assert {row["method"] for row in cases["rows"]} <= set(METHODS)
    near = [row for row in cases["rows"] if row["start"] == NEAR.name and row["mask"] == "mask"]
    assert all(row["right"]["share"] == 1.0 and row["true: tries"] == 1 for row in near if row["method"] == OURS)
    assert len(each["rows"]) == 2 * 2 * len(STARTS)
    assert {row["grasp"] for row in grasps["rows"]} == {"box"}
    assert {row["hidden"] for row in behind["rows"]} == {"30%", "60%", "80%"}
    fused = [row for row in behind["rows"] if row["method"] == "fused" and row["start"] != "none"]
    assert all(row["tries"] == 2 and row["wrong but ok"] == 0 for row in fused)
    assert sum(row["right"]["share"] for row in fused) >= 5.0
    cases = {claim["what"].split(":")[0] for claim in report["claims"]}
    assert all(case.startswith(("mask", "no mask", "30%", "60%", "80%", "behind fingers")) for case in cases)
    assert (out / "real_sheet.png").is_file()


def test_a_bop_data_set_is_read_as_it_is(tmp_path):
    write_capture(tmp_path / "c", [replace(masked(), index=i) for i in range(4)], make("drill"), object_id=3)
    bop_scene.export(read_capture(tmp_path / "c"), tmp_path / "set")
    found = list(frames.bop_frames(tmp_path / "set", images=2))
    assert [one.name for one in found] == ["000000/000000 object 3", "000000/000003 object 3"]
    truth = masked().camera_from_object_truth
    for one in found:
        assert np.allclose(one.truth, truth, atol=1e-6)
        assert one.overlap(truth) > 0.99
        assert one.residual(truth) < 0.001  # depth in whole millimetres
    assert len(list(frames.bop_frames(tmp_path / "set" / "test" / "000000", images=1))) == 1
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="BOP scene"):
        list(frames.bop_frames(tmp_path / "empty", 1))


def test_no_recordings_are_one_line(tmp_path, capsys):
    line = refused(capsys, "bench", "real", "--data", str(tmp_path / "nowhere"))
    assert "found no folder" in line
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="found none"):
        bench.run(BenchSettings(data=tmp_path / "empty"))


def test_recorded_frames_tell_true_poses_from_estimates():
    if not (DATA / "real").is_dir():
        pytest.skip(f"no recorded frames at {DATA / 'real'} (set PALPATE_DATA to its parent)")
    found = [one for one in frames.captures(DATA, 1) if not isinstance(one, str)]
    assert {one.name for one in found if one.truth is not None} == {
        one.name for one in found if one.name.startswith("ycbv")
    }
    assert all(one.floor < 0.002 and one.floor_overlap > 0.8 for one in found)
