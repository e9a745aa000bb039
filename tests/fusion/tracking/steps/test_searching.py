"""What a frame says by itself around a track is held against how sure the track is of its answer, of all of it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import fusion.tracking.steps.searching as searching
from fusion.estimation.answer import Estimate, Mode, Stage
from fusion.tracking.answer import TrackSettings, as_tracked
from fusion.tracking.memory.hypotheses import Hypothesis, HypothesisSettings
from fusion.tracking.memory.state import TrackState
from scenes.evidence.align import Prior
from scenes.geometry import poses
from scenes.recordings.frames import Frame
from scenes.synthesis import library

KNOWN, OPEN = 0.001, 0.02  # how well the place of an answer is known, metres
S = HypothesisSettings()


@pytest.fixture(scope="module")
def block():
    return library.make("l_block")


def said(pose, sigma, sure, verdict="ambiguous"):
    covariance = np.diag([1e-4] * 3 + [sigma**2] * 3)
    modes = (Mode(pose, 1.0, 0.0, covariance),)
    return Estimate(9, pose, covariance, modes, verdict, trace=(Stage("judge", True, ""),), confidence=sure)


def tracked(sigma, votes=0.0):
    """A track that is likely the right one, its place known so well."""
    answer = as_tracked(said(np.eye(4), sigma, 0.6), "tracked")
    leader = Hypothesis(np.eye(4), answer.covariance, 0.0, votes, age=5)
    return answer, replace(TrackState(), right=0.95, hypotheses=(leader,))


@pytest.fixture
def unknown_fingers(monkeypatch):
    """A frame in which nothing tells what hides the object, and which prefers what it has itself found."""
    monkeypatch.setattr(searching, "prefers", lambda *_: -1.0)
    seen = SimpleNamespace(viewed=SimpleNamespace(index=9), told_apart=False, looked=SimpleNamespace(pixels=[0]))
    return Frame(9), seen


@pytest.mark.parametrize(("sigma", "goes"), [(KNOWN, False), (OPEN, True)])
def test_a_track_that_does_not_know_where_goes_on_from_a_frame_that_does(block, unknown_fingers, sigma, goes):
    frame, seen = unknown_fingers
    answer, state = tracked(sigma)
    found, begun = said(poses.make_pose(None, [0.004, 0.0, 0.0]), KNOWN, 0.7), []
    searching.look_closer(
        block, frame, answer, seen, state, lambda *_: found, lambda *how: begun.append(how), TrackSettings()
    )
    assert bool(begun) is goes


@pytest.mark.parametrize(("sigma", "thought_of"), [(KNOWN, 1), (OPEN, 2)])
def test_what_is_surer_around_such_a_track_is_followed_too(block, unknown_fingers, sigma, thought_of):
    frame, seen = unknown_fingers
    answer, state = tracked(sigma)
    found = said(poses.make_pose(None, [0.2, 0.0, 0.0]), KNOWN, 0.7)
    searching.search_around(block, frame, answer, seen, state, lambda *_: found, TrackSettings())
    assert len(state.hypotheses) == thought_of


def test_searches_around_a_track_never_make_it_believed(block, unknown_fingers):
    frame, seen = unknown_fingers
    answer, state = tracked(KNOWN)
    found = said(poses.make_pose(None, [0.2, 0.0, 0.0]), KNOWN, 0.99, "ok")
    for _ in range(3):
        searching.search_around(block, frame, answer, seen, state, lambda *_: found, TrackSettings())
        assert [h.votes for h in state.hypotheses] == [0.0, S.most_repeated]


@pytest.mark.parametrize(
    ("away", "word", "nats", "followed"),
    [(0.3, "ok", -2.0, 1), (0.02, "ok", -2.0, 2), (0.3, "ambiguous", -2.0, 2), (0.3, "ok", -20.0, 2)],
)
def test_another_like_it_beside_a_sure_track_is_not_it(block, unknown_fingers, monkeypatch, away, word, nats, followed):
    """Both may be there, and one was followed until now; unless the track is not sure, or the frame likes it less."""
    frame, seen = unknown_fingers
    monkeypatch.setattr(searching, "prefers", lambda *_: nats)
    monkeypatch.setattr(searching, "search_around", lambda *_: "")
    answer, state = tracked(KNOWN, votes=1.0)
    answer = replace(answer, verdict=word, confidence=0.99)
    found = said(poses.make_pose(None, [away, 0.0, 0.0]), KNOWN, 0.99, "ok")
    after = searching.renew(block, frame, answer, seen, state, lambda *_: found, lambda *_: None, TrackSettings())
    assert len(state.hypotheses) == followed
    assert (state.hypotheses[0].votes == 1.0) == (followed == 1)
    assert after.trace[-1].name == "search anew"


@pytest.mark.parametrize(("own", "word"), [(0.001, "ok"), (0.015, "ambiguous")], ids=["tells", "leaves open"])
def test_a_place_to_look_at_is_no_evidence(block, own, word):
    """Of a posterior the prior is taken out: what the frame alone says is told, and how sure it is of that."""
    settings = TrackSettings().first
    around = Prior.isotropic(np.eye(4), np.deg2rad(6.0), 0.006)
    data = np.diag([1e-5] * 3 + [own**2] * 3)
    both = np.linalg.inv(np.linalg.inv(data) + around.information)
    found = replace(said(np.eye(4), KNOWN, 0.98, "ok"), covariance=both, modes=(Mode(np.eye(4), 1.0, 0.0, both),))
    alone = searching.by_itself(block, found, around, settings)
    np.testing.assert_allclose(np.diag(alone.modes[0].covariance), np.diag(data), rtol=0.1)
    assert alone.verdict == word
    assert alone.confidence <= found.confidence
    assert (alone.confidence >= settings.confidence.sure) == (word == "ok")
    assert np.diag(alone.covariance)[3] >= 0.99 * own**2
    assert searching.by_itself(block, found, None, settings) is found


def test_a_frame_that_tells_nothing_around_a_track_leaves_all_open(block):
    settings = TrackSettings().first
    around = Prior.isotropic(np.eye(4), np.deg2rad(6.0), 0.006)
    prior = np.linalg.inv(around.information)
    found = replace(said(np.eye(4), KNOWN, 0.5), covariance=prior, modes=(Mode(np.eye(4), 1.0, 0.0, prior),))
    alone = searching.by_itself(block, found, around, settings)
    assert np.isfinite(alone.modes[0].covariance).all()
    assert np.sqrt(alone.modes[0].covariance[3, 3]) > 0.5 * block.radius
    assert alone.confidence < 0.1


@pytest.mark.parametrize(("apart", "votes"), [(0.001, 1.0 + S.part), (0.05, 1.0)], ids=["alike", "elsewhere"])
def test_a_search_speaks_for_the_track_where_it_finds_the_surface(block, unknown_fingers, monkeypatch, apart, votes):
    """A likely search that is not sure names several places: that the track's is among them is no vote for it."""
    frame, seen = unknown_fingers
    monkeypatch.setattr(searching, "search_around", lambda *_: "")
    monkeypatch.setattr(searching, "lets_go", lambda *_: False)
    answer, state = tracked(KNOWN, votes=1.0)
    covariance = np.diag([1e-4] * 3 + [KNOWN**2] * 3)
    modes = tuple(
        Mode(poses.make_pose(None, [x, 0.0, 0.0]), weight, 0.0, covariance) for x, weight in ((apart, 0.9), (0.0, 0.1))
    )
    found = replace(said(modes[0].pose, KNOWN, 0.86), modes=modes)
    searching.renew(block, frame, answer, seen, state, lambda *_: found, lambda *_: None, TrackSettings())
    leader = next(h for h in state.hypotheses if np.array_equal(h.pose, answer.pose))
    assert leader.votes <= votes
    assert (leader.votes > 1.0) == (votes > 1.0)


