"""Verdicts and words: what an answer may claim."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_frames import plain_view

from fusion.estimation.answer import ContactResidual, Mode
from fusion.estimation.estimate import estimate
from fusion.estimation.posterior import verdict as posterior
from fusion.estimation.posterior.tolerance import is_within, with_shared_errors, with_shift
from fusion.estimation.settings import EstimateSettings
from fusion.estimation.trace import Trace
from fusion.truth.errors import Judge
from scenes.evidence import table as evidence
from scenes.evidence.align import Prior
from scenes.evidence.table import VISION
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.geometry.symmetries import Axis, Symmetries
from scenes.recordings.beliefs import DepthModel
from scenes.recordings.frames import Contacts
from scenes.synthesis import library
from touch.answers import verdict_of
from touch.localization import localize
from vision.visibility import Visibility

SHARP = np.diag([1e-6] * 3 + [1e-8] * 3)


def mode(covariance=SHARP, weight=1.0):
    return Mode(np.eye(4), weight, 0.0, covariance)


def test_residuals_of_contacts(rng):
    model = library.make("box")
    pose = poses.make_poses(poses.random_rotations(1, rng), rng.normal(size=(1, 3)))[0]
    points, normals = model.sample_surface(200, seed=0)
    # in the middle of a side, where the lattice's normal is the side's
    half = np.ptp(model.vertices, axis=0) / 2
    rows = (np.sort(half - np.abs(points - model.vertices.mean(axis=0)), axis=1)[:, 1] > 0.015).nonzero()[0][:3]
    offset = np.array([0.0, 0.002, 0.010])[:, None]
    points, normals = points[rows] + offset * normals[rows], normals[rows].copy()
    tilt = poses.exp_rotation(
        np.cross(normals[1], [0.3, 0.5, 0.8]) / np.linalg.norm(np.cross(normals[1], [0.3, 0.5, 0.8])) * 0.2
    )
    normals[1] = tilt @ normals[1]
    normals[2] = np.nan
    contacts = Contacts(poses.apply(pose, points), normals @ pose[:3, :3].T, 1e-3, sensors=["a", "b", "c"])
    first, second, third = posterior.contact_residuals(model, contacts, pose)
    assert [r.sensor for r in (first, second, third)] == ["a", "b", "c"]
    assert first.residual_mm == pytest.approx(0.0, abs=0.02)
    assert second.residual_mm == pytest.approx(2.0, abs=0.02)
    assert third.residual_mm == pytest.approx(10.0, abs=0.05)
    assert first.normal_deg < 1
    assert second.normal_deg == pytest.approx(np.rad2deg(0.2), abs=1)
    assert np.isnan(third.normal_deg)
    assert [r.outlier for r in (first, second, third)] == [False, False, True]
    assert posterior.contact_residuals(model, Contacts(np.zeros((0, 3))), pose) == ()


def test_agreement_of_pixels():
    model = library.make("box")
    points, normals = model.sample_surface(100, seed=0)
    points[:40] += 0.05 * normals[:40]
    seen = evidence.stack(evidence.make(points, 1e-3, VISION), evidence.outside(points, 1e-3, VISION))
    share, rms = posterior.pixel_agreement(model, seen, np.eye(4))
    assert share == pytest.approx(0.6, abs=0.02)
    assert rms < 1e-4
    assert np.isnan(posterior.pixel_agreement(model, evidence.empty(), np.eye(4))).all()


def test_open_directions_are_named_in_the_objects_axes():
    model = library.make("drill")
    wide = SHARP.copy()
    wide[2, 2] = 1.0
    assert posterior.unobservable(model, np.eye(4), wide) == ("rotation about z",)
    turned = poses.make_pose(poses.exp_rotation([0.0, np.pi / 2, 0.0]))  # the object's x axis points along -z
    assert posterior.unobservable(model, turned, wide) == ("rotation about x",)
    wide = SHARP.copy()
    wide[3, 3] = 0.01
    assert posterior.unobservable(model, np.eye(4), wide) == ("translation along x",)
    assert posterior.unobservable(model, np.eye(4), SHARP) == ()
    assert posterior.unobservable(library.make("bottle"), np.eye(4), SHARP) == ("rotation about z",)


def in_other_axes(model, turn, shift):
    """The same thing, its mesh turned (3, 3) and moved (3,) in its file."""
    axes = tuple(Axis(turn @ a.point + shift, turn @ a.direction) for a in model.symmetries.axes)
    moved = poses.make_pose(turn, shift)
    discrete = moved @ model.symmetries.discrete @ poses.inverse(moved)
    vertices = model.vertices @ turn.T + shift
    return ObjectModel.from_mesh(vertices, model.faces, model.name, Symmetries(discrete, axes))


SEEN = Visibility(0.9, 0.1, 0.0, 0.0)


@pytest.mark.parametrize("name", ["bottle", "cylinder"])
@given(seed=st.integers(0, 2**32 - 1), off=st.floats(0.0, 0.05))
@settings(max_examples=25, deadline=None)
def test_a_symmetric_object_is_as_sure_in_any_axes(name, seed, off):
    """A turn about its own axis is no doubt, whatever the axis is called and a few degrees off an eigenvector."""
    rng = np.random.default_rng(seed)
    declared = library.make(name)
    turn = poses.random_rotations(1, rng)[0]
    model = in_other_axes(declared, turn, rng.normal(size=3) * 0.2)
    pose = poses.make_pose(poses.random_rotations(1, rng)[0], rng.normal(size=3))
    across = np.cross(model.symmetries.axes[0].direction, rng.normal(size=3))
    free = model.symmetries.axes[0].direction + off * across / np.linalg.norm(across)
    free = pose[:3, :3] @ free
    covariance = SHARP.copy()
    covariance[:3, :3] += np.outer(free, free)
    sure = Mode(pose, 1.0, 0.0, covariance)
    assert posterior.verdict(model, (sure,), (), 0.9, SEEN)[0] == "ok"
    assert verdict_of((sure,), model) == "ok"
    assert len(posterior.unobservable(model, pose, covariance)) == 1
    tipped = pose[:3, :3] @ across / np.linalg.norm(across)
    doubtful = Mode(pose, 1.0, 0.0, covariance + 0.5**2 * np.pad(np.outer(tipped, tipped), (0, 3)))
    assert posterior.verdict(model, (doubtful,), (), 0.9, SEEN)[0] == "ambiguous"
    assert verdict_of((doubtful,), model) == "ambiguous"


def test_an_answer_that_leaves_much_of_its_mask_bare_is_doubted():
    """Either the mask or the pose is wrong; borders that are off and a fingertip within it are usual."""
    box = library.make("box")
    said = [posterior.verdict(box, (mode(),), (), 0.9, replace(SEEN, bare=bare)) for bare in (float("nan"), 0.2, 0.3)]
    assert [word for word, _ in said] == ["ok", "ok", "ambiguous"]
    assert said[2][1] == "30% of the mask's inside is not the object at this pose"


@pytest.mark.parametrize(
    ("visible", "sure", "word"),
    [(0.2, False, "ok"), (0.1, False, "ambiguous"), (0.1, True, "ok"), (0.03, True, "ambiguous")],
)
def test_of_little_that_is_seen_an_answer_must_be_sure(visible, sure, word):
    seeing = replace(SEEN, visible=visible, hidden=1.0 - visible)
    assert posterior.verdict(library.make("box"), (mode(),), (), 0.9, seeing, sure=sure)[0] == word


def test_a_turn_about_an_axis_beside_the_centroid_moves_nothing_either():
    """A body of revolution whose centroid is off its axis: the turn carries the centroid around the axis."""
    box = library.make("box")
    axis = Axis(box.centroid + np.array([0.05, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    model = ObjectModel.from_mesh(box.vertices, box.faces, "off", Symmetries(axes=(axis,)))
    lever = np.concatenate([axis.direction, np.cross(axis.direction, model.centroid - axis.point)])
    covariance = SHARP + np.outer(lever, lever)
    assert posterior.verdict(model, (mode(covariance),), (), 0.9, SEEN)[0] == "ok"
    assert posterior.verdict(box, (mode(covariance),), (), 0.9, SEEN)[0] == "ambiguous"


def test_a_ball_may_be_anywhere_that_nothing_was_felt():
    """One contact and a prior of 2 cm: where the ball is across the contact is unknown, however it may turn."""
    ball = library.make("sphere")
    touched = Contacts([[0.0, 0.0, ball.radius]], None, 1e-3)
    found = localize(ball, touched, seed=0, prior=Prior.isotropic(np.eye(4), 0.3, 0.02))
    widest = np.sqrt(np.linalg.eigvalsh(found.covariance[3:, 3:])[-1])
    assert widest > posterior.VerdictSettings().unknown_distance
    assert posterior.verdict(ball, found.modes, (), np.nan, SEEN)[0] == "ambiguous"
    assert found.verdict == "ambiguous"
    # of all that may be the case, which is bent about the contact, each direction is wide: these words are of the mode
    said = posterior.unobservable(ball, found.pose, found.modes[0].covariance)
    assert sum(word.startswith("translation") for word in said) == 2
    assert {f"rotation about {axis}" for axis in "xyz"} <= set(said)
    assert posterior.verdict(ball, (mode(),), (), 0.9, SEEN)[0] == "ok"


def moved_origin(model, shift):
    return in_other_axes(model, np.eye(3), np.asarray(shift))


@pytest.mark.parametrize("shift", [[0.5, 0.0, 0.0], [0.0, -0.3, 0.4]])
def test_shared_errors_lie_along_the_ray_to_the_object_not_to_its_files_origin(lab_frame, shift):
    model = library.make("drill")
    pose = lab_frame.camera_from_object_truth
    elsewhere = moved_origin(model, shift)
    shifted = pose @ poses.make_pose(np.eye(3), -np.asarray(shift))
    depth = DepthModel()
    (here,), (there,) = (
        with_shared_errors(m, (Mode(p, 1.0, 0.0, SHARP),), lab_frame, depth)
        for m, p in ((model, pose), (elsewhere, shifted))
    )
    assert np.allclose(here.covariance, there.covariance, atol=1e-12)
    middle = poses.apply(pose, model.centroid[None])[0]
    ray = middle / np.linalg.norm(middle)
    added = here.covariance[3:, 3:] - SHARP[3:, 3:]
    assert ray @ added @ ray == pytest.approx(depth.bias_sigma**2 + (depth.scale_sigma * np.linalg.norm(middle)) ** 2)


def test_a_tolerance_asks_nothing_about_turns_that_change_nothing():
    covariance = SHARP + np.diag([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    wide = (mode(covariance),)
    assert is_within(library.make("bottle"), wide, (0.001, 0.02), EstimateSettings())
    assert not is_within(library.make("drill"), wide, (0.001, 0.02), EstimateSettings())


def test_an_estimate_does_not_know_where_a_files_origin_is(lab_frame):
    """The same object, half a metre from its file's origin: the same answer, and as sure."""
    declared = library.make("drill")
    shift = np.array([0.3, -0.4, 0.0])
    prior = poses.displaced(lab_frame.camera_from_object_truth, 0.1, 0.01, declared.centroid, np.random.default_rng(0))
    here = estimate(lab_frame, declared, prior, tolerance=(0.02, 0.2))
    there = estimate(
        lab_frame, moved_origin(declared, shift), prior @ poses.make_pose(np.eye(3), -shift), tolerance=(0.02, 0.2)
    )
    back = there.pose @ poses.make_pose(np.eye(3), shift)
    delta = poses.difference(back, here.pose, declared.centroid)
    # another lattice, laid elsewhere over the same surface
    sigma = np.sqrt(np.diag(here.covariance))
    assert np.all(np.abs(delta) < 0.5 * sigma)
    assert np.sqrt(np.diag(there.covariance)) == pytest.approx(sigma, rel=0.1)


