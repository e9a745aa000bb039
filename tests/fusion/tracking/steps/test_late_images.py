"""Images that are of another instant than what the robot reports beside them, told by a hand in view that moves."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from fusion.benchmarks.tracking.cells import Cell, sequence_of
from fusion.benchmarks.tracking.failing import FAILURES
from fusion.tracking.answer import TrackedEstimate, TrackSettings
from fusion.tracking.checkpoint import restore_tracker, save_tracker
from fusion.tracking.filter import Belief
from fusion.tracking.memory.held import Held
from fusion.tracking.memory.lateness import BELIEVED, FASTEST, RARE, Lateness, of_look
from fusion.tracking.memory.rest import Rest
from fusion.tracking.memory.state import TrackState
from fusion.tracking.motion import HandMotion, HandState
from fusion.tracking.slip import SlipWatch
from fusion.tracking.steps.doubts.delays import as_of_image, moved_on, put_down
from fusion.tracking.steps.predicting import predict
from fusion.tracking.tracker import Tracker, track
from scenes.evidence.modes import Mode
from scenes.geometry import poses
from scenes.recordings.beliefs import CalibrationModel
from scenes.recordings.frames import Contacts, Frame
from vision.look.hand.hand import HandTold
from vision.tracking.by_vision import ConstantVelocity

# What a look at a hand says, per axis (rad, m): the way along the second is hardly told, as of a hand seen edge on.
TOLD = np.array([0.02, 0.02, 0.04, 0.0005, 0.004, 0.0006])
CENTRE, CENTROID = np.array([0.02, 0.01, 0.6]), np.array([0.0, 0.05, 0.55])


def velocity_at(n, speed):
    return np.array([0.01, 0.0, 0.0, 0.0, speed * np.sin(0.7 * n), 0.5 * speed * np.cos(0.9 * n)])


def looks(late, count=12, speed=0.005, seed=0, noise=0.5, off=0.008):
    """Looks at a hand that moves to and fro, seen by images so many frames late: its motion, and what each says."""
    rng = np.random.default_rng(seed)
    calibration = np.array([0.02, -0.01, 0.0, off, 0.0, -off])
    turn = poses.random_rotations(1, rng)[0]
    axes = np.kron(np.eye(2), turn)
    information = axes @ np.diag(TOLD**-2.0) @ axes.T
    for n in range(count):
        velocity = velocity_at(n, speed)
        here = velocity.copy()
        here[3:] += np.cross(here[:3], CENTRE - CENTROID)
        seen = calibration - late * here + noise * axes @ (TOLD * rng.normal(size=6))
        yield velocity, HandTold(np.eye(4), CENTRE, information, information @ seen)


def looked(late, **how):
    told = Lateness()
    for velocity, seen in looks(late, **how):
        told = replace(told, velocity=velocity).looked(seen, CENTROID)
    return told


@pytest.mark.parametrize("late", [-1.0, 0.0, 0.1, 1.0, 2.0])
@pytest.mark.parametrize("seed", range(4))
def test_the_delay_is_found_beside_a_calibration(late, seed):
    told = looked(late, seed=seed)
    found, sigma = told.frames
    assert abs(found - late) < 4.0 * sigma < 1.0
    assert told.there == (found if abs(late) >= 1.0 else 0.0)
    assert bool(told.said) == (abs(late) >= 1.0)


def test_it_is_the_least_squares_answer():
    """Of all looks at once: a calibration, and a delay."""
    rows, values = [], []
    for velocity, seen in looks(1.3, seed=5):
        information, off = of_look(*seen.about(CENTRE))
        here = velocity.copy()
        here[3:] += np.cross(here[:3], CENTRE - CENTROID)
        root = np.linalg.cholesky(information).T
        rows.append(root @ np.column_stack([np.eye(6), -here]))
        values.append(root @ off)
    found = np.linalg.lstsq(np.concatenate(rows), np.concatenate(values), rcond=None)[0]
    assert looked(1.3, seed=5).frames[0] == pytest.approx(found[6], rel=1e-6)


def test_what_is_known_of_it_does_not_count_twice():
    """Looks at a hand that is expected where a delay has it find the same delay."""
    told = replace(looked(2.0), used=2.0)
    for velocity, seen in looks(0.0, seed=1):
        told = replace(told, velocity=velocity).looked(seen, CENTROID)
    assert told.there == pytest.approx(2.0, abs=4.0 * told.frames[1])


def test_it_is_said_in_words():
    assert looked(2.0, noise=0.0).said == ("images are 2.0 frames late, as the hand is seen to move: check the stamps",)
    assert "1.0 frames early" in looked(-1.0, noise=0.0).said[0]


@pytest.mark.parametrize("how", [{"count": 2}, {"speed": 0.0}, {"speed": 0.0003, "noise": 1.0}])
def test_few_looks_and_a_hand_that_hardly_moves_tell_of_none(how):
    told = looked(2.0, **how)
    assert told.there == 0.0
    # what any image may be late by is left
    np.testing.assert_allclose(told.smear, told.maybe * told.velocity)
    assert told.maybe < 1.5 * np.sqrt(RARE) * BELIEVED


def test_what_moves_too_fast_for_a_look_does_not_count():
    fast = np.array([0.0, 0.0, 0.0, 1.1 * FASTEST, 0.0, 0.0])
    before, (_, seen) = looked(1.0), next(looks(1.0))
    assert replace(before, velocity=fast).looked(seen, CENTROID).looks == before.looks
    # nor does a look twice
    once = before.looked(seen, CENTROID)
    assert once.looks == before.looks + 1.0
    assert once.looked(seen, CENTROID) is once
    assert before.looked(None, CENTROID) is before


def test_without_a_hand_nothing_is_smeared_by_how_it_moved_last(drill):
    """The next frame has no hand's pose: what is held may move any way."""
    state = TrackState(belief=Belief(np.eye(4), 1e-6 * np.eye(6), np.zeros((6, 6))), lateness=looked(2.0, noise=0.0))
    assert state.lateness.smear.any()
    velocity = ConstantVelocity(drill.centroid, TrackSettings().velocity)
    velocity.restart(0, np.eye(4))
    watch = SlipWatch(drill, 40.0, TrackSettings().slip)
    predict(drill, Frame(1), state.belief, state, velocity, HandMotion(drill), watch, CalibrationModel(), None)
    assert not state.lateness.smear.any()
    assert state.lateness.there > 1.5


