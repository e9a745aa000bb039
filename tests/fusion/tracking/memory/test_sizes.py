"""How large shared errors are is learned over a recording and told; where a track goes does not depend on it."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import recording

from fusion.estimation.answer import ContactResidual
from fusion.estimation.estimate import estimate
from fusion.estimation.posterior.confidence import within
from fusion.estimation.posterior.spread import mean_square
from fusion.estimation.solve.joint import JointResult
from fusion.tracking.answer import TrackSettings
from fusion.tracking.filter import Belief, Measurement
from fusion.tracking.memory.sizes import Jumps, Sizes, SizeSettings
from fusion.tracking.steps.judging import as_learned
from fusion.tracking.tracker import Tracker
from fusion.truth.errors import Judge
from scenes.geometry import poses as se3
from scenes.synthesis import library

# what looks leave unexplained, without the belief beside it
HOW = SizeSettings(believed_looks=0.0)


def look(strain=4.0, told=8.0, mesh=0.6e-3):
    """A solution of which only what tells of sizes counts."""
    bare = JointResult(np.eye(4), np.eye(6), np.zeros(6), np.zeros(3), 0.0, 0.0, 0.0, 1.0)
    return replace(bare, mesh_variance=mesh**2, strain=strain, told=told)


def contacts(*sigmas):
    """Contacts off by so many of their standard deviations."""
    return [ContactResidual(f"finger{i}", 1.2 * off, 5.0, False, 1.2) for i, off in enumerate(sigmas)]


def test_one_look_counts_less_than_many():
    one = Sizes().learned(look(strain=4.0), contacts(0.6), HOW)
    many = one
    for _ in range(20):
        many = many.learned(look(strain=4.0), contacts(0.6), HOW)
    whole, how = max(many.factor(HOW), HOW.narrowest), SizeSettings()
    assert one.factor(HOW) == pytest.approx(whole, rel=0.2)
    assert whole < many.factor(how) < 0.7 * one.factor(how)
    assert one.factor(how) < 1.0


def test_what_looks_leave_unexplained_widens_and_what_they_explain_narrows():
    assert Sizes().factor(HOW) == 1.0
    usual = Sizes().learned(look(), contacts(1.0, -1.0), HOW)
    expected = 1.35 * 1.1**0.77 * (4.5 / 8.5) ** 0.69
    assert usual.factor(HOW) == pytest.approx(expected)
    for worse in (
        Sizes().learned(look(strain=8.0), contacts(1.0, -1.0), HOW),
        Sizes().learned(look(mesh=1.2e-3), contacts(1.0, -1.0), HOW),
        Sizes().learned(look(), contacts(1.5, -1.5), HOW),
    ):
        assert worse.factor(HOW) > 1.2 * usual.factor(HOW)
    # a contact that does not belong is no size
    assert Sizes().learned(look(), contacts(3.0), HOW) == Sizes().learned(look(), contacts(30.0), HOW)
    signless = Sizes().learned(look(told=0.0, strain=0.0), [], HOW)
    assert signless.factor(HOW) == pytest.approx(1.35 * np.exp(-0.5 * 0.69))


def jumping(model, sizes, settings=HOW, spread=1e-3):
    """Frames that are each off by so many standard deviations, in a direction of its own; a millimetre an axis."""
    rng, jumps = np.random.default_rng(3), Jumps()
    own = np.diag(np.repeat([spread / model.radius, spread], 3) ** 2)
    predicted = Belief(np.eye(4), 0.5 * own, 9.0 * own)
    for size in sizes:
        step = size * np.sqrt(np.diag(own)) * rng.choice([-1.0, 1.0], 6)
        measured = Measurement(se3.perturb(np.eye(4), step, model.centroid), 0.5 * own, 9.0 * own)
        jumps = jumps.learned(model, predicted, measured, settings)
    return jumps


def test_what_frames_do_not_share_is_as_wide_as_their_jumps():
    drill = library.make("drill")
    assert Jumps().factor(HOW) == 1.0
    steady, usual, wild = (jumping(drill, [size] * 12).factor(HOW) for size in (0.3, 1.0, 1.4))
    assert steady < usual < wild
    assert usual == pytest.approx(HOW.usual_jump)
    # twice as many frames that jump as much say it more surely, one of them says little
    assert wild > jumping(drill, [1.0] * 11 + [1.4]).factor(HOW) > usual
    assert jumping(drill, [1.4] * 24).factor(HOW) > wild
    # those of long ago are forgotten, and no frame is more than one
    assert jumping(drill, [1.4] * 12 + [1.0] * 60).factor(HOW) == pytest.approx(usual, rel=0.02)
    assert jumping(drill, [5.0] * 12) == jumping(drill, [50.0] * 12)
    assert jumping(drill, [0.0] * 90).factor(HOW) == HOW.least_jump
    assert jumping(drill, [50.0] * 90).factor(HOW) == HOW.most_jump
    belief = Belief(np.eye(4), np.eye(6), 2.0 * np.eye(6), 3.0 * np.eye(6))
    told = jumping(drill, [50.0] * 90).told_of(belief, HOW)
    np.testing.assert_allclose(told.covariance, (HOW.most_jump + 2.0 + 3.0) * np.eye(6))


def test_a_turn_about_an_axis_of_symmetry_is_no_jump():
    bottle = library.make("bottle")
    axis = bottle.symmetries.axes[0].direction
    own = 1e-6 * np.eye(6)
    before, still = Belief(np.eye(4), own, own), jumping(bottle, [0.0])
    for turn in (0.0, 0.5, -2.0):
        about = se3.make_pose(se3.exp_rotation(turn * axis), np.zeros(3))
        about[:3, 3] = bottle.symmetries.axes[0].point - about[:3, :3] @ bottle.symmetries.axes[0].point
        turned = Jumps().learned(bottle, before, Measurement(about, own, own), HOW)
        assert turned.factor(HOW) == pytest.approx(still.factor(HOW), rel=1e-3)
    # of what is left, five degrees of freedom, a jump as wide as believed is one
    assert jumping(bottle, [1.0] * 12).factor(HOW) == pytest.approx(HOW.usual_jump, rel=0.2)


def test_a_track_states_a_tolerance_by_the_geometry_of_its_covariance():
    """How often ADD-S is within it where poses are drawn from that covariance: never much less often than stated."""
    how = TrackSettings().confident
    assert how.seen.nearest == how.felt.nearest == TrackSettings().nearest
    for name, wide in (("drill", 3e-3), ("bottle", 5e-3), ("mug", 4e-3)):
        model = library.make(name)
        judge, rng = Judge(model), np.random.default_rng(5)
        covariance = np.diag(np.array([0.3, 0.3, 0.3, 1.0, 1.0, 4.0]) * np.repeat([wide / model.radius, wide], 3) ** 2)
        drawn = rng.multivariate_normal(np.zeros(6), covariance, 80)
        off = np.array([judge.errors(se3.perturb(np.eye(4), one, model.centroid), np.eye(4)).add_s for one in drawn])
        tolerance = 1.5 * float(np.sqrt(mean_square(model, np.eye(4), covariance)[0]))
        stated = within(model, np.eye(4), covariance, tolerance, how.seen.nearest)
        assert stated < np.mean(off < tolerance) + 0.07


def test_means_over_looks_are_told_within_bounds():
    one, other = look(strain=8.0), look(strain=2.0, mesh=0.3e-3)
    both = Sizes().learned(one, contacts(2.0), HOW).learned(other, contacts(1.0), HOW)
    assert both.looks == both.felt == 2
    swapped = Sizes().learned(other, contacts(1.0), HOW).learned(one, contacts(2.0), HOW)
    assert both.factor(HOW) == pytest.approx(swapped.factor(HOW))
    # what showed nothing of the object teaches nothing
    assert both.learned(replace(one, mesh_variance=0.0), contacts(2.0), HOW) is both
    # where the object is found elsewhere camera, robot and mesh are the same, but some of it was for the wrong pose
    for looks in (1, 2, 30):
        many = Sizes()
        for _ in range(looks):
            many = many.learned(one, contacts(2.0), HOW)
        again = many.faded(HOW)
        assert again.looks == min(looks, HOW.kept_looks)
        assert again.factor(HOW) == pytest.approx(many.factor(HOW), rel=0.05)
        assert many.learned(other, contacts(1.0), HOW, anew=True) == again.learned(other, contacts(1.0), HOW)
    assert Sizes().faded(HOW) == Sizes()
    wild = Sizes().learned(look(strain=4000.0, mesh=0.02), contacts(3.0), HOW)
    calm = Sizes().learned(look(strain=0.0, told=30.0, mesh=1e-5), contacts(0.0), HOW)
    assert (calm.factor(HOW), wild.factor(HOW)) == (HOW.narrowest, HOW.widest)
    belief = Belief(np.eye(4), np.eye(6), 2.0 * np.eye(6), 3.0 * np.eye(6))
    told = wild.told_of(belief, HOW)
    np.testing.assert_array_equal(told.covariance, (1.0 + 2.0 * HOW.widest + 3.0) * np.eye(6))


def test_a_track_learns_them_and_goes_where_it_went_without():
    mug = library.make("mug")
    off = SizeSettings(usual=1.0, by_touch=0.0, by_mesh=0.0, by_strain=0.0)
    as_is, without = Tracker(mug), Tracker(mug, settings=TrackSettings(sizes=off))
    wider = []
    for unmasked in recording(mug, 12):
        frame = replace(unmasked, mask=unmasked.depth > 0)
        mine, its = as_is.step(frame), without.step(frame)
        if mine.verdict == its.verdict == "ok":
            np.testing.assert_array_equal(mine.pose, its.pose)
        wider.append(np.trace(mine.covariance[3:, 3:]) / np.trace(its.covariance[3:, 3:]))
    assert wider[0] == 1.0  # one frame says it by itself
    assert wider[1] != 1.0  # and a look what it has left unexplained itself
    sizes = as_is._state.sizes
    assert sizes.looks >= 2
    assert sizes.told > 0.0
    assert wider[-1] != 1.0


def test_what_is_found_again_is_as_sure_as_the_recording_has_shown():
    mug = library.make("mug")
    frame = recording(mug, 1)[0]
    found = estimate(replace(frame, mask=frame.depth > 0), mug, settings=TrackSettings().first)
    found = replace(found, verdict="ok", confidence=0.97)
    still = np.zeros(6)
    usual, bad = Sizes(), Sizes().learned(look(strain=40.0), contacts(3.0), HOW)
    assert as_learned(mug, found, usual, still, TrackSettings()) is found
    calm = usual.learned(look(strain=0.1), contacts(0.1), HOW)
    assert as_learned(mug, found, calm, still, TrackSettings()) is found  # a frame is never surer for it
    wide = replace(found.modes[0], covariance=np.diag(np.repeat([1e-3 / mug.radius, 4e-3], 3) ** 2))
    unsure = replace(found, modes=(wide,), covariance=wide.covariance)
    said = as_learned(mug, unsure, bad, still, TrackSettings())
    assert said.verdict == "ambiguous"
    assert said.confidence < 0.95
    assert np.trace(said.covariance) > 2.0 * np.trace(unsure.covariance)
    narrow = replace(wide, covariance=1e-4 * wide.covariance)
    assert as_learned(mug, replace(unsure, modes=(narrow,)), bad, still, TrackSettings()).verdict == "ok"
    # what moves may be elsewhere at the time that the frame is said to be of
    moving = as_learned(mug, replace(unsure, modes=(narrow,)), usual, np.array([0, 0, 0, 0.009, 0, 0]), TrackSettings())
    assert moving.confidence < 0.95
    assert moving.covariance[3, 3] >= 0.009**2
    # what is not sure may be anywhere: the prediction about which it was looked for was wrong
    open_to = as_learned(mug, replace(unsure, verdict="ambiguous", confidence=0.6), usual, still, TrackSettings())
    assert open_to.confidence == 0.6
    assert np.trace(open_to.covariance[3:, 3:]) > (0.5 * mug.radius) ** 2


def test_nothing_is_learned_where_nobody_knows_what_is_in_front():
    mug = library.make("mug")
    tracker = Tracker(mug)
    for frame in recording(mug, 5):
        tracker.step(frame)
    assert tracker._state.sizes == Sizes()
