"""The grasp at an estimate: what is uncertain is carried, and a finger where the map says does what it says."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fusion.advice.grasp import GraspAdviceSettings, GraspMap, Place, assess
from fusion.cli.main import main
from fusion.estimation.answer import ContactResidual, Estimate, Mode
from fusion.results.files import capture_of, find_result, read_result
from fusion.results.report.data import report_data
from fusion.results.report.grasps import NO_PLACE, vertex_shades
from scenes.errors import InputError
from scenes.geometry import poses
from scenes.recordings.captures import write_capture
from scenes.recordings.frames import Contacts, Frame
from scenes.synthesis import library
from touch.grasp_quality import WrenchSettings, grasp_quality

TIGHT = np.diag([1e-3**2] * 3 + [1e-4**2] * 3)
POSE = poses.exp([0.3, -0.4, 0.2, 0.05, -0.02, 0.6])
FEW = GraspAdviceSettings(samples=12, places=0)


@pytest.fixture(scope="module")
def box():
    return library.make("box")


def held(box, with_normals=True, covariance=TIGHT, modes=None):
    """A box held from three sides and its answer: a frame without a camera or a hand."""
    directions = np.array([[1.0, 0.1, 0.05], [-1.0, 0.7, -0.1], [-0.8, -0.9, 0.1]])
    origins = box.centroid + 3 * box.radius * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    points = origins + box.surface.cast(origins, box.centroid - origins)[:, None] * (box.centroid - origins)
    _, normals, points = box.surface.closest(points)
    contacts = Contacts(points, normals if with_normals else None, 5e-4).moved(POSE)
    answer = Estimate(0, POSE, covariance, modes or (Mode(POSE, 1.0, 0.0, covariance),), "ok")
    return Frame(0, contacts=contacts), answer, points, normals


def test_quality_at_the_estimate_is_that_of_the_contacts(box):
    frame, answer, points, normals = held(box)
    found = assess(box, answer, frame, settings=FEW)
    direct = grasp_quality(points, normals, box.centroid, box.radius)
    assert found.quality.closure == direct.closure
    assert found.quality.margin == pytest.approx(direct.margin, abs=1e-6)
    np.testing.assert_allclose(found.points, points, atol=1e-6)
    without, _, _, _ = held(box, with_normals=False)
    assert assess(box, answer, without, settings=FEW).quality.margin == pytest.approx(direct.margin, abs=1e-6)


def test_uncertainty_is_carried(box):
    frame, sure, _, _ = held(box, with_normals=False)
    soft = replace(FEW, wrenches=WrenchSettings(soft_radius=0.01), samples=40)
    narrow = assess(box, sure, frame, settings=soft)
    _, wide_answer, _, _ = held(box, covariance=np.diag([np.deg2rad(8.0) ** 2] * 3 + [0.004**2] * 3))
    wide = assess(box, wide_answer, frame, settings=soft)
    assert narrow.quality.closure
    assert narrow.closure_probability == 1.0
    assert wide.epsilon.high - wide.epsilon.low > 3 * (narrow.epsilon.high - narrow.epsilon.low)
    assert wide.epsilon.low <= wide.epsilon.median <= wide.epsilon.high
    again = assess(box, wide_answer, frame, settings=soft)
    assert again.to_json() == wide.to_json()


def test_a_finger_where_the_map_says_has_that_effect(box):
    frame, answer, points, normals = held(box)
    found = assess(box, answer, frame, settings=GraspAdviceSettings(samples=0, places=60))
    assert found.places
    gains = [place.gain for place in found.places]
    assert gains == sorted(gains, reverse=True)
    assert gains[0] == pytest.approx(np.nanmax(found.map.gain))
    best = found.places[0]
    more = grasp_quality(
        np.concatenate([points, best.point[None]]),
        np.concatenate([normals, best.normal[None]]),
        box.centroid,
        box.radius,
    )
    assert more.margin == pytest.approx(best.margin, abs=1e-6)
    assert best.information > 0
    apart = np.linalg.norm(found.places[0].point - found.places[1].point)
    assert apart > 0.2 * box.radius


def test_no_finger_fits_inside_a_mug_wall_or_where_the_hand_is(hand, lab_frame, drill):
    truth = lab_frame.camera_from_object_truth
    camera_from_hand = lab_frame.camera_from_world @ lab_frame.world_from_hand
    answer = Estimate(
        lab_frame.index,
        truth,
        TIGHT,
        (Mode(truth, 1.0, 0.0, TIGHT),),
        "ok",
        hand_from_object=poses.inverse(camera_from_hand) @ truth,
    )
    found = assess(drill, answer, lab_frame, settings=GraspAdviceSettings(samples=4, places=80))
    surface = poses.apply(poses.inverse(truth) @ camera_from_hand, hand.points_on_surface(lab_frame.joints))
    for point, normal, gain in zip(found.map.points, found.map.normals, found.map.gain):
        near = np.linalg.norm(surface - (point + 0.008 * normal), axis=1).min() < 0.008
        assert not (near and np.isfinite(gain))
    assert all(place.finger in hand.sensors for place in found.places)


def test_contacts_that_do_not_belong_are_left_out(box):
    frame, answer, _, _ = held(box)
    residuals = tuple(ContactResidual(f"contact{i}", 0.0, 0.0, i == 1) for i in range(3))
    found = assess(box, replace(answer, contacts=residuals), frame, settings=FEW)
    assert found.left_out == ("contact1",)
    assert len(found.points) == 2


def test_nothing_felt_is_an_answer(box):
    _, answer, _, _ = held(box)
    found = assess(box, answer, Frame(0), settings=GraspAdviceSettings(samples=5, places=20))
    assert (found.quality.epsilon, found.quality.volume, found.closure_probability) == (0.0, 0.0, 0.0)
    assert found.quality.why == "nothing touches the object"
    json.dumps(found.to_json(), allow_nan=False)


def test_shades_of_the_map():
    points = np.array([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]])
    shades, largest = vertex_shades(GraspMap(points, points, np.array([0.0, 0.2, np.nan])), points + 1e-6)
    assert largest == pytest.approx(0.2)
    assert shades[0] < 5
    assert shades[1] > 250
    assert shades[1] != NO_PLACE
    assert shades[2] == NO_PLACE


def test_the_report_shows_it(box):
    frame, answer, _, _ = held(box)
    grasp = assess(box, answer, frame, settings=GraspAdviceSettings(samples=4, places=30))
    page = report_data("name", [frame], box, [answer], grasps=[grasp])
    entry = page["frames"][0]["grasp"]
    assert entry["verdict"] == grasp.quality.verdict
    assert len(entry["places"]) == len(grasp.places)
    json.dumps(page, allow_nan=False)
    assert report_data("name", [frame], box, [answer])["frames"][0]["grasp"] is None


@pytest.mark.parametrize(
    ("gain", "margin", "told"),
    [
        (0.065, 0.086, "ε 0.086 (+0.065)"),
        (0.641, 0.05, "closes the grasp: ε 0.050 (margin -0.591 without it)"),
        (0.1, -0.2, "does not close the grasp: margin -0.200 (-0.300 without it)"),
    ],
)
def test_a_gain_is_of_what_was_there_before(gain, margin, told):
    """Epsilon cannot gain more than it is: where the grasp was not closed, it is the margin that gains."""
    assert Place(np.zeros(3), np.zeros(3), gain, margin, 0.0).told == told


# ---- the command


@pytest.fixture(scope="module")
def capture(tmp_path_factory, box):
    folder = tmp_path_factory.mktemp("grasp") / "boxes"
    frame, _, _, _ = held(box)
    many = np.random.default_rng(0).permutation(300)[:12]
    points, normals = box.sample_surface(300, seed=4)
    contacts = Contacts(points[many], normals[many], 5e-4, 0.05).moved(POSE)
    return write_capture(folder, [replace(frame, contacts=contacts, camera_from_object_truth=POSE, prior=POSE)], box)


def test_grasp_of_a_capture_and_of_its_result(capture, tmp_path, capsys):
    quick = ["--samples", "6", "--no-map", "--friction", "0.6", "--soft-finger", "5"]
    assert main(["estimate", str(capture), "--out", str(tmp_path / "e"), "--no-report"]) == 0
    argv = ["grasp", str(tmp_path / "e"), "--out", str(tmp_path / "g"), *quick]
    assert main([*argv, "--json", str(tmp_path / "g.json")]) == 0
    assert "force closure" in capsys.readouterr().out
    found = json.loads((tmp_path / "g.json").read_text())
    assert found == json.loads((tmp_path / "g" / "grasp.json").read_text())
    assert found["frames"][0]["posterior"]["samples"] == 6
    assert found["settings"]["soft_finger_mm"] == 5.0
    assert (tmp_path / "g" / "grasp.html").stat().st_size > 10_000
    argv = ["grasp", str(capture), "--out", str(tmp_path / "h"), "--no-report", *quick]
    assert main([*argv, "--json", str(tmp_path / "h.json")]) == 0
    direct = json.loads((tmp_path / "h.json").read_text())
    assert direct["frames"][0]["epsilon"] == pytest.approx(found["frames"][0]["epsilon"], abs=1e-6)


def test_results_read_back_as_they_were_written(capture, tmp_path):
    assert main(["estimate", str(capture), "--out", str(tmp_path / "e"), "--no-report"]) == 0
    content, answers = read_result(tmp_path / "e" / "result.json")
    assert find_result(tmp_path / "e") == tmp_path / "e" / "result.json"
    assert find_result(capture) is None
    assert capture_of(tmp_path / "e" / "result.json", content) == capture
    np.testing.assert_allclose(answers[0].pose, content["frames"][0]["camera_from_object"])
    assert answers[0].verdict == content["frames"][0]["verdict"]
    assert len(answers[0].contacts) == len(content["frames"][0]["contacts"])
    del content["capture_path"]
    with pytest.raises(InputError, match="--capture"):
        capture_of(tmp_path / "e" / "result.json", {**content, "capture": "elsewhere"})


@pytest.mark.parametrize(
    ("text", "expected"),
    [("{}", "frames"), ("no json", "expected a result.json"), ('{"frames": [{"frame": 0}]}', "camera")],
)
def test_a_broken_result_is_one_line(tmp_path, capsys, text, expected):
    (tmp_path / "result.json").write_text(text)
    assert main(["grasp", str(tmp_path)]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert expected in err


def test_bad_use_is_one_line(capture, tmp_path, capsys):
    for argv in (
        ["grasp", str(tmp_path / "nowhere")],
        ["grasp", str(capture), "--friction", "-1"],
        ["grasp", str(capture), "--edges", "2"],
        ["grasp", str(capture), "--norm", "l2"],
    ):
        assert main(argv) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_pyramids_of_more_sides_than_a_minute_allows_are_refused(tmp_path, capsys):
    assert GraspAdviceSettings(WrenchSettings(edges=16)).wrenches.edges == 16
    with pytest.raises(InputError, match="edges: expected a friction pyramid of 3 to 16 sides, got 17"):
        GraspAdviceSettings(WrenchSettings(edges=17))
    assert main(["grasp", str(tmp_path), "--edges", "32"]) == 2
    assert "3 to 16 sides, got 32" in capsys.readouterr().err