def test_an_answer_is_as_wide_as_the_delay_makes_it(drill):
    """By all of it where reports are not taken as of the image, by how well it is known where they are."""
    settings = TrackSettings().sizes
    state = TrackState(belief=Belief(np.eye(4), 1e-6 * np.eye(6), np.zeros((6, 6))))
    plain = state.told(state.belief, settings).covariance
    state.lateness = replace(looked(2.0, noise=0.0), velocity=np.array([0.0, 0.0, 0.0, 0.0, 0.004, 0.0]))
    wide = state.told(state.belief, settings).covariance - plain
    assert wide[4, 4] == pytest.approx(0.008**2, rel=0.05)
    np.testing.assert_allclose(np.delete(np.delete(wide, 4, 0), 4, 1), 0.0, atol=1e-12)
    late, sigma = state.lateness.frames
    state.lateness = replace(state.lateness, used=late)
    known = state.told(state.belief, settings).covariance - plain
    assert known[4, 4] == pytest.approx((0.004 * sigma) ** 2, rel=1e-6)


@pytest.mark.parametrize(("late", "sigma"), [(0.0, 0.2), (0.4, 0.3), (1.0, 0.3), (1.0, 1.0), (-2.0, 0.05), (3.0, 20.0)])
def test_what_a_delay_may_be_is_what_bayes_makes_of_the_looks(monkeypatch, late, sigma):
    """By quadrature: a delay of none, or rarely of some frames, and what the looks say of either."""
    monkeypatch.setattr(Lateness, "frames", (late, sigma))
    delays = np.linspace(-12.0, 12.0, 200001)
    some = RARE * norm.pdf(delays, 0.0, BELIEVED) * norm.pdf(late, delays, sigma)
    none = (1.0 - RARE) * norm.pdf(late, 0.0, sigma)
    mean = np.trapezoid(some * delays**2, delays) / (np.trapezoid(some, delays) + none)
    assert Lateness().maybe == pytest.approx(np.sqrt(mean), rel=1e-4)