def residual(outlier):
    return ContactResidual("tip", 0.0, 0.0, outlier)


def test_verdicts(lab_frame):
    from vision.visibility import visibility

    model = library.make("drill")
    seeing = visibility(lab_frame, model, lab_frame.camera_from_object_truth)

    def word(modes, residuals=(), share=0.9):
        return posterior.verdict(model, modes, residuals, share, seeing)[0]

    assert word(()) == "lost"
    assert word((mode(),)) == "ok"
    aside = Mode(poses.make_pose(np.eye(3), [0.02, 0.0, 0.0]), 0.4, 0.5, SHARP)
    assert word((mode(weight=0.6), aside)) == "ambiguous"
    wide = SHARP.copy()
    wide[0, 0] = 4.0
    assert word((mode(wide),)) == "ambiguous"
    assert word((mode(),), tuple(residual(x) for x in (True, True, True, False))) == "lost"
    assert word((mode(),), tuple(residual(x) for x in (True, False, False, False))) == "ok"


def test_the_trace_lists_what_ran_and_what_did_not():
    trace = Trace()
    with trace.stage("look", True, "never") as stage:
        stage.note(12, "twelve rows")
    with trace.stage("feel", False, "touch not asked for") as stage:
        stage.note(5, "not said")
    look, feel = trace.stages
    assert (look.name, look.ran, look.why, look.rows) == ("look", True, "twelve rows", 12)
    assert (feel.name, feel.ran, feel.why, feel.rows) == ("feel", False, "touch not asked for", 0)
    assert look.ms >= 0
    assert trace.spent_ms >= look.ms
    assert not trace.over_budget
    assert Trace(budget_ms=-1.0).over_budget


