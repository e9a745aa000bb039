"""Comparing, judging and evaluating: the numbers mean what their names say."""

from __future__ import annotations

import json
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from made_frames import plain_view

from fusion.results.plots import check_suffix, draw, write_plot
from fusion.truth import compare as comparing
from fusion.truth.compare import METHODS, Row, check_methods, compare, compare_frame, summarise
from fusion.truth.errors import Agreement, Errors, Judge, json_number
from fusion.truth.evaluate import evaluate
from scenes.errors import CaptureError, InputError
from scenes.geometry import poses
from scenes.recordings.bop import PoseRow
from scenes.recordings.captures import read_capture, write_capture
from scenes.synthesis.library import make
from scenes.synthesis.recording import synthesize_frames


def test_the_truth_has_no_error():
    for name in ("drill", "cylinder", "sphere"):
        judge, frame = Judge(make(name)), plain_view(name)
        truth = frame.camera_from_object_truth
        errors = judge.errors(truth, truth, np.eye(6))
        assert errors.add == 0.0
        assert errors.add_s < 1e-12
        assert errors.rotation < 1e-6
        assert errors.translation < 1e-9
        assert errors.nees < 1e-9
        agreement = judge.agreement(frame, truth)
        assert agreement.contacts < 1e-4
        assert agreement.cloud < 1e-4
        assert agreement.inliers == 1.0


def test_symmetric_poses_are_the_same_answer():
    judge = Judge(make("cylinder"))
    truth = plain_view("cylinder").camera_from_object_truth
    turned = truth @ judge.model.symmetries.poses(7)[3]
    errors = judge.errors(turned, truth)
    assert errors.rotation < 1e-6
    assert errors.add_s < 0.0004  # the spacing of the samples, not zero
    assert errors.add > 0.02


def test_a_shift_is_measured_in_its_own_size():
    judge = Judge(make("drill"))
    truth = plain_view("drill").camera_from_object_truth
    moved = poses.make_pose(translation=[0.003, 0.0, 0.004]) @ truth
    covariance = np.diag([1e-4] * 3 + [1e-6] * 3)
    errors = judge.errors(moved, truth, covariance)
    assert errors.add == pytest.approx(0.005)
    assert errors.translation == pytest.approx(0.005)
    assert errors.nees == pytest.approx(25.0)
    assert 0.0005 < errors.add_s < 0.005


@pytest.mark.parametrize("methods", [METHODS, ("fused", "icp")])
def test_every_method_finds_an_unhidden_box(methods):
    frame, judge = plain_view(), Judge(make("box"))
    rows = compare_frame(frame, judge, methods, capture="c", group="g")
    assert [row.method for row in rows] == list(methods)
    for row in rows:
        assert row.time_ms > 0
        assert row.verdict in (("", "lost") if row.method.startswith("icp") else ("ok", "ambiguous", "lost"))
        assert (row.estimate is None) == row.method.startswith("icp")
        if row.method != "touch":
            assert row.errors is not None
            assert row.errors.add_s < 0.002, row.method
        json.dumps(row.to_json(), allow_nan=False)


def test_agreement_is_told_when_it_is_asked_for():
    frame, judge = plain_view(), Judge(make("box"))
    (with_it,), (without,) = (compare_frame(frame, judge, ("icp",), agree=agree) for agree in (True, False))
    assert np.isfinite(with_it.agreement.cloud)
    assert np.isnan([without.agreement.cloud, without.agreement.contacts, without.agreement.inliers]).all()
    assert with_it.errors is not None
    assert without.errors is not None
    assert with_it.errors.add_s == without.errors.add_s


def test_unknown_methods_are_refused():
    with pytest.raises(InputError, match=r"expected some of icp, .* got magic"):
        check_methods(["icp", "magic"])
    with pytest.raises(InputError, match="got none"):
        check_methods([])
    assert check_methods(["fused", "icp", "fused"]) == ("fused", "icp")


def test_captures_are_compared_by_group(tmp_path, monkeypatch):
    frame = plain_view()
    for name, notes in (("a_1", None), ("a_2", None), ("b", {"noise": "lab", "occlusion": 0.8})):
        write_capture(tmp_path / name, [frame], make("box"), notes=notes)
    monkeypatch.setattr(
        comparing, "_run", lambda method, frame, model, *_: (frame.camera_from_object_truth, "ok", 1.0, None)
    )
    captures = [read_capture(tmp_path / name) for name in ("a_1", "a_2", "b")]
    found = summarise(compare(captures, ("icp",)))
    assert [(s.group, s.frames) for s in found] == [("a", 2), ("lab, 80 % hidden", 1)]


def row(method: str, add_s: float | None, verdict: str = "ok", group: str = "g") -> Row:
    errors = None if add_s is None else Errors(add_s, add_s, 0.1, add_s)
    return Row("c", group, 0, method, np.eye(4), verdict, 5.0, errors, Agreement(0.001, float("nan"), 1.0))


