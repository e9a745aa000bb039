"""A live tracker: searches run beside the frames that come, and what they find joins the track when they end."""

from concurrent.futures import Executor, Future
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from made_frames import CARRIED, off_by, recording

from fusion import Tracker, rehearse
from fusion.estimation.answer import Estimate, Mode
from fusion.tracking.answer import TrackSettings, as_tracked
from fusion.tracking.checkpoint import restore_tracker, save_tracker
from fusion.tracking.filter import Belief
from fusion.tracking.memory.hypotheses import Hypothesis, HypothesisSettings
from fusion.tracking.memory.state import TrackState
from fusion.tracking.steps.aside import ANEW, AROUND, Aside
from fusion.tracking.steps.searching import recover
from scenes.errors import CaptureError
from scenes.geometry import poses
from scenes.synthesis import library

HOW = HypothesisSettings()


class Later(Executor):
    """A worker that works when it is told to."""

    def __init__(self):
        self.asked = []

    def submit(self, work, /, *args, **kwargs):
        future = Future()
        self.asked.append((future, work, args))
        return future

    def work(self):
        for future, work, args in self.asked:
            if future.set_running_or_notify_cancel():
                try:
                    future.set_result(work(*args))
                except CaptureError as error:
                    future.set_exception(error)
        self.asked = []


@pytest.fixture(scope="module")
def mug():
    return library.make("mug")


@pytest.fixture(scope="module")
def carried(mug):
    return recording(mug)


def live(mug):
    tracker, worker = Tracker(mug, live=True), Later()
    tracker._aside = Aside(worker)
    return tracker, worker


def searched(answer):
    return [stage.why for stage in answer.trace if stage.name == "search anew"]


def followed(answers, frames, mug):
    for answer, frame in zip(answers, frames):
        turn, move = off_by(answer, frame, mug)
        assert turn < 2.5
        assert move < 2.0


def test_frames_do_not_wait_for_a_search_and_hear_of_it_when_it_ends(mug, carried):
    tracker, worker = live(mug)
    answers = [tracker.step(frame) for frame in carried[:8]]
    assert len(worker.asked) == 1
    assert not any(searched(answer) for answer in answers)
    # while it runs, frames are glanced at as ever
    assert any(stage.name == "glance" for answer in answers[4:] for stage in answer.trace)
    worker.work()
    answers += [tracker.step(carried[8])]
    assert "agrees" in searched(answers[8])[0]
    assert any(stage.name == "look" for stage in answers[8].trace)
    answers += [tracker.step(frame) for frame in carried[9:]]
    assert len(answers) == CARRIED
    followed(answers, carried, mug)


def test_a_search_that_never_ends_changes_nothing_but_the_searches(mug, carried):
    tracker, _ = live(mug)
    answers = [tracker.step(frame) for frame in carried]
    followed(answers, carried, mug)
    assert {answer.verdict for answer in answers} == {"ok"}


def test_a_search_that_ends_with_an_error_is_one_that_tells_nothing(mug, carried, monkeypatch):
    tracker, worker = live(mug)
    answers = [tracker.step(frame) for frame in carried[:5]]

    def fails(frame, prior):
        raise CaptureError("sizes that make no sense")

    worker.asked = [(future, fails, args) for future, _, args in worker.asked]
    worker.work()
    answers += [tracker.step(frame) for frame in carried[5:8]]
    followed(answers, carried, mug)


def test_a_tracker_that_is_not_live_waits(mug, carried):
    tracker = Tracker(mug)
    answers = [tracker.step(frame) for frame in carried[:5]]
    assert tracker._aside is None
    assert any(searched(answer) for answer in answers)


def test_a_saved_live_track_goes_on_without_the_search_that_ran(mug, carried):
    tracker, _ = live(mug)
    for frame in carried[:5]:
        tracker.step(frame)
    again = Tracker(mug, live=True)
    restore_tracker(again, save_tracker(tracker, carried[0].hand), carried[0].hand)
    assert again._aside is None
    again._aside = Aside(Later())
    followed([again.step(frame) for frame in carried[5:]], carried[5:], mug)


def test_a_thread_of_its_own_searches(mug, carried):
    tracker = Tracker(mug, live=True)
    answers = [tracker.step(frame) for frame in carried[:4]]
    assert tracker._aside is not None
    asked = tracker._aside._asked
    assert asked is not None
    asked.found.result(timeout=120.0)
    assert tracker._aside.ready == ANEW
    answers.append(tracker.step(carried[4]))
    assert searched(answers[4])
    followed(answers, carried, mug)


# --- what was found then, now


def estimate_at(pose):
    mode = Mode(pose, 1.0, 0.0, np.diag([1e-4] * 3 + [1e-6] * 3))
    return Estimate(0, pose, mode.covariance, (mode,), "ok", hand_from_object=np.eye(4), confidence=0.99)


def state_with(hand):
    return replace(TrackState(), hand=None if hand is None else SimpleNamespace(camera_from_hand=hand))