def test_one_normal_the_wrong_way_round_does_not_lose_what_a_camera_sees():
    """Of a recording that says no sigmas, too; one of five contradicts nothing yet."""
    frame, model = plain_view("drill"), library.make("drill")
    normals = frame.contacts.normals.copy()
    normals[0] *= -1.0
    answer = estimate(replace(frame, contacts=Contacts(frame.contacts.points, normals)), model)
    assert answer.verdict != "lost", answer.notes
    assert Judge(model).errors(answer.pose, frame.camera_from_object_truth).add_s < 0.005
    across = np.cross(frame.contacts.normals, [0.3, -0.5, 0.8])
    against = replace(frame, contacts=Contacts(frame.contacts.points, across))
    turned = [estimate(against, model, seed=seed) for seed in range(3)]
    # all of them do: what the image shows stands, and nobody may be sure of it
    assert all(answer.verdict == "lost" for answer in turned)
    assert max(answer.confidence for answer in turned) <= posterior.VerdictSettings().most_doubted


@pytest.mark.parametrize(("fingers", "word"), [(1, "ambiguous"), (2, "ambiguous"), (3, "lost")])
def test_a_badly_placed_finger_or_two_do_not_lose_what_a_camera_sees(fingers, word):
    """Each explained, and 6.6 nats against it: a joint off by a few degrees does that."""
    model, seeing = library.make("drill"), Visibility(0.9, 0.1, 0.0, 0.0)
    felt = tuple(residual(False) for _ in range(fingers))
    rules = posterior.VerdictSettings(), EstimateSettings().confidence
    against = 6.6 * fingers
    said = posterior.judged(model, (mode(),), felt, against, 0.9, seeing, None, *rules, contradicted=against)
    assert said[2] == word
    assert said[1] <= rules[0].most_doubted


