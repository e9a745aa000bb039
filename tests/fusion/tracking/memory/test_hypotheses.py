"""Several hypotheses: weighed, voted for, merged; a track that begins wrong finds out; one that cannot know says so."""

from dataclasses import replace

import numpy as np
import pytest

from fusion.estimation.answer import Mode
from fusion.estimation.estimate import estimate
from fusion.tracking.memory import hypotheses as several
from fusion.tracking.memory.hypotheses import Hypothesis, HypothesisSettings
from fusion.tracking.memory.occluders import Occluders
from fusion.tracking.memory.state import Renewal, RenewalSettings
from fusion.tracking.tracker import Tracker
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera
from scenes.recordings.frames import Contacts, Frame
from scenes.synthesis import library

CAMERA = Camera(285.0, 285.0, 159.5, 119.5, 320, 240)
S = HypothesisSettings()
NARROW = 1e-6 * np.eye(6)


@pytest.fixture(scope="module")
def mug():
    return library.make("mug")


def turned(angle):
    return poses.make_pose(poses.exp_rotation([0.0, 0.0, angle]))


def pair():
    return (Hypothesis(np.eye(4), NARROW, 0.0), Hypothesis(turned(1.5), NARROW, 0.0))


def test_data_decide_slowly_and_what_is_far_behind_is_dropped(mug):
    rng = np.random.default_rng(0)
    now, leaders = pair(), []
    for frame in range(30):
        # the second is likelier by 10 nats a frame, in noise of as much
        costs = np.array([10.0, 0.0] if now[0].pose[0, 0] == 1.0 else [0.0, 10.0]) + 10.0 * rng.normal(size=2)
        now = several.weighed(now, [h.pose for h in now], costs[: len(now)], S)
        now = several.sifted(mug, now, S)
        leaders.append(now[0].pose[0, 0] == 1.0)
        if frame == 1:
            assert len(now) == 2  # the trial is not over
    assert not leaders[-1]
    assert len(now) == 1
    np.testing.assert_allclose(several.weights(now, S), [1.0])


def test_frames_between_images_add_to_what_images_said_and_take_the_lead_from_none():
    now = several.weighed(pair(), [h.pose for h in pair()], np.array([0.0, 12.0]), S)
    said, share = [h.score for h in now], several.weights(now, S)[0]
    assert share > 0.98
    for _ in range(60):
        now = several.weighed(now, [h.pose for h in now], np.zeros(2), S, between=True)
    assert [h.score for h in now] == said  # a second of touch forgets nothing
    assert several.weights(now, S)[0] == pytest.approx(share)
    for _ in range(20):
        now = several.weighed(now, [h.pose for h in now], np.array([30.0, 0.0]), S, between=True)
    assert now[0].pose[0, 0] == 1.0  # doubted, and still what was seen
    assert several.weights(now, S)[0] < 0.5
    now = several.weighed(now, [h.pose for h in now], np.zeros(2), S)
    assert now[0].pose[0, 0] != 1.0  # the next image takes it up


def test_a_frame_counts_less_than_its_nats_and_is_forgotten():
    now = several.weighed(pair(), [h.pose for h in pair()], np.array([0.0, 5.0]), S)
    assert several.weights(now, S)[0] == pytest.approx(1 / (1 + np.exp(-5.0 * S.worth)))
    for _ in range(40):
        now = several.weighed(now, [h.pose for h in now], np.zeros(2), S)
    np.testing.assert_allclose(several.weights(now, S), [0.5, 0.5], atol=0.01)