def test_an_answer_is_wider_while_a_delay_may_be(drill):
    settings = TrackSettings().sizes
    state = TrackState(belief=Belief(np.eye(4), 1e-6 * np.eye(6), np.zeros((6, 6))))
    plain = state.told(state.belief, settings).covariance
    wide = {}
    for late in (0.0, 1.0):
        unsure = replace(looked(late, count=4, noise=0.5, seed=2), velocity=np.array([0.0, 0.0, 0.0, 0.0, 0.006, 0.0]))
        assert not unsure.there
        state.lateness = unsure
        more = state.told(state.belief, settings).covariance - plain
        wide[late] = np.sqrt(more[4, 4])
        np.testing.assert_allclose(np.delete(np.delete(more, 4, 0), 4, 1), 0.0, atol=1e-12)
    assert wide[0.0] < 0.0012 < 0.002 < wide[1.0]


def path(n):
    """Where a robot that moves steadily has its hand at a time n, world_from_hand."""
    delta = n * np.array([0.02, -0.01, 0.03, 0.005, 0.002, -0.004])
    return poses.make_pose(poses.exp_rotation(delta[:3]), np.array([0.1, 0.0, 0.5]) + delta[3:])


def reported(n, late=0.0):
    told = Contacts(path(n)[None, :3, 3])
    return Frame(
        n, camera_from_world=poses.make_pose(poses.exp_rotation([0.3, 0.1, 0.0])), world_from_hand=path(n),
        contacts=told, cloud=np.array([[0.1, 0.2, 0.6]]),
    )  # fmt: skip


@pytest.mark.parametrize("late", [0.5, 1.0, 1.6, 2.0, -0.7])
def test_what_the_robot_reports_is_taken_as_of_the_image(late):
    """Hand and contacts together, as they were then; what the camera saw stays where it saw it."""
    state = TrackState(lateness=Lateness())
    for n in range(6):
        assert as_of_image(reported(n), state)[1] is None  # nothing is known of a delay
    delayed = replace(looked(late, noise=0.0), before=state.lateness.before)
    state.lateness = delayed
    frame = reported(6)
    then, on = as_of_image(frame, state)
    expected = frame.camera_from_world @ path(6 - state.lateness.used)
    assert state.lateness.used == pytest.approx(late, abs=0.05)
    np.testing.assert_allclose(then.camera_from_world @ then.world_from_hand, expected, atol=2e-4)
    felt = poses.apply(then.camera_from_world, then.contacts.points)
    np.testing.assert_allclose(felt[0], expected[:3, 3], atol=2e-4)
    seen = poses.apply(then.camera_from_world, then.cloud)
    np.testing.assert_allclose(seen, poses.apply(frame.camera_from_world, frame.cloud), atol=1e-9)
    if late < 0.0:  # the images are the newest, and the answer is of their time
        assert on is None
    else:
        np.testing.assert_allclose(on @ expected, frame.camera_from_world @ path(6), atol=2e-4)


def test_a_robot_that_has_only_begun_to_report_is_taken_as_it_is():
    state = TrackState(lateness=looked(2.0))
    frame = reported(0)
    assert as_of_image(frame, state) == (frame, None)
    assert state.lateness.used == 0.0
    assert as_of_image(Frame(1), state)[1] is None


def test_an_answer_is_moved_on_with_the_hand():
    rng = np.random.default_rng(2)
    pose, on, seen = (poses.make_pose(turn, rng.normal(size=3)) for turn in poses.random_rotations(3, rng))
    root = rng.normal(size=(6, 6))
    wide = root @ root.T
    answer = TrackedEstimate(0, pose, wide, (Mode(pose, 1.0, 0.0, wide),), "ok")
    state = TrackState(hand=HandState(np.eye(4), None, (), np.zeros((0, 3))))
    assert moved_on(answer, None, state, seen) is answer
    there = moved_on(answer, on, state, seen)
    motion = seen @ on @ poses.inverse(seen)
    np.testing.assert_allclose(there.pose, motion @ pose)
    np.testing.assert_allclose(there.modes[0].pose, there.pose)
    np.testing.assert_allclose(there.modes[0].covariance, there.covariance)
    turn = np.kron(np.eye(2), motion[:3, :3])
    np.testing.assert_allclose(turn.T @ there.covariance @ turn, wide, atol=1e-9)
    np.testing.assert_array_equal(there.as_seen, pose)  # the image shows it there