def test_what_contradicts_counts_no_more_than_false_contacts():
    model = library.make("drill")
    points, normals = model.sample_surface(5, 0)
    felt = evidence.from_contacts(Contacts(points, -normals, 0.004, 0.1))
    whole = posterior.nats_of_contacts(model, felt, 5, np.eye(4))
    capped = posterior.contradiction(model, felt, 5, np.eye(4))
    assert whole > 5 * 50.0
    assert capped == pytest.approx(5 * 8.0, rel=0.05)
    # many of a finger weigh as one, and are off no less for it
    assert posterior.nats_of_contacts(model, felt.reweighted(0.1), 5, np.eye(4)) == pytest.approx(whole)
    # and space that is felt to be empty costs what it costs, however little they weigh
    within = evidence.outside(model.centroid[None], 0.003, evidence.TOUCH)
    costs = [
        posterior.nats_of_contacts(model, evidence.stack(one, within), 5, np.eye(4))
        for one in (felt, felt.reweighted(0.1))
    ]
    assert costs[0] > whole
    assert costs[1] == pytest.approx(costs[0])
    right = evidence.from_contacts(Contacts(points, normals, 0.004, 0.1))
    expected = posterior.nats_of_contacts(model, right, 5, np.eye(4))
    assert posterior.contradiction(model, right, 5, np.eye(4)) == pytest.approx(expected, abs=0.1)