def test_a_search_votes_for_what_it_finds_and_adds_what_is_new(mug):
    # where the handle points hardly moves the surface: both are what was found
    both, agrees = several.voted(mug, pair()[:1], [Mode(turned(1.5), 1.0, 0.0, NARROW)], 0.8, True, S)
    assert agrees
    assert [h.votes for h in both] == pytest.approx([0.8, 0.8])
    block = library.make("l_block")
    lead = (replace(pair()[0], votes=1.0),)
    same, agrees = several.voted(block, lead, [Mode(turned(0.02), 1.0, 0.0, NARROW)], 0.8, True, S)
    assert (len(same), agrees) == (1, True)
    assert same[0].votes == pytest.approx(1.8)
    other, agrees = several.voted(block, lead, [Mode(turned(1.5), 1.0, 0.0, NARROW)], 0.8, True, S)
    assert (len(other), agrees) == (2, False)
    assert [h.votes for h in other] == pytest.approx([0.2, 0.8])
    assert other[0].votes < S.believed < other[1].votes
    unsure, _ = several.voted(block, lead, [Mode(turned(1.5), 1.0, 0.0, NARROW)], 0.0, True, S)
    assert [h.votes for h in unsure] == [1.0, 0.0]
    many = tuple(Hypothesis(turned(0.5 * k), NARROW, -float(k)) for k in range(S.most))
    full, _ = several.voted(block, many, [Mode(turned(-1.0), 1.0, 0.0, NARROW)], 0.8, True, S)
    assert len(full) == S.most
    assert any(np.array_equal(h.pose, turned(-1.0)) for h in full)


def test_searches_that_are_only_likely_or_around_the_track_do_not_make_it_believed(mug):
    block, lead, mode = library.make("l_block"), pair()[:1], Mode(turned(0.02), 1.0, 0.0, NARROW)
    lead = (replace(lead[0], age=1),)
    for _ in range(5):  # what is found again and again, by searches that tell nothing by themselves
        lead, _ = several.voted(block, lead, [mode], 0.0, False, S)
    assert lead[0].votes == S.most_repeated
    likely, _ = several.voted(block, lead, [mode], S.part, False, S)
    assert S.most_repeated < likely[0].votes < S.believed
    # one around the track brings none to more than that, and takes none away
    for votes in (0.0, S.part, S.repeated, 1.0):
        around, _ = several.voted(block, (replace(lead[0], votes=votes),), [mode], 0.9, True, S, most=S.most_repeated)
        assert around[0].votes == max(votes, S.most_repeated)
    sure, _ = several.voted(block, pair()[:1], [mode], several.vote_of("ok", 0.951, S), True, S)
    assert sure[0].votes > S.believed


def test_a_doubt_takes_from_the_leader_alone():
    settings = HypothesisSettings()
    leader, other = pair()
    once = several.doubted((replace(leader, votes=1.0), replace(other, votes=0.3)), settings)
    assert [h.votes for h in once] == [1.0 - settings.doubted, 0.3]
    assert several.doubted(once, replace(settings, doubted=5.0))[0].votes == 0.0
    # one start that was just sure enough is not believed any more, one that a search has found is
    assert 0.81 - settings.doubted < settings.believed < settings.most_votes - settings.doubted


def test_where_nothing_is_told_apart_a_leader_gives_way_to_what_searches_speak_for(mug):
    leader, other = pair()
    costs = np.array([40.0, 0.0])

    def leads(votes, told_apart):
        both = replace(leader, votes=votes[0]), replace(other, votes=votes[1])
        after = several.weighed(both, [h.pose for h in both], costs, S, told_apart)
        return after[0].pose[0, 0] == 1.0

    assert not leads((0.9, 0.0), True)
    assert leads((0.9, 0.0), False)
    assert not leads((0.9, 0.5), False)
    assert not leads((0.1, 0.1), False)
    assert not leads((0.0, 0.0), False)


def test_how_sure_a_search_was_stays_with_what_it_has_found(mug):
    block = library.make("l_block")
    lead = several.of_modes(block, [Mode(np.eye(4), 1.0, 0.0, NARROW)], 0.0, S, several.log_odds(0.9, S))
    found, _ = several.voted(
        block, lead, [Mode(turned(1.5), 1.0, 0.0, NARROW)], 0.0, False, S, several.log_odds(0.05, S)
    )
    gap = several.strengths(found, S)[1]
    assert gap == pytest.approx(-S.birth - np.log(19.0) - np.log(9.0))
    for _ in range(40):
        found = several.weighed(found, [h.pose for h in found], np.zeros(2), S)
    # all is forgotten but that
    assert several.strengths(found, S)[1] == pytest.approx(-np.log(19.0) - np.log(9.0), abs=0.01)
    assert several.log_odds(0.0, S) == S.least_odds
    assert several.log_odds(1.0, S) == S.most_odds


