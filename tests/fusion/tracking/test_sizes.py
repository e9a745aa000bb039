"""How large shared errors are is learned over a recording and told; where a track goes does not depend on it."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import recording

from fusion.estimation.answer import ContactResidual
from fusion.estimation.solve.joint import JointResult
from fusion.tracking.answer import TrackSettings
from fusion.tracking.filter import Belief
from fusion.tracking.sizes import Sizes, SizeSettings
from fusion.tracking.tracker import Tracker
from scenes.synthesis import library

HOW = SizeSettings()


def look(strain=4.0, told=8.0, mesh=0.6e-3):
    """A solution of which only what tells of sizes counts."""
    bare = JointResult(np.eye(4), np.eye(6), np.zeros(6), np.zeros(3), 0.0, 0.0, 0.0, 1.0)
    return replace(bare, mesh_variance=mesh**2, strain=strain, told=told)


def contacts(*sigmas):
    """Contacts off by so many of their standard deviations."""
    return [ContactResidual(f"finger{i}", 1.2 * off, 5.0, False, 1.2) for i, off in enumerate(sigmas)]


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


def test_means_over_looks_are_told_within_bounds():
    one, other = look(strain=8.0), look(strain=2.0, mesh=0.3e-3)
    both = Sizes().learned(one, contacts(2.0), HOW).learned(other, contacts(1.0), HOW)
    assert both.looks == both.felt == 2
    swapped = Sizes().learned(other, contacts(1.0), HOW).learned(one, contacts(2.0), HOW)
    assert both.factor(HOW) == pytest.approx(swapped.factor(HOW))
    # what showed nothing of the object teaches nothing, and another pose begins anew
    assert both.learned(replace(one, mesh_variance=0.0), contacts(2.0), HOW) is both
    assert both.learned(one, contacts(2.0), HOW, anew=True) == Sizes().learned(one, contacts(2.0), HOW)
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
    sizes = as_is._state.sizes
    assert sizes.looks >= 2
    assert sizes.told > 0.0
    assert wider[-1] != 1.0


def test_nothing_is_learned_where_nobody_knows_what_is_in_front():
    mug = library.make("mug")
    tracker = Tracker(mug)
    for frame in recording(mug, 5):
        tracker.step(frame)
    assert tracker._state.sizes == Sizes()