def test_summaries_count_what_they_say():
    (found,) = summarise([row("icp", 0.001), row("icp", 0.004, "lost"), row("icp", 0.006), row("icp", 0.1)])
    assert found.add_s_mm == pytest.approx(5.0)
    assert found.success == 0.5
    assert found.verdicts == {"ok": 3, "lost": 1}
    assert found.rotation_deg == pytest.approx(np.rad2deg(0.1))
    (blind,) = summarise([row("icp", None)])
    assert np.isnan(blind.success)
    assert blind.to_json()["success"] is None
    assert blind.cloud_mm == pytest.approx(1.0)


def test_the_plot_is_a_picture_with_every_row(tmp_path):
    rows = [row("icp", 0.0301), row("icp", 0.02), row("fused", 0.0004, group="<&>"), row("touch", None, group="no")]
    root = ElementTree.fromstring(draw(rows))
    assert len(root.findall(".//{*}circle")) == 3
    texts = ["".join(t.itertext()) for t in root.findall(".//{*}text")]
    assert "<&>" in texts
    assert "no" not in texts
    assert "25.05 mm" in texts
    write_plot(tmp_path / "new" / "p.html", rows)
    assert (tmp_path / "new" / "p.html").read_text().startswith("<!doctype html>")
    with pytest.raises(InputError, match=r"\.html or \.svg, got p\.doc"):
        check_suffix(tmp_path / "p.doc")
    # without truth the cloud's agreement is drawn
    assert len(ElementTree.fromstring(draw([row("icp", None)])).findall(".//{*}circle")) == 1


def test_evaluation(tmp_path):
    frames = [replace(plain_view("drill"), index=i) for i in range(3)]
    truth = frames[0].camera_from_object_truth
    moved = poses.make_pose(translation=[0.0, 0.0, 0.004]) @ truth
    capture = read_capture(write_capture(tmp_path / "c", frames, make("drill")))
    worse = poses.make_pose(translation=[0.0, 0.0, 0.4]) @ truth
    rows = [PoseRow(0, 0, 1, 1.0, truth, 0.1), PoseRow(0, 1, 1, 0.2, worse, 0.1), PoseRow(0, 1, 1, 0.9, moved, 0.1)]
    found = evaluate(rows, capture, {1: np.diag([1e-4] * 3 + [1e-6] * 3)})
    exact, shifted, missing = found["frames"]
    assert exact["add_mm"] < 1e-6
    assert exact["mspd_px"] < 1e-6
    assert exact["vsd"] == 0.0
    assert shifted["add_mm"] == pytest.approx(4.0, abs=1e-6), "the better score counts"
    assert shifted["mssd_mm"] == pytest.approx(4.0, abs=1e-6)
    assert shifted["nees"] == pytest.approx(16.0, abs=1e-3)
    assert 0 < shifted["vsd"] < 0.5
    assert missing["add_mm"] == np.inf
    summary = found["summary"]
    assert summary["answered"] == 2
    assert summary["auc_add"] == pytest.approx((1.0 + 0.96 + 0.0) / 3)
    assert summary["recall_add_s_5mm"] == pytest.approx(2 / 3)
    assert summary["nees_over_6"] == pytest.approx(16.0 / 6, abs=1e-3)
    json.dumps(json_number(found), allow_nan=False)
    # who said to know exactly and was wrong is not left out of the mean
    sure = evaluate(rows, capture, {0: 1e-4 * np.eye(6), 1: np.zeros((6, 6))})["summary"]
    assert sure["nees_over_6"] == np.inf
    foreign = [PoseRow(0, 1, 2, 1.0, truth, 0.1), PoseRow(0, 77, 2, 1.0, worse, 0.1)]
    assert json_number(evaluate([*rows, *foreign], capture)["frames"]) == json_number(evaluate(rows, capture)["frames"])
    with pytest.raises(InputError, match=r"expected rows of obj_id 1 \(.*\), got obj_id 2$"):
        evaluate(foreign, capture)
    with pytest.raises(InputError, match=r"expected rows of one scene .*, got scene_id 0, 4: say which"):
        evaluate([*rows, PoseRow(4, 1, 1, 1.0, truth, 0.1)], capture)
    with pytest.raises(InputError, match="got im_id 9"):
        evaluate([PoseRow(0, 9, 1, 1.0, truth, 0.1)], capture)
    metres = truth.copy()
    metres[:3, 3] *= 1e-3
    with pytest.raises(InputError, match=r"expected t in millimetres, got 0\.5 .* the truth is 500: m read as mm"):
        evaluate([PoseRow(0, 0, 1, 1.0, metres, 0.1)], capture)
    blind = write_capture(tmp_path / "blind", [replace(frames[0], camera_from_object_truth=None)], make("drill"))
    with pytest.raises(CaptureError, match="expected ground truth"):
        evaluate(rows[:1], read_capture(blind))