def test_a_start_speaks_for_the_surface_whichever_way_round(mug):
    """What looks alike has its votes, so that a track does not know better than its first frame."""
    modes = [Mode(np.eye(4), 0.5, 0.0, NARROW), Mode(turned(1.5), 0.5, 0.0, NARROW)]
    begun = several.of_modes(mug, modes, 1.0, S)
    assert [h.votes for h in begun] == [1.0, 1.0]
    np.testing.assert_allclose(several.weights(begun, S), [0.5, 0.5])
    # of what has its surface elsewhere the first alone
    assert [h.votes for h in several.of_modes(library.make("l_block"), modes, 1.0, S)] == [1.0, 0.0]


def test_frames_tell_ways_round_slowly_and_places_as_ever(mug):
    there = poses.make_pose(None, [0.05, 0.0, 0.0])
    found, nats = [np.eye(4), turned(1.5), there], np.array([2.0, 12.0, 12.0])
    np.testing.assert_allclose(several.as_ways(mug, found, nats, S), [2.0, 2.0 + 10.0 * S.of_ways, 12.0])


def test_ways_round_that_nobody_has_thought_of_are_no_news_while_the_tracks_own_may_be(mug):
    leader = Hypothesis(np.eye(4), NARROW, 0.0, 1.0)
    other, own = Mode(turned(1.5), 0.6, 0.0, NARROW), Mode(np.eye(4), 0.3, 0.0, NARROW)
    there = Mode(poses.make_pose(None, [0.05, 0.0, 0.0]), 0.1, 0.0, NARROW)
    assert several.without_news(mug, (other, own, there), (leader,), S) == (own, there)
    # one that has been followed is kept, behind the track's own
    followed = (leader, Hypothesis(turned(1.5), NARROW, 0.0, 1.0))
    assert several.without_news(mug, (other, own, there), followed, S) == (own, other, there)
    # where the frame tells that it is not as the track has it, it is news, and what is elsewhere is none of this
    unlikely = replace(own, weight=0.5 * S.open_way * other.weight)
    for modes in ((other, there), (other, unlikely, there), (there, other, own)):
        assert several.without_news(mug, modes, (leader,), S) == modes


def test_a_track_that_begins_anew_leaves_open_what_it_had_left_open(mug):
    before = (Hypothesis(np.eye(4), NARROW, 0.0, 2.0), Hypothesis(turned(1.5), NARROW, -0.7, 2.0))
    expected = poses.make_pose(None, [0.02, 0.0, 0.5])
    found = poses.make_pose(poses.exp_rotation([0.0, 0.05, 1.4]), [0.03, 0.0, 0.5])
    begun = (Hypothesis(found, NARROW, 0.0, 1.0, odds=2.0),)
    first, second = several.with_ways(mug, begun, before, expected, S)
    assert first == begun[0]
    # it was found as the second had it: the first's way is the other one
    np.testing.assert_allclose(second.pose, found @ turned(-1.5), atol=1e-12)
    assert (second.score, second.votes, second.odds, second.age) == (pytest.approx(0.7), 1.0, 2.0, 0)
    assert several.with_ways(mug, begun, (), expected, S) == begun
    # what was followed elsewhere is not open here
    away = (before[0], Hypothesis(poses.make_pose(None, [0.05, 0.0, 0.0]), NARROW, 0.0))
    assert len(several.with_ways(mug, begun, away, expected, S)) == 1


def test_bodies_that_leave_each_other_room_may_both_be_there(mug):
    beside = poses.make_pose(None, [0.2, 0.0, 0.0])
    assert several.may_both_be(mug, np.eye(4), beside)
    assert not several.may_both_be(mug, np.eye(4), poses.make_pose(None, [0.05, 0.0, 0.0]))
    assert not several.may_both_be(mug, np.eye(4), np.eye(4))


def test_an_unsure_search_elsewhere_is_a_small_doubt():
    leader, other = pair()
    two = replace(leader, votes=1.0), other
    lost = [1.0 - several.doubted(two, S, sure)[0].votes for sure in (0.0, 0.1, 0.5, 0.9, 1.0)]
    assert lost == sorted(lost)
    assert lost[0] == 0.0
    assert lost[1] < 0.05
    assert lost[3:] == pytest.approx([S.doubted, S.doubted])


