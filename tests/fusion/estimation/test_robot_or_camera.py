"""Depth that is off and a robot that is off show the same picture: an answer must say that it does not know which."""

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
import trimesh
from made_frames import plain_view

from fusion.estimation.estimate import estimate
from fusion.estimation.posterior.verdict import VerdictSettings, contact_residuals, verdict
from fusion.estimation.settings import EstimateSettings
from fusion.truth.errors import Judge
from scenes.evidence.modes import Mode
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.synthesis import library
from scenes.synthesis.recording import synthesize_frames
from touch.contacts import Contacts
from vision.visibility import Visibility

# how far depth, or the robot, is off (m): one standard deviation of either, as they are believed at half a metre
OFF = 0.003


@pytest.fixture(scope="module")
def both(exact_frame, drill):
    """Frames with 1.2 mm of noise in which depth is 3 mm too far, and in which the robot says 3 mm too near; answers by
    vision with a start.
    """
    rng = np.random.default_rng(3)
    seen = exact_frame.depth > 0
    noisy = np.where(seen, exact_frame.depth + 0.0012 * rng.normal(size=seen.shape), 0.0).astype(np.float32)
    start = poses.perturb(exact_frame.camera_from_object_truth, 0.01 * np.ones(6), drill.centroid)
    frame = replace(exact_frame, depth=noisy, rgb=None, prior=start)
    far = replace(frame, depth=np.where(seen, noisy + OFF, 0.0).astype(np.float32))
    nearer = poses.make_pose(None, [0.0, 0.0, -OFF])
    near = replace(frame, camera_from_world=nearer @ frame.camera_from_world)
    return [(one, estimate(one, drill, use=("vision",))) for one in (far, near)]


def along(pose, model):
    """Distance (m) of the object's middle along the camera's axis."""
    return float((pose[:3, :3] @ model.centroid + pose[:3, 3])[2])


def test_the_same_picture_has_the_same_answer(both, drill):
    """The second is the first, all of it 3 mm nearer, but for how much wider depth's errors are farther away."""
    (_, far), (_, near) = both
    assert along(far.pose, drill) - along(near.pose, drill) == pytest.approx(OFF, abs=0.0005)


def test_it_is_as_unsure_as_both_may_be_off(both, drill):
    """Of 3 mm between depth and robot nobody knows whose they are: neither answer is surer than a third of them."""
    for frame, answer in both:
        sigma = float(np.sqrt(answer.covariance[5, 5]))
        assert 0.001 < sigma < 0.004
        assert abs(along(answer.pose, drill) - along(frame.camera_from_object_truth, drill)) < 2.0 * sigma


def test_a_false_contact_or_two_lose_nothing_that_the_image_shows(drill):
    """Contacts that no pose explains leave what the image shows in doubt; three of them, or an object that it does not
    show, are lost.
    """
    mode = Mode(np.eye(4), 1.0, 0.0, 1e-8 * np.eye(6))
    points, normals = drill.sample_surface(3, 0)
    away = Contacts(points + 0.05 * normals, normals, 0.001, 0.1)
    residuals = contact_residuals(drill, away, np.eye(4))
    assert all(one.outlier for one in residuals)
    shown, unseen = Visibility(0.6, 0.4, 0.0, 0.0), Visibility(0.0, 1.0, 0.0, 0.0)
    few = VerdictSettings().few_fingers
    assert verdict(drill, (mode,), residuals[:few], 0.95, shown)[0] == "ambiguous"
    assert verdict(drill, (mode,), residuals, 0.95, shown)[0] == "lost"
    assert verdict(drill, (mode,), residuals[:1], 0.95, unseen)[0] == "lost"
    assert verdict(drill, (mode,), residuals[:1], float("nan"), shown)[0] == "lost"


