"""A frame is held against a track as the frame has it: where it shows it, by its own answer, as wide as that is."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import recording

import fusion.tracking.steps.judging as judging
from fusion.tracking.answer import TrackSettings
from fusion.tracking.memory.state import GlanceSettings, TrackState
from fusion.tracking.motion import HandState
from fusion.tracking.slip import Watched
from fusion.tracking.steps.refining import prefers
from fusion.tracking.tracker import Tracker
from scenes.geometry import poses
from scenes.synthesis import library

FEWEST = TrackSettings().fewest_pixels


@pytest.fixture(scope="module")
def mug():
    return library.make("mug")


def test_a_search_is_held_against_the_track_where_the_image_shows_both(mug):
    """A camera whose scale is off shows the object nearer than it is; what solves for that has not missed it."""
    tracker = Tracker(mug, settings=TrackSettings(glance=GlanceSettings(every=1)))
    answer = [tracker.step(frame) for frame in recording(mug, 5)][-1]
    seen, s = replace(tracker._sensed, seen_from=np.eye(4)), tracker.settings
    alone = tracker.estimated(replace(seen.viewed, prior=None), None)
    back = np.eye(4)
    back[:3, 3] = 0.02 * answer.pose[:3, 3]
    shown = answer.pose  # by a depth image two hundredths too short
    found = replace(alone, pose=back @ answer.pose, as_seen=shown)
    assert abs(prefers(answer, found, seen, s)) < 1e-6
    assert prefers(answer, replace(found, as_seen=None), seen, s) > s.hypotheses.missed
    same = replace(answer, pose=back @ answer.pose)
    assert abs(prefers(same, found, replace(seen, seen_from=poses.inverse(back)), s)) < 1e-6


def test_contacts_contradict_a_track_only_where_they_contradict_the_frames_own_answer(mug, monkeypatch):
    for own, lost in ((0.0, False), (1e6, True)):
        tracker = Tracker(mug, settings=TrackSettings(glance=GlanceSettings(every=1)))
        frames, words = recording(mug, 6), []
        for frame in frames[:5]:
            tracker.step(frame)

        def judge(model, found, solved, belief, *more, own=own, words=words, plain=judging.judge):
            def contradiction(model, felt, count, pose, settings=None):
                return own if np.array_equal(pose, solved.pose) else 1e6

            with monkeypatch.context() as patched:
                patched.setattr(judging.posterior, "contradiction", contradiction)
                said = plain(model, found, solved, belief, *more)
            words.append(said.verdict)
            return said

        with monkeypatch.context() as patched:
            patched.setattr("fusion.tracking.tracker.judge", judge)
            tracker.step(frames[5])
        assert (words == ["lost"]) == lost


def test_a_step_that_prediction_and_frame_leave_open_is_no_leap():
    s, step = TrackSettings(), np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert s.leaps(step)
    assert s.leaps(step, np.diag(np.repeat([0.03, 0.003], 3) ** 2))
    assert not s.leaps(step, np.diag(np.repeat([0.15, 0.003], 3) ** 2))
    assert not s.leaps(0.1 * step, np.diag(np.repeat([1e-3, 1e-4], 3) ** 2))


def test_what_no_search_speaks_for_is_in_doubt(mug):
    """It is right about as often as it says; the doubt is told once, though it is asked before a search and after."""
    tracker = Tracker(mug)
    answer = [tracker.step(frame) for frame in recording(mug, 2)][-1]
    alone = tuple(replace(one, votes=0.0) for one in tracker._state.hypotheses)
    doubted = judging.as_believed(mug, answer, alone, tracker.settings)
    again = judging.as_believed(mug, doubted, alone, tracker.settings)
    assert doubted.verdict == "ambiguous"
    assert doubted.confidence <= tracker.settings.hypotheses.unvoted_told < tracker.settings.confident.sure
    assert np.trace(doubted.covariance) > np.trace(answer.covariance)
    assert again.notes == doubted.notes
    assert len(doubted.notes) == len(answer.notes) + 1
    low = replace(answer, confidence=0.3)
    assert judging.as_believed(mug, low, alone, tracker.settings).confidence == 0.3


SLIP = Watched(slip=True, moved=True, statistic=2.0, by="its poses do not go with the hand")


@pytest.mark.parametrize(
    ("watched", "pixels", "seen", "held", "unseen"),
    [
        (SLIP, 0, True, True, True),
        (SLIP, FEWEST - 1, True, True, True),
        (SLIP, FEWEST, True, True, False),
        (replace(SLIP, by_skin=True), 0, True, True, False),
        (Watched(), 0, True, True, False),
        # nobody has ever seen it: what is felt is all there is
        (SLIP, 0, False, True, False),
        (SLIP, 0, True, False, False),
    ],
)
def test_a_slip_of_what_was_seen_is_not_proven_by_fingers_alone(watched, pixels, seen, held, unseen):
    hand = HandState(np.eye(4), {}, (), np.zeros((0, 3))) if held else None
    state = TrackState(hand=hand, seen_at=np.eye(4) if seen else None)
    assert judging.slips_unseen(watched, pixels, state, TrackSettings()) == unseen


@pytest.mark.parametrize("image", [True, False], ids=["in sight", "out of sight"])
@pytest.mark.parametrize("slip", [[0.0, 0.0, 0.15, 0.0, 0.004, 0.0], [0.15, 0.0, 0.1, 0.0, 0.0, 0.005]])
def test_what_slips_out_of_sight_goes_with_the_hand_until_it_is_seen(slip, image):
    """Slips that the contacts alone are fitted by: by them the object would be elsewhere, and `ok`."""
    drill = library.make("drill")
    frames = recording(drill, 14, slip={8: np.array(slip)})
    nothing = np.zeros_like(frames[0].depth)
    tracker = Tracker(drill, seed=2)
    shown = [one if image or one.index < 6 else replace(one, depth=nothing) for one in frames[:12]]
    said = [tracker.step(one) for one in shown][8:]
    assert any(answer.slip for answer in said) == image
    assert {(answer.how, answer.verdict) for answer in said} == {
        ("tracked", "ok") if image else ("carried", "ambiguous")
    }
    # seen again, it is where it is
    last = [tracker.step(frame) for frame in frames[12:]][-1]
    truth = frames[-1].camera_from_object_truth
    assert np.linalg.norm(last.pose[:3, 3] - truth[:3, 3]) < 0.002