def test_searches_become_rare_while_they_agree_and_frequent_when_not():
    s, renewal = RenewalSettings(), Renewal()
    renewal.restart(10, s)
    waits = []
    for _ in range(6):
        index = renewal.due
        renewal.found(index, True, s)
        waits.append(renewal.due - index)
    assert waits == [6, 12, 24, 48, 60, 60]
    renewal.found(200, False, s)
    assert renewal.due == 200 + s.soonest
    renewal.found(203, None, s)
    assert renewal.due == 203 + 2 * s.soonest
    for index in range(203, 209):
        renewal.hurry(index, s)  # comes and goes: one search, not one each time
    renewal.found(209, None, s)
    renewal.found(215, True, s)
    renewal.hurry(216, s)
    assert renewal.due == 215 + s.hurried
    renewal.found(225, True, s)
    renewal.found(231, True, s)
    renewal.hurry(245, s)
    assert renewal.due in (231 + renewal.wait, 245 + s.soonest)


def seen(model, angles, spin, base, seed=0):
    """Depth images (1 mm noise) of an object turned by angles about its own axis `spin` (3,) from rotation `base`."""
    rng = np.random.default_rng(seed)
    renderer = Renderer({"object": (model.vertices, model.faces)})
    frames = []
    for index, angle in enumerate(angles):
        turn = base @ poses.exp_rotation(angle * np.asarray(spin, dtype=np.float64))
        truth = poses.make_pose(turn, [0.0, 0.0, 0.5] - turn @ model.centroid)
        depth = renderer.render(CAMERA, {"object": truth}).depth.astype(np.float32)
        depth = np.where(np.isfinite(depth) & (depth > 0), depth + 0.001 * rng.normal(size=depth.shape), 0.0)
        frames.append(Frame(index, camera=CAMERA, depth=depth.astype(np.float32), camera_from_object_truth=truth))
    return frames


def off(answer, frame, model):
    """Metres by which the object's surface is displaced at most."""
    truth = frame.camera_from_object_truth
    delta = poses.difference(model.symmetries.nearest(answer.pose, truth), truth, model.centroid)
    return np.linalg.norm(delta[:3]) * model.radius + np.linalg.norm(delta[3:])


def test_a_track_that_begins_wrong_and_sure_of_it_loses_its_ok_and_recovers():
    model = library.make("bust")
    frames = seen(model, 0.03 * np.arange(16), [0, 0, 1], poses.exp_rotation([1.0, 0.4, 0.0]))
    points, normals = model.sample_surface(6, seed=0)
    frames = [replace(f, contacts=Contacts(points, normals).moved(f.camera_from_object_truth)) for f in frames]
    first = estimate(frames[0], model, frames[0].camera_from_object_truth)
    assert off(first, frames[0], model) < 0.004
    # upside down, where it hides some of the same pixels
    wrong = poses.perturb(first.pose, np.array([0.0, 0.0, np.pi, 0.0, 0.0, 0.0]), model.centroid)
    answers = []
    for _ in range(2):
        tracker = Tracker(model)
        mode = replace(first.modes[0], pose=wrong, weight=1.0)
        tracker.believe(frames[0], replace(first, pose=wrong, modes=(mode,), verdict="ok", confidence=0.95))
        answers.append([tracker.step(frame) for frame in frames[1:]])
    errors = [off(a, f, model) for a, f in zip(answers[0], frames[1:])]
    assert not any(a.verdict == "ok" for a, e in list(zip(answers[0], errors))[9:] if e > 0.005)
    assert max(errors[-3:]) < 0.004
    assert any(a.verdict == "ok" for a in answers[0])
    for a, b in zip(*answers):  # the same again, to the bit
        np.testing.assert_array_equal(a.pose, b.pose)
        assert [m.weight for m in a.modes] == [m.weight for m in b.modes]