def believed(votes=1.0, right=1.0, **how):
    """A track that searches have spoken for."""
    return replace(state_with(None), right=right, hypotheses=(Hypothesis(np.eye(4), np.eye(6), 0.0, votes),), **how)


def estimate_near(pose):
    return replace(estimate_at(pose), notes=("looked for once more",), confidence=0.999)


def asked_and_moved(mug, found_at, then, now, hands=(None, None), switched=False):
    """Where a search's answer at found_at is now, when the track was at `then` and is at `now`."""
    covariance = np.diag([1e-4] * 3 + [1e-6] * 3)
    worker = Later()
    aside = Aside(worker)
    state = state_with(hands[0])
    aside.ask(ANEW, lambda frame, prior: estimate_at(found_at), None, None, Hypothesis(then, covariance, 0.0), state)
    worker.work()
    state = replace(state_with(hands[1]), leads=int(switched))
    return aside.result(mug, Hypothesis(now, covariance, 0.0), state, estimate_near, HOW)


@pytest.mark.parametrize("seed", range(3))
def test_what_was_found_moves_with_the_track_or_with_the_hand(mug, seed):
    rng = np.random.default_rng(seed)
    then, motion, slipped = (poses.make_pose(poses.random_rotations(1, rng)[0], rng.normal(size=3)) for _ in range(3))
    elsewhere = poses.displaced(then, 2.0, 0.05, mug.centroid, rng)
    hand = poses.make_pose(poses.random_rotations(1, rng)[0], rng.normal(size=3))
    # without a hand as the track moved; with one too, where both have it in one place, also while it slips
    for found_at, hands in ((elsewhere, (None, None)), (then, (None, None)), (then, (hand, slipped @ hand))):
        got = asked_and_moved(mug, found_at, then, motion @ then, hands)
        np.testing.assert_allclose(got.pose, motion @ found_at, atol=1e-12)
        np.testing.assert_allclose(got.modes[0].pose, motion @ found_at, atol=1e-12)
        if found_at is then:
            turn = np.kron(np.eye(2), motion[:3, :3])
            np.testing.assert_allclose(got.covariance, turn @ estimate_at(found_at).covariance @ turn.T, atol=1e-12)
            assert got.hand_from_object is None
        # elsewhere it has had time to move, and is no surer than the search that told where to look
        assert ("looked for once more" in got.notes) == (found_at is elsewhere)
        assert got.confidence == 0.99
    # what is elsewhere moves with the hand, as what the hand holds does
    got = asked_and_moved(mug, elsewhere, then, slipped @ then, (hand, motion @ hand))
    np.testing.assert_allclose(got.pose, motion @ elsewhere, atol=1e-9)


def test_when_another_leads_only_the_hand_tells_how_it_moved(mug):
    pose, hand = np.eye(4), np.eye(4)
    assert asked_and_moved(mug, pose, pose, pose, switched=True) is None
    assert asked_and_moved(mug, pose, pose, pose, (hand, hand), switched=True) is not None


def test_one_search_at_a_time_and_none_for_a_track_that_began_anew():
    worker, leader = Later(), Hypothesis(np.eye(4), np.eye(6), 0.0)
    aside, asked = Aside(worker), (None, None, leader, TrackState())

    def search(frame, prior):
        return estimate_at(np.eye(4))

    aside.ask(AROUND, search, *asked)
    aside.ask(ANEW, search, *asked)
    assert len(worker.asked) == 1
    assert aside.searching == AROUND
    assert aside.ready == ""
    worker.work()
    assert aside.ready == AROUND
    aside.heard(ANEW)
    assert aside.ready == AROUND
    aside.heard(AROUND)
    assert aside.ready == ""
    aside.ask(ANEW, search, *asked)
    aside.forget()
    worker.work()
    assert aside.ready == ""
    assert aside.searching == ""


def test_a_lost_object_is_searched_beside_the_frames_and_then_looked_for_where_it_was_found(mug, carried):
    before, found_at = np.eye(4), poses.make_pose(np.eye(3), [0.0, 0.1, 0.6])
    hand, moved = np.eye(4), poses.make_pose(np.eye(3), [0.01, 0.0, 0.0])
    state = replace(state_with(hand), lost_for=2, hypotheses=(Hypothesis(before, np.eye(6), 0.0),))
    lost = as_tracked(replace(estimate_at(before), verdict="lost"), "lost")
    worker, looked = Later(), []
    aside = Aside(worker)

    def estimated(frame, prior):
        looked.append(prior)
        if prior is None:
            return estimate_at(found_at)
        near = np.linalg.norm(prior.pose[:3, 3] - (moved @ found_at)[:3, 3]) < 0.02
        return replace(estimate_at(moved @ found_at), verdict="ok" if near else "lost")

    def step(heard):
        return recover(mug, carried[0], lost, None, state, estimated, aside, heard, TrackSettings())

    assert step("") is None
    assert [prior is None for prior in looked] == [False]
    worker.work()
    assert aside.ready == ANEW
    state = replace(state, lost_for=3, hand=SimpleNamespace(camera_from_hand=moved @ hand))
    found = step(ANEW)
    assert found is not None
    np.testing.assert_allclose(found.pose, moved @ found_at)
    assert aside.ready == ""
    # who waits finds it in the frame that is searched
    state = replace(state, lost_for=5)
    alone = recover(mug, carried[0], lost, None, state, estimated, None, "", TrackSettings())
    np.testing.assert_allclose(alone.pose, found_at)