@pytest.mark.parametrize(
    ("track", "alone", "mask", "hand", "taken"),
    [
        ("ambiguous", "ok", True, None, True),
        ("ok", "ok", True, None, False),
        ("ambiguous", "ambiguous", True, None, False),
        ("ambiguous", "ok", False, None, False),
        ("ambiguous", "ok", True, "a hand", False),
    ],
)
def test_a_doubted_frame_with_a_mask_is_asked_by_itself(block, unknown_fingers, track, alone, mask, hand, taken):
    frame, seen = unknown_fingers
    frame = replace(frame, mask=np.ones((2, 2), dtype=bool) if mask else None)
    seen.told_apart = True
    answer, state = tracked(OPEN)
    answer, state = replace(answer, verdict=track), replace(state, hand=hand)
    found, asked = said(np.eye(4), KNOWN, 0.97, alone), []

    def estimated(*_):
        asked.append(1)
        return found

    asks = block, frame, answer, seen, state, estimated, TrackSettings()
    told, alone_found = searching.surer_alone(*asks)
    assert (alone_found is found) is taken
    assert told.pose is answer.pose
    due = state.renewal.alone
    if asked and not taken:  # in vain: not in this frame again
        assert due > frame.index
        assert told.trace[-1].name == "search alone"
        assert searching.surer_alone(*asks)[1] is None
        assert len(asked) == 1


@pytest.mark.parametrize(
    ("how", "lost_for", "everywhere"),
    [
        ("carried", 1, True),
        ("carried", 2, True),
        ("carried", 3, False),
        ("carried", 5, True),
        ("lost", 1, False),
        ("lost", 2, True),
    ],
)
def test_an_object_that_nothing_is_seen_near_is_looked_for_everywhere_at_once(block, how, lost_for, everywhere):
    """There is nothing to look around; where something else was found there, it is looked around first."""
    lost, looked = as_tracked(said(np.eye(4), KNOWN, 0.0, "lost"), how), []
    state = replace(tracked(KNOWN)[1], lost_for=lost_for)

    def estimated(frame, prior):
        looked.append(prior)
        return said(np.eye(4), KNOWN, 0.0, "lost")

    assert searching.recover(block, Frame(9), lost, None, state, estimated, None, "", TrackSettings()) is None
    assert [prior is None for prior in looked] == [False] * (how == "lost") + [True] * everywhere


@pytest.mark.parametrize(("away", "places"), [(0.005, 1), (0.3, 2)])
def test_a_lost_object_is_looked_for_where_another_hypothesis_has_it(block, away, places):
    """The frame may hold it for the likeliest by far, which leads only once searches have spoken for it."""
    there = poses.make_pose(None, [away, 0.0, 0.0])
    lost = as_tracked(said(np.eye(4), KNOWN, 0.0, "lost"), "lost")
    lost = replace(lost, modes=(replace(lost.modes[0], weight=0.0), replace(lost.modes[0], pose=there)))
    looked, state = [], replace(tracked(KNOWN, votes=1.0)[1], lost_for=1)

    def estimated(frame, prior):
        looked.append(prior.pose)
        near = np.linalg.norm(prior.pose[:3, 3] - there[:3, 3]) < 0.01
        return said(there, KNOWN, 0.97 if near else 0.0, "ok" if near else "lost")

    found = searching.recover(block, Frame(9), lost, None, state, estimated, None, "", TrackSettings())
    assert found is not None
    np.testing.assert_allclose(found.pose, there)
    assert len(looked) == places