def test_taxels_of_a_finger_have_its_one_vote(drill):
    """Eight taxels of one finger that touched something else are one of four fingers, which say otherwise."""
    mode = Mode(np.eye(4), 1.0, 0.0, 1e-8 * np.eye(6))
    points, normals = drill.sample_surface(11, 0)
    wrong = np.arange(11) < 8
    felt = Contacts(points + np.where(wrong, 0.03, 0.0)[:, None] * normals, normals, 0.001, 0.1)
    shown, part = Visibility(0.6, 0.4, 0.0, 0.0), np.where(wrong, 1 / 8, 1.0)
    by_finger = contact_residuals(drill, felt, np.eye(4), of_finger=part)
    assert verdict(drill, (mode,), by_finger, 0.95, shown)[0] == "ok"
    assert verdict(drill, (mode,), contact_residuals(drill, felt, np.eye(4)), 0.95, shown)[0] == "lost"
    # nor is what the image shows lost for one finger alone
    assert verdict(drill, (mode,), by_finger[:8], 0.95, shown)[0] == "ambiguous"


@pytest.mark.parametrize("count", [2, 4])
def test_half_of_the_contacts_are_no_majority(drill, count):
    """Where as many contacts contradict a pose as agree with it, it is not `ok`, however well the image shows it; where
    there are but two, only if it does not.
    """
    mode = Mode(pose=np.eye(4), weight=1.0, covariance=1e-8 * np.eye(6), cost=0.0)
    points, normals = drill.sample_surface(count, 0)
    half = Contacts(points + np.where(np.arange(count) % 2, 0.02, 0.0)[:, None] * normals, normals, 0.001, 0.1)
    residuals = contact_residuals(drill, half, np.eye(4))
    assert sum(one.outlier for one in residuals) == count // 2
    shown, unseen = Visibility(0.6, 0.4, 0.0, 0.0), Visibility(0.0, 1.0, 0.0, 0.0)
    assert verdict(drill, (mode,), residuals, 0.95, shown)[0] == ("ok" if count == 2 else "ambiguous")
    assert verdict(drill, (mode,), residuals, 0.95, unseen)[0] == "ambiguous"
    assert verdict(drill, (mode,), (*residuals, residuals[0]), 0.95, shown)[0] == "ok"


def test_what_a_rule_doubts_is_not_as_sure_as_an_ok_answer(exact_frame, drill):
    """The camera shows the object, and three of four contacts, told to be sharp, are where it is not."""
    points, normals = drill.sample_surface(4, 7)
    place = exact_frame.camera_from_object_truth
    points = poses.apply(place, points + np.array([0.0, 0.03, -0.03, 0.03])[:, None] * normals)
    felt = Contacts(points, normals @ place[:3, :3].T, 0.0004, 0.05)
    start = poses.perturb(place, 0.01 * np.ones(6), drill.centroid)
    bare = replace(exact_frame, rgb=None, prior=start, hand=None, joints=None, world_from_hand=None)
    answer = estimate(replace(bare, contacts=felt, camera_from_world=np.eye(4)), drill)
    assert answer.verdict != "ok"
    assert answer.confidence <= VerdictSettings().most_doubted


def test_depth_without_noise_is_no_surer_than_believed(exact_frame, drill):
    """Filters take noise away and leave what is shared: an image without any narrows nothing."""
    start = poses.perturb(exact_frame.camera_from_object_truth, 0.01 * np.ones(6), drill.centroid)
    frame = replace(exact_frame, rgb=None, prior=start)
    usual = EstimateSettings()
    doubting, believing = (
        estimate(frame, drill, use=("vision",), settings=replace(usual, joint=replace(usual.joint, least_misfit=least)))
        for least in (1.0, 0.01)
    )
    wider = np.linalg.det(doubting.covariance) / np.linalg.det(believing.covariance)
    assert wider > 1.2**6
    assert estimate(frame, drill, use=("vision",)).covariance == pytest.approx(doubting.covariance)


@pytest.mark.parametrize("off", [(0.0, 0.006, 0.003), (0.005, 0.005, 0.005), (0.0, 0.0, 0.008)])
def test_contacts_that_are_off_together_are_no_false_ones(exact_frame, drill, off):
    """Sharp contacts of a rig that is off by more than they say of themselves, while nobody knows the hand: one by one
    each would be a false one.
    """
    points, normals = drill.sample_surface(8, 7)
    place = exact_frame.camera_from_object_truth
    felt = Contacts(poses.apply(place, points) + np.array(off), normals @ place[:3, :3].T, 0.0004, 0.05)
    start = poses.perturb(place, 0.01 * np.ones(6), drill.centroid)
    bare = replace(exact_frame, rgb=None, prior=start, hand=None, joints=None, world_from_hand=None)
    answer = estimate(replace(bare, contacts=felt, camera_from_world=np.eye(4)), drill)
    assert answer.verdict == "ok"
    assert not any(contact.outlier for contact in answer.contacts)