@pytest.mark.parametrize(("off", "times"), [(0.01, 1), (0.06, 2)])
def test_where_a_lost_object_is_looked_for_is_no_evidence(mug, carried, off, times):
    lost = as_tracked(replace(estimate_at(np.eye(4)), verdict="lost"), "lost")
    found_at = poses.make_pose(np.eye(3), [off, 0.0, 0.0])
    looked = []

    def estimated(frame, prior):
        looked.append(prior)
        return replace(estimate_at(found_at), confidence=0.96 + 0.01 * len(looked))

    found = recover(mug, carried[0], lost, None, believed(), estimated, None, "", TrackSettings())
    assert len(looked) == times
    assert found.confidence == 0.96 + 0.01 * times
    # where it was thought to be, and then where it was found
    np.testing.assert_allclose(looked[-1].pose, np.eye(4) if times == 1 else found_at)


def test_what_is_found_near_a_track_that_was_likely_wrong_is_no_surer_than_that(mug, carried):
    lost = as_tracked(replace(estimate_at(np.eye(4)), verdict="lost"), "lost")

    def found(right, sure, verdict="ok", votes=1.0):
        def estimated(frame, prior):
            return replace(estimate_at(np.eye(4)), confidence=sure, verdict=verdict)

        return recover(mug, carried[0], lost, None, believed(votes, right), estimated, None, "", TrackSettings())

    assert found(0.999, 0.99).verdict == "ok"
    assert found(0.6, 0.99).confidence == 0.99
    assert found(0.2, 0.4, "ambiguous").confidence == 0.2
    doubted = found(0.1, 0.99)
    assert (doubted.verdict, doubted.confidence) == ("ambiguous", 0.1)
    assert "a track that is 10% sure" in doubted.notes[0]
    # nor near one that no search has spoken for
    assert found(0.999, 0.99, votes=0.3).verdict == "ambiguous"
    assert found(0.999, 0.99, votes=0.3).confidence == 0.6
    # and what is hardly ever right is not gone on with
    assert found(0.999, 0.35, "ambiguous").confidence == 0.35
    assert found(0.999, 0.25, "ambiguous") is None


def test_what_stands_where_it_was_let_go_is_found_there(mug, carried):
    """The hand has gone on 15 cm, and the prediction with it."""
    gone, stands = poses.make_pose(np.eye(3), [0.15, 0.0, 0.0]), np.eye(4)
    lost = as_tracked(replace(estimate_at(gone), verdict="lost"), "lost")
    state = believed(belief=Belief(stands, np.eye(6), np.zeros((6, 6))))
    looked = []

    def estimated(frame, prior):
        looked.append(prior.pose)
        near = np.allclose(prior.pose, stands)
        return replace(estimate_at(prior.pose), verdict="ok" if near else "lost")

    found = recover(mug, carried[0], lost, None, state, estimated, None, "", TrackSettings())
    np.testing.assert_allclose(found.pose, stands)
    np.testing.assert_allclose(looked, [gone, stands])


def test_what_was_not_found_is_nowhere_to_look():
    leader, worker = Hypothesis(np.eye(4), np.eye(6), 0.0), Later()
    aside = Aside(worker)
    for word, sure in (("lost", 0.9), ("ambiguous", 0.3)):
        found = replace(estimate_at(np.eye(4)), verdict=word, confidence=sure)
        aside.ask(ANEW, lambda frame, prior, found=found: found, None, None, leader, TrackState())
        worker.work()
        assert aside.place(TrackState(), 0.5) is None


def test_a_rehearsal_searches_by_itself_and_around_what_it_believes(mug, carried):
    asked, made = [], []

    class Heard(Tracker):
        def estimated(self, frame, prior):
            asked.append(prior)
            return super().estimated(frame, prior)

    def new_tracker():
        made.append(Heard(mug))
        return made[-1]

    first = carried[0]
    rehearse(new_tracker, first)
    assert len(made) == 1
    assert asked[-2] is None
    assert asked[-1].pose.shape == (4, 4)


def test_a_rehearsal_refuses_what_a_track_would(mug, carried):
    elsewhere = replace(carried[0], depth=1e6 * carried[0].depth)  # no unit makes this a table top
    with pytest.raises(CaptureError):
        Tracker(mug).step(elsewhere)
    with pytest.raises(CaptureError):
        rehearse(lambda: Tracker(mug), elsewhere)
