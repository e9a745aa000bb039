"""What no frame tells is carried beside what frames tell; an answer holds what is still open; touch that lies."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import off_by, recording

from fusion.estimation.answer import Mode
from fusion.estimation.posterior.turns import around, by_turns, shown, turned
from fusion.tracking.answer import TrackSettings
from fusion.tracking.filter import WIDE, Belief, Measurement, SlipTest, after_slip, gone_on, relearned, update
from fusion.tracking.memory import hypotheses as several
from fusion.tracking.memory.hypotheses import Hypothesis, HypothesisSettings
from fusion.tracking.memory.untold import ALONE, ANY_TURN, LEAST, LOOKS, Untold, leaves_turn
from fusion.tracking.steps.judging import as_open
from fusion.tracking.tracker import Tracker
from scenes.evidence.symmetry.near_symmetries import round_axes
from scenes.geometry import poses
from scenes.synthesis import library

NARROW = 1e-6 * np.eye(6)
# A handle that may turn by 0.3 rad about the object's own z.
HANDLE = np.diag([0.0, 0.0, 0.09, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def mug():
    return library.make("mug")


def test_looks_are_averaged_by_their_standard_deviations_and_go_with_the_object(mug):
    turn = poses.make_pose(poses.exp_rotation([0.4, -0.3, 0.8]))
    block = np.kron(np.eye(2), turn[:3, :3])
    untold = Untold().learned(mug, turn, block @ HANDLE @ block.T)
    untold = untold.learned(mug, np.eye(4), HANDLE)
    np.testing.assert_allclose(untold.at(mug, np.eye(4)), HANDLE, atol=1e-12)
    assert untold.learned(mug, turn, None) is untold  # a look that could not tell
    half = untold.learned(mug, np.eye(4), np.zeros((6, 6))).learned(mug, turn, np.zeros((6, 6)))
    np.testing.assert_allclose(half.at(mug, turn), block @ (HANDLE / 4) @ block.T, atol=1e-12)
    for _ in range(6 * LOOKS):
        half = half.learned(mug, np.eye(4), np.zeros((6, 6)))
    assert np.trace(half.at(mug, turn)) < 1e-4 * np.trace(HANDLE)  # what has come into view is told


def test_what_one_look_alone_has_found_is_not_open(mug):
    rest = np.eye(4)
    alone = Untold().learned(mug, rest, HANDLE)
    for looks in range(1, LOOKS + 1):
        np.testing.assert_allclose(np.sqrt(alone.at(mug, rest)[2, 2]), ALONE * LEAST / looks)
        alone = alone.learned(mug, rest, np.zeros((6, 6)))
    assert not alone.at(mug, rest).any()
    # beside others as wide as a fifth it counts as three of these
    wide = Untold().learned(mug, rest, HANDLE).learned(mug, rest, HANDLE / 25)
    expected = ((0.6 + 0.2) / 2) ** 2 * HANDLE
    np.testing.assert_allclose(wide.at(mug, rest), expected, atol=1e-12)


def test_no_number_of_frames_tells_what_none_does(mug):
    """A start that knows nothing of the turn is as unsure after any number of frames as after one."""
    wide = np.diag([0.0, 0.0, 100.0, 0.0, 0.0, 0.0])
    belief = Belief(np.eye(4), NARROW + wide, NARROW)
    for _ in range(50):
        belief = update(mug, belief, Measurement(np.eye(4), NARROW, NARROW, hidden=HANDLE))
    np.testing.assert_allclose(belief.hidden, HANDLE, rtol=0.1, atol=1e-9)
    assert belief.covariance[2, 2] > HANDLE[2, 2]
    turn = poses.make_pose(poses.exp_rotation([0.5 * np.pi, 0.0, 0.0]))
    assert belief.moved(turn).hidden[1, 1] == pytest.approx(belief.hidden[2, 2])


def test_what_was_known_stays_known_out_of_sight(mug):
    """Fits whose turn is chance do not move a turn that a start has told, nor make it wider."""
    rng = np.random.default_rng(1)
    belief = Belief(np.eye(4), NARROW, NARROW)
    for _ in range(50):
        off = [0.0, 0.0, 0.3 * rng.normal(), 0.001, 0.0, 0.0]
        pose = poses.perturb(np.eye(4), off, mug.centroid)
        belief = update(mug, belief, Measurement(pose, NARROW, NARROW, hidden=HANDLE))
    turned, _, moved = np.split(poses.difference(belief.pose, np.eye(4), mug.centroid), [3, 3])
    assert np.abs(turned).max() < 0.002
    assert moved[0] == pytest.approx(0.001, rel=0.1)  # what frames tell they tell as before
    assert np.sqrt(belief.covariance[2, 2]) < 0.005


def test_where_the_middle_is_tells_nothing_of_a_turn_that_is_open(mug):
    """A belief has turns go with displacements, and a frame that knows of the latter alone does not know the turn."""
    along = np.array([0.0, 0.0, 0.2, 0.004, 0.0, 0.0])
    belief = Belief(np.eye(4), NARROW + np.outer(along, along), NARROW)
    pose = poses.perturb(np.eye(4), [0.0, 0.0, 0.0, 0.003, 0.0, 0.0], mug.centroid)
    told = update(mug, belief, Measurement(pose, NARROW, NARROW))
    open_to = update(mug, belief, Measurement(pose, NARROW, NARROW, hidden=np.diag([0.0, 0.0, 3.0, 0.0, 0.0, 0.0])))
    step = poses.difference(open_to.pose, np.eye(4), mug.centroid)
    assert abs(step[2]) < 1e-3
    assert step[3] == pytest.approx(0.003, rel=0.1)
    assert open_to.own[2, 2] == pytest.approx(0.2**2, rel=0.02)
    assert told.own[2, 2] < 0.01 * 0.2**2


def test_a_start_stays_unsure_of_what_later_frames_do_not_tell(mug):
    first = Belief(np.eye(4), NARROW, HANDLE + 4.0 * NARROW)
    later = Measurement(np.eye(4), NARROW, NARROW, hidden=np.diag([0.0, 0.0, 3.0, 0.0, 0.0, 0.0]))
    after = relearned(mug, first, later)
    np.testing.assert_allclose(after.shared, NARROW)
    assert after.own[2, 2] == pytest.approx(HANDLE[2, 2], rel=0.01)
    assert after.own[0, 0] == pytest.approx(1e-6, rel=0.01)
    np.testing.assert_allclose(relearned(mug, first, replace(later, hidden=np.zeros((6, 6)))).own, NARROW)


def test_a_handle_that_is_seen_is_told(mug):
    frames = recording(mug, count=2)
    tracker = Tracker(mug)
    for frame in frames:
        tracker.step(frame)
    pool, truth = tracker._sensed.pool, frames[-1].camera_from_object_truth
    assert shown(pool, truth, 28).all()
    assert not by_turns(pool, truth, truth, NARROW, 0.5, 28).covariance.any()
    for pose in turned(mug, truth)[5:18]:  # by 90 degrees and more
        assert not shown(pool, pose, 28).any()


def test_what_moves_it_unseen_makes_it_wider_up_to_what_frames_leave_open(mug):
    known = Belief(np.eye(4), NARROW, NARROW)
    measured = Measurement(np.eye(4), NARROW, NARROW, hidden=HANDLE)
    step = np.diag([0.0, 0.0, 0.03**2, 0.0, 0.0, 0.0])
    widths = [0.0]
    for _ in range(200):
        known = update(mug, known.shifted(np.zeros(6), step, mug.centroid), measured)
        widths.append(float(np.sqrt(known.hidden[2, 2])))
    assert widths[5] == pytest.approx(5 * 0.03, rel=0.25)  # the same step each time, not a walk
    assert (np.diff(widths) >= -1e-6).all()
    assert widths[-1] == pytest.approx(0.3, rel=0.02)
    assert after_slip(mug, Belief(np.eye(4), NARROW, NARROW), measured).hidden[2, 2] == HANDLE[2, 2]


def test_a_search_moves_a_track_on_but_for_what_no_frame_tells(mug):
    before = Belief(np.eye(4), NARROW, NARROW, 0.5 * HANDLE)
    found = Belief(poses.perturb(np.eye(4), [0.0, 0.0, 0.8, 0.006, 0.0, 0.0], mug.centroid), NARROW, NARROW)
    after = gone_on(mug, before, np.eye(4), found, HANDLE)
    step = poses.difference(after.pose, np.eye(4), mug.centroid)
    assert abs(step[2]) < 0.4 * 0.8
    assert step[3] == pytest.approx(0.006, rel=0.02)
    assert after.own[3, 3] > 0.006**2 * 0.9  # as unsure as the two are apart
    assert after.hidden[2, 2] > 0.15 * HANDLE[2, 2]
    everywhere = gone_on(mug, before, np.eye(4), found, np.zeros((6, 6)))
    np.testing.assert_allclose(everywhere.pose, found.pose, atol=1e-9)
    assert everywhere.hidden[2, 2] < 1e-9


def covariance_by(model, pose, nats, known):
    return around(model, pose, nats, known).covariance


def test_a_picture_that_tells_the_turn_turns_what_a_frame_measures(mug):
    pose = poses.make_pose(poses.exp_rotation([0.4, -0.3, 0.8]), [0.0, 0.1, 0.6])
    nats, axis = np.full(len(turned(mug, pose)), 20.0), pose[:3, 2]
    nats[3] = -20.0  # by 60 degrees
    told = around(mug, pose, nats, NARROW)
    np.testing.assert_allclose(told.pose, turned(mug, pose)[3], atol=1e-12)
    assert np.trace(told.left) < 1e-6
    assert np.sqrt(axis @ told.covariance[:3, :3] @ axis) == pytest.approx(np.pi / 3, rel=0.01)
    wide = around(mug, pose, np.where(np.arange(len(nats)) == 3, -1.0, 0.0), NARROW)
    np.testing.assert_allclose(wide.pose, pose)  # where all are open none is better
    np.testing.assert_allclose(wide.left, wide.covariance)


def test_a_handle_that_no_picture_misses_may_be_anywhere(mug):
    pose = poses.make_pose(poses.exp_rotation([0.4, -0.3, 0.8]), [0.0, 0.1, 0.6])
    turns = turned(mug, pose)
    axis = pose[:3, 2]
    free = covariance_by(mug, pose, np.zeros(len(turns)), NARROW)
    assert np.sqrt(axis @ free[:3, :3] @ axis) == pytest.approx(ANY_TURN, rel=0.05)
    assert np.linalg.eigvalsh(free[:3, :3])[-2] < 0.01 * ANY_TURN**2  # about that axis alone
    shown = covariance_by(mug, pose, np.full(len(turns), 20.0), NARROW)
    assert np.trace(shown) < 1e-6
    near = np.full(len(turns), 20.0)
    near[:2] = 0.0  # 30 degrees to one side are open
    assert np.sqrt(axis @ covariance_by(mug, pose, near, NARROW)[:3, :3] @ axis) == pytest.approx(0.34, rel=0.05)
    wide = NARROW + ANY_TURN**2 * np.outer(np.append(axis, np.zeros(3)), np.append(axis, np.zeros(3)))
    assert np.trace(covariance_by(mug, pose, np.zeros(len(turns)), 2.0 * wide)) < 1e-3
    for name in ("hammer", "drill", "bottle"):
        assert not len(turned(library.make(name), pose))


def test_a_turn_of_what_nobody_sees_is_no_slip(mug):
    """The answers of a mug whose handle is hidden wander about its axis."""
    rng = np.random.default_rng(0)
    said = {}
    for hidden in (HANDLE, 0 * HANDLE):
        test = SlipTest(mug, 40.0)
        belief, alarms = Belief(np.eye(4), NARROW, NARROW), 0
        for _ in range(40):
            pose = poses.perturb(np.eye(4), [0.0, 0.0, 0.05 * rng.normal(), 0.0, 0.0, 0.0], mug.centroid)
            test.predict(np.eye(4), np.zeros(6), 1e-9 * np.eye(6))
            alarms += test.step(Measurement(pose, NARROW, NARROW, hidden=hidden), belief, None)
        said[hidden.any()] = alarms
    assert said[True] == 0
    assert said[False] > 0


def test_an_ok_answer_holds_what_is_not_yet_decided(mug):
    over = Mode(poses.make_pose(poses.exp_rotation([0.0, np.pi - 1e-6, 0.0])), 0.02, 0.0, NARROW)
    modes = (Mode(np.eye(4), 0.98, 0.0, NARROW), over)
    covariance = as_open(mug, modes, "ok", 1.0, TrackSettings())
    assert np.trace(covariance[:3, :3]) == pytest.approx(0.02 * np.pi**2, rel=0.01)
    alone = as_open(mug, (replace(modes[0], weight=1.0),), "ok", 1.0, TrackSettings())
    np.testing.assert_allclose(alone, NARROW)


def test_a_search_speaks_against_what_is_surely_elsewhere_alone():
    """A hammer turned about its shaft keeps its surface within millimetres: a search may have either."""
    model, s = library.make("hammer"), HypothesisSettings()
    axis = np.linalg.svd(model.vertices - model.vertices.mean(axis=0), full_matrices=False)[2][0]
    for angle, against in ((np.pi, False), (0.0, True)):
        moved = poses.perturb(np.eye(4), np.r_[angle * axis, np.zeros(3)], model.centroid)
        if against:
            moved = poses.perturb(np.eye(4), np.r_[0.0, 0.0, 0.0, 0.03, 0.03, 0.03], model.centroid)
        lead = (Hypothesis(np.eye(4), NARROW, 0.0, votes=2.0),)
        assert (several.surface_apart(model, np.eye(4), moved) > s.elsewhere) == against
        after, _ = several.voted(model, lead, [Mode(moved, 1.0, 0.0, NARROW)], 1.0, True, s)
        assert after[0].votes == (1.0 if against else 2.0)


def test_touch_that_contradicts_an_object_out_of_sight_does_not_move_it(mug):
    frames = recording(mug, 10)
    dark = {5, 6}
    for i in dark:
        wrong = frames[i].contacts.moved(poses.make_pose(np.eye(3), [0.03, -0.03, 0.04]))
        frames[i] = replace(frames[i], depth=np.zeros_like(frames[i].depth), contacts=wrong)
    tracker = Tracker(mug)
    for frame in frames:
        answer = tracker.step(frame)
        _, millimetres = off_by(answer, frame, mug)
        assert millimetres < 5.0
        assert answer.how in (("carried",) if frame.index in dark else ("started", "tracked"))
        assert frame.index not in dark or "contradicts" in answer.notes[0]


def plain(name):
    """An object of the library whose symmetries nobody has said."""
    made = library.make(name)
    return type(made)(f"{name}, plain", made.vertices, made.faces)


def _about(axis, sigma):
    """(6, 6) of a turn about a unit axis (3,) by sigma (rad), and next to nothing else."""
    out = 1e-6 * np.eye(6)
    out[:3, :3] += sigma**2 * np.outer(axis, axis)
    return out


def test_a_turn_of_what_is_round_that_a_start_or_a_look_has_left_open_may_be_any():
    tin, mug = plain("cylinder"), plain("mug")
    pose = poses.make_pose(poses.exp_rotation([0.9, -0.4, 0.2]), [0.02, 0.0, 0.5])
    axis = pose[:3, :3] @ round_axes(tin)[0]
    wide, narrow = _about(axis, 1.5 * WIDE), _about(axis, 0.5 * WIDE)
    assert leaves_turn(tin, pose, wide)
    assert not leaves_turn(tin, pose, narrow)
    assert not leaves_turn(mug, pose, wide)
    # a look that left it open is not taken back by one that did not
    untold = Untold().learned(tin, pose, narrow)
    assert not untold.turns
    untold = untold.learned(tin, pose, 4.0 * wide).learned(tin, pose, narrow)
    for of_tin in (untold, Untold(turns=True)):
        told = of_tin.at(tin, pose)
        assert axis @ told[:3, :3] @ axis == pytest.approx(ANY_TURN**2, rel=1e-3)
        other = np.cross(axis, [1.0, 0.0, 0.0])
        other /= np.linalg.norm(other)
        assert other @ told[:3, :3] @ other < 1e-4
    np.testing.assert_allclose(Untold(turns=True).at(mug, pose), np.zeros((6, 6)))