def test_rows_of_another_scene_are_not_a_captures(tmp_path):
    frame, model = plain_view("drill"), make("drill")
    truth = frame.camera_from_object_truth
    capture = read_capture(write_capture(tmp_path / "c", [frame], model, notes={"scene_id": 48}))
    other = poses.make_pose(translation=[0.0, 0.0, 0.4]) @ truth
    rows = [PoseRow(48, frame.index, 1, 0.2, truth, 0.1), PoseRow(49, frame.index, 1, 0.9, other, 0.1)]
    assert evaluate(rows, capture)["frames"][0]["add_mm"] < 1e-6
    with pytest.raises(InputError, match=r"expected rows of scene_id 48 \(.*\), got scene_id 49"):
        evaluate(rows[1:], capture)


def test_contacts_join_the_cloud_at_their_share(exact_frame):
    cloud = np.random.default_rng(0).normal(size=(900, 3))
    both = comparing.with_contacts(cloud, exact_frame)
    felt = poses.apply(exact_frame.camera_from_world, exact_frame.contacts.points)
    share = 1.0 - len(cloud) / len(both)
    assert abs(share - comparing.CONTACT_SHARE) < 0.01
    assert len(np.unique(both, axis=0)) == len(cloud) + len(felt)
    # any part of them holds about that share, too
    known = {tuple(point) for point in felt}
    assert sum(tuple(point) in known for point in both[:300]) in range(15, 50)
    assert comparing.with_contacts(cloud, exact_frame.without_touch()) is cloud


def test_what_wrenches_feel_joins_the_cloud_too(hand):
    model = make("drill")
    frame = synthesize_frames(model, hand, 1, 0.3, noise="clean", seed=3, touch=("wrench",))[0]
    assert not len(frame.contacts)
    cloud = np.random.default_rng(0).normal(size=(900, 3))
    assert len(comparing.with_contacts(cloud, frame)) > len(cloud)
    truth, judge = frame.camera_from_object_truth, Judge(model)
    assert np.isfinite(judge.agreement(frame, truth).contacts)
    # of a hand whose joints nobody tells they are nowhere, and pixels are judged all the same
    lost = replace(frame, joints=None)
    assert comparing.with_contacts(cloud, lost) is cloud
    assert np.isnan(judge.agreement(lost, truth).contacts)
    assert np.isfinite(judge.agreement(lost, truth).cloud)


def test_frames_of_two_folders_of_one_name_are_not_the_same(tmp_path):
    model = make("box")
    captures = []
    for index, folder in enumerate(("a", "b")):
        path = tmp_path / folder / "cap"
        path.parent.mkdir()
        captures.append(read_capture(write_capture(path, [plain_view("box", index)], model)))
    rows = list(compare(captures, ("icp",)))
    assert len({(row.capture, row.frame) for row in rows}) == 2
    (alone,) = compare(captures[:1], ("icp",))
    assert alone.capture == "cap"


def test_lost_frames_tell_of_no_unit_and_are_worth_nothing(tmp_path):
    """Of a frame without evidence `estimate` writes the origin: that is no pose in metres."""
    from fusion.estimation.estimate import estimate
    from fusion.results.files import write_results
    from scenes.recordings.bop import read_poses

    model, seen = make("drill"), plain_view("drill")
    truth = seen.camera_from_object_truth
    blank = replace(seen.without_vision().without_touch(), prior=None)
    capture = read_capture(write_capture(tmp_path / "c", [replace(seen, index=i) for i in range(3)], model))
    answers = [replace(estimate(blank, model), frame=i) for i in range(2)]
    assert answers[0].verdict == "lost"
    found = replace(answers[0], frame=2, pose=truth, verdict="ok")
    write_results(tmp_path / "out", capture, [*answers, found], {})
    rows = read_poses(tmp_path / "out" / "poses.csv")
    assert [row.score for row in rows] == [0.0, 0.0, answers[0].modes[0].weight]
    assert not rows[0].pose[:3, 3].any()
    assert evaluate(rows, capture)["frames"][2]["add_mm"] < 1e-6
    metres = truth.copy()
    metres[:3, 3] *= 1e-3
    with pytest.raises(InputError, match=r"got 0\.5 from the camera where the truth is 500: m read as mm"):
        evaluate([*rows[:2], replace(rows[2], pose=metres)], capture)


def test_a_capture_given_twice_is_refused(tmp_path):
    capture = read_capture(write_capture(tmp_path / "c", [plain_view("box")], make("box")))
    with pytest.raises(InputError, match=r"c: expected each capture once, got it 2 times"):
        list(compare([capture, capture], ("icp",)))


@pytest.mark.parametrize("notes", [{"noise": "x", "occlusion": "much"}, {"noise": [], "occlusion": 3.0}])
def test_notes_of_one_s_own_are_no_group(tmp_path, notes):
    capture = read_capture(write_capture(tmp_path / "mine_3", [plain_view("box")], make("box"), notes=notes))
    assert comparing.group_of(capture) == "mine"