@pytest.mark.parametrize("late", ["images are one frame late", "images are two frames late"])
def test_a_track_with_late_images_is_of_the_frames_time(late):
    """A shake: 20 mm from frame to frame, so that two frames late are ten times what an answer may be off by."""
    cell = Cell("lab", "drill", 0, ("shake",), 24, (), 3, None)
    model, frames, _ = sequence_of(cell, "shake")
    told = FAILURES[late](list(frames), 8, np.random.default_rng(0))
    answers = list(track(told, model, seed=3))
    off = [np.linalg.norm(a.pose[:3, 3] - f.camera_from_object_truth[:3, 3]) for a, f in zip(answers, told)]
    assert np.median(off[12:]) < 0.006
    assert any("late, as the hand is seen to move" in note for note in answers[-1].notes)


def test_what_is_held_tells_where_no_hand_is_known():
    """The same shake, of a robot without a model of its hand."""
    cell = Cell("lab", "drill", 0, ("shake",), 24, (), 3, None)
    model, frames, _ = sequence_of(cell, "shake")
    told = FAILURES["images are two frames late"]([replace(one, hand=None) for one in frames], 8, None)
    answers = list(track(told, model, seed=3))
    off = [np.linalg.norm(a.pose[:3, 3] - f.camera_from_object_truth[:3, 3]) for a, f in zip(answers, told)]
    assert np.median(off[12:]) < 0.008
    assert any("late, as the hand is seen to move" in note for note in answers[-1].notes)


@pytest.mark.parametrize("late", [1.5, -1.5])
def test_what_is_held_must_tell_it_surely_and_that_they_are_late(late):
    """It may slip in the hand, as if images came early or late."""
    told = replace(looked(late, seed=3), hold=np.eye(4))
    assert told.there == (told.frames[0] if late > 0.0 else 0.0)
    found, sigma = told.frames
    doubted = replace(told, moved_moved=told.moved_moved, off_off=told.off_off + (60.0 * found / sigma) ** 2)
    assert doubted.there == 0.0


def test_a_hand_that_comes_into_view_tells_by_itself():
    before = replace(looked(1.0), used=1.0, hold=np.eye(4))
    told = before.of_hand
    assert (told.looks, told.hold, told.used) == (0.0, None, 1.0)
    assert told.of_hand is told


@pytest.mark.parametrize(("stays", "still", "looks"), [(True, 6, 0.0), (True, 5, 12.0), (False, 6, 12.0)])
def test_what_has_been_put_down_has_told_nothing(stays, still, looks):
    """It is taken up anew elsewhere in the hand; but images that are late do not know yet that it moves."""
    before = replace(looked(1.0), used=1.0, hold=np.eye(4))
    rest = Rest(np.eye(4), np.eye(4), still, np.eye(4))
    state = TrackState(lateness=before, held=Held(stays=stays), rest=rest)
    put_down(state)
    assert (state.lateness.looks, state.lateness.used) == (looks, 1.0)
    assert (state.lateness.hold is None) is (looks == 0.0)


def test_what_no_delay_explains_is_another_hold():
    """What is off by centimetres at once, by a camera that was moved or in another grasp, tells from there on."""
    before = replace(looked(0.0), hold=np.eye(4))
    for off, count, kept in [(0.008, 13.0, True), (0.2, 1.0, False)]:
        velocity, seen = next(looks(0.0, off=off))
        after = replace(before, velocity=velocity).looked(seen, CENTROID)
        assert after.looks == count
        assert (after.hold is not None) is kept


def test_a_track_that_was_saved_counts_no_look_twice():
    """Resumed in the midst, it goes on to the bit."""
    cell = Cell("lab", "drill", 0, ("shake",), 14, (), 3, None)
    model, frames, _ = sequence_of(cell, "shake")
    told = FAILURES["images are one frame late"](list(frames), 5, None)
    whole, resumed = Tracker(model, seed=3), Tracker(model, seed=3)
    for n, frame in enumerate(told):
        answer, again = whole.step(frame), resumed.step(frame)
        np.testing.assert_array_equal(answer.pose, again.pose)
        np.testing.assert_array_equal(answer.covariance, again.covariance)
        assert answer.notes == again.notes
        if n in (1, 4, 9):
            saved, resumed = save_tracker(resumed, frame.hand), Tracker(model, seed=3)
            restore_tracker(resumed, saved, frame.hand)