def test_an_answer_is_as_wide_across_the_rays_as_the_image_may_lie_beside(lab_frame):
    """Where the camera's model has the principal point wrong, the image of the object at one place is its image at
    another: half a pixel of 600 px at 0.6 m is half a millimetre. Without an image nothing is added.
    """
    mug, camera, pose = library.make("mug"), lab_frame.camera, poses.make_pose(np.eye(3), [0.02, -0.01, 0.6])
    mode, depth = Mode(pose, 1.0, 0.0, SHARP), replace(DepthModel(), shift_sigma=0.5)
    added = with_shift(mug, mode, lab_frame, depth).covariance - SHARP
    centre = poses.apply(pose, mug.centroid[None])[0]
    moved = centre + np.array([0.5 * centre[2] / camera.fx, 0.5 * centre[2] / camera.fy, 0.0])
    off = camera.project(np.array([centre, moved]))[0]
    np.testing.assert_allclose(off[1] - off[0], [0.5, 0.5], rtol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.diag(added)), [0, 0, 0, *(moved - centre)], atol=1e-12)
    assert np.count_nonzero(added - np.diag(np.diag(added))) == 0
    assert with_shift(mug, mode, replace(lab_frame, depth=None, mask=None), depth) is mode
    exact = with_shift(mug, mode, lab_frame, replace(depth, shift_sigma=0.0))
    assert np.array_equal(exact.covariance, SHARP)


@pytest.mark.parametrize("place", [[0.0, 0.0, 0.0], [0.0, 0.0, -0.5], [0.0, 0.0, 0.05], [0.0, 0.0, 30.0]])
@pytest.mark.parametrize("use", [("vision", "touch"), ("vision",), ("touch",)])
def test_a_start_where_no_camera_looks_is_lost(lab_frame, drill, place, use):
    start = poses.make_pose(np.eye(3), np.array(place) - drill.centroid)
    for frame in (lab_frame, replace(lab_frame, hand=None, joints=None, world_from_hand=None)):
        answer = estimate(frame, drill, prior=start, use=use)
        assert answer.verdict == "lost"
        assert np.isfinite(answer.pose).all()
        assert np.isfinite(answer.covariance).all()


def test_a_start_behind_the_camera_is_said_to_be(lab_frame, drill):
    behind = poses.make_pose(np.eye(3), [0.0, 0.0, -0.5])
    (why, *_) = estimate(lab_frame, drill, prior=behind, use=("vision",)).notes
    assert why == "no evidence: no pixel of the object near the start, which is behind the camera, and no contact"