def with_arm(frame, length):
    """The frame with an arm of that length (m) behind the hand, of which nobody has a model."""
    tips = [pose[:3, 3] for pose in frame.hand.hand_from_sensor(frame.joints).values()]
    away = -np.mean(tips, axis=0) / np.linalg.norm(np.mean(tips, axis=0))
    arm = trimesh.creation.cylinder(0.035, segment=np.array([0.02 * away, (0.02 + length) * away]), sections=32)
    place = {"arm": frame.camera_from_world @ frame.world_from_hand}
    depth = Renderer({"arm": (arm.vertices, arm.faces)}).render(frame.camera, place).depth
    nearer = (depth > 0) & ((frame.depth == 0) | (depth < frame.depth))
    noise = np.random.default_rng(0).normal(0.0, 0.0006, depth.shape)
    return replace(frame, depth=np.where(nearer, depth + noise, frame.depth).astype(np.float32))


def test_an_arm_that_nobody_models_is_not_taken_for_what_the_hand_holds(hand):
    """Half of what is at the hand is the arm's: the answer leaves it unexplained, and the object is looked for anew."""
    hammer = library.make("hammer")
    frame = synthesize_frames(hammer, hand, 1, 0.3, noise="lab", seed=3)[0]
    bare = replace(frame, mask=None, prior=None, rgb=None, contacts=Contacts(np.zeros((0, 3))))

    def again(answer):
        return [stage for stage in answer.trace if stage.name == "look again"]

    alone = estimate(bare, hammer, use=("vision",))
    assert [stage.ran for stage in again(alone)] == [False]
    found = estimate(with_arm(bare, 0.1), hammer, use=("vision",))
    assert [stage.ran for stage in again(found)] == [True]
    judge = Judge(hammer)
    for answer in (alone, found):
        assert answer.verdict == "ok"
        assert judge.errors(answer.pose, frame.camera_from_object_truth).add_s < 0.004
    # twice the same, and not where there is no time for it
    assert np.array_equal(estimate(with_arm(bare, 0.1), hammer, use=("vision",)).pose, found.pose)
    hurried = estimate(with_arm(bare, 0.1), hammer, use=("vision",), budget_ms=1.0)
    assert not any(stage.ran for stage in again(hurried))
    started = estimate(with_arm(replace(bare, prior=frame.prior), 0.1), hammer, use=("vision",))
    assert not any(stage.ran for stage in again(started))
    # nor do two senses take it for that: one finger says where the object is, not where it ends
    touched = estimate(with_arm(replace(bare, contacts=frame.contacts.take([0])), 0.1), hammer)
    assert [stage.ran for stage in again(touched)] == [True]
    assert touched.verdict == "ok"
    assert judge.errors(touched.pose, frame.camera_from_object_truth).add_s < 0.004


@pytest.mark.parametrize(
    ("touched", "words", "told"),
    [
        (True, ("lost", "ambiguous"), 0),
        (True, ("lost", "ok"), 1),
        (True, ("ambiguous", "ambiguous"), 1),
        (False, ("lost", "ambiguous"), 1),
    ],
)
def test_what_contacts_contradict_stays_lost_unless_another_look_is_sure(monkeypatch, touched, words, told):
    """Parts of what else is in view look like an object that is not held, and nothing touches them."""
    module = import_module("fusion.estimation.estimate")
    model, frame = library.make("box"), plain_view("box")
    one = estimate(frame, model)
    answers = [replace(one, verdict=word, confidence=sure) for word, sure in zip(words, (0.1, 0.6))]
    left, look = iter(answers), module.look_once
    monkeypatch.setattr(module, "_estimate", lambda *_: next(left))
    monkeypatch.setattr(module, "look_once", lambda *asked: replace(look(*asked), at_touch=touched))
    monkeypatch.setattr(module, "doubted", lambda model, first, looked, answered, *_: answered[0])
    monkeypatch.setattr(module, "look_again", lambda model, asked, trace, looked, answer: looked)
    answer = estimate(frame, model)
    assert (answer.verdict, answer.confidence) == (words[told], answers[told].confidence)