def test_what_one_frame_cannot_tell_is_carried_to_the_next(mug):
    """A mug from the side, its handle behind it: upside down it would look the same."""
    up = poses.exp_rotation([np.pi / 2, 0.0, 0.0])  # upright in the image
    vertices = mug.vertices - mug.centroid
    handle = vertices[np.argmax(np.linalg.norm(vertices[:, :2], axis=1))]
    behind = up.T @ [0.0, 0.0, 1.0]
    start = np.arctan2(behind[1], behind[0]) - np.arctan2(handle[1], handle[0])
    tracker = Tracker(mug)
    answers = [tracker.step(frame) for frame in seen(mug, np.full(9, start), [0, 0, 1], up)]
    assert answers[0].verdict == "ambiguous"
    assert len(answers[0].modes) > 1
    assert sum(len(a.modes) > 1 for a in answers) >= 3
    for answer in [a for a in answers if len(a.modes) > 1]:
        assert sum(m.weight for m in answer.modes) == pytest.approx(1.0)
        assert abs((answer.modes[0].pose[:3, :3].T @ answer.modes[1].pose[:3, :3])[2, 2]) > 0.9


def test_a_finger_that_goes_with_the_object_is_learned_and_its_flank_is_left_out(mug):
    rng = np.random.default_rng(3)
    things, pose = Occluders(), turned(0.0)
    surface, normals = mug.sample_surface(400, seed=1)
    # a finger that stands on one point of the surface, seen from 10 to 20 mm off it
    finger = surface[0] + normals[0] * np.linspace(0.010, 0.020, 40)[:, None] + 0.001 * rng.normal(size=(40, 3))
    for step in range(8):
        pose = poses.make_pose(poses.exp_rotation([0.0, 0.1 * step, 0.0]), [0.01 * step, 0.0, 0.5])
        passing = rng.uniform(-0.1, 0.1, size=(100, 3))  # something that does not stay with it
        points = poses.apply(pose, np.concatenate([surface, finger, passing]))
        things = things.learned(mug, pose, points)
        if step == 0:
            assert not things.beside(pose, points).any()  # once is no habit
    near = np.linalg.norm(surface - surface[0], axis=1) < 0.006
    beside = things.beside(pose, poses.apply(pose, surface + 0.006 * normals))
    assert beside[near].mean() > 0.5
    far = np.linalg.norm(surface - surface[0], axis=1) > 0.035
    assert beside[far].mean() < 0.02


def test_a_search_as_sure_of_the_surface_as_an_ok_one_speaks_as_loud():
    s = S
    assert several.vote_of("ok", 0.97, s) == several.vote_of("ambiguous", 0.97, s) == pytest.approx(0.94)
    assert several.vote_of("ambiguous", 0.94, s) == s.part
    assert several.vote_of("ambiguous", 0.7, s) == several.vote_of("lost", 0.99, s) == 0.0


def test_one_hypothesis_alone_may_be_carried(mug):
    modes = (Mode(poses.make_pose(None, [0.05, 0.0, 0.0]), 1.0, 0.0, NARROW),)
    kept, agrees = several.voted(mug, pair()[:1], modes, 1.0, True, replace(S, most=1))
    assert len(kept) == 1
    assert not agrees


@pytest.mark.parametrize(
    ("away", "turn", "one"), [(0.003, 0.0, True), (0.03, 0.0, False), (0.0, 0.5, True)], ids=["near", "far", "turned"]
)
def test_what_has_the_surface_elsewhere_is_another_however_little_is_known(mug, away, turn, one):
    """Of a track that leaves a place open by centimetres, a search that finds it centimetres off is no word for it."""
    wide = np.diag([1.0] * 3 + [0.03**2] * 3)
    found = Mode(poses.make_pose(poses.exp_rotation([0.0, 0.0, turn]), [away, 0.0, 0.0]), 1.0, 0.0, wide)
    lead = (Hypothesis(np.eye(4), wide, 0.0, 0.5),)
    assert several.alike(mug, lead[0], found, S) is one
    after, agrees = several.voted(mug, lead, [found], S.part, False, S)
    assert agrees is one
    assert [h.votes for h in after] == pytest.approx([0.5 + S.part] if one else [0.5, S.part])
    assert len(several.sifted(mug, after, S)) == len(after)
