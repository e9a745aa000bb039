"""What looks in full have in common is averaged over them: it is the same from look to look, and each tells it anew."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from made_frames import recording

import fusion.tracking.steps.glancing as glancing
from fusion.tracking.answer import TrackSettings
from fusion.tracking.filter import Belief, Measurement
from fusion.tracking.memory.hypotheses import Hypothesis
from fusion.tracking.memory.rest import Rest
from fusion.tracking.memory.state import GlanceSettings
from fusion.tracking.steps.glancing import Glanced, fitted, freed, may_glance, part_counted, steadied, surprise_of
from fusion.tracking.steps.refining import loose
from fusion.tracking.tracker import Tracker
from scenes.evidence.align import Prior
from scenes.evidence.table import WEIGHT
from scenes.geometry import poses
from scenes.synthesis import library


@pytest.fixture(scope="module")
def looked():
    """A tracker of a mug after a look in full, with what it sensed there and what it knew of the looks before."""
    model = library.make("mug")
    settings = TrackSettings(glance=GlanceSettings(every=1))
    tracker = Tracker(model, settings=settings)
    for frame in recording(model, 6):
        tracker.step(frame)
    known = tracker._state.known
    assert known is not None
    return model, settings, tracker._sensed, known


def test_the_first_look_is_as_it_was_solved(looked):
    model, settings, sensed, known = looked
    measured = Measurement(known.pose, known.own, known.shared)
    first = steadied(model, loose(known.pose, known.own, settings), sensed, measured, None, settings)
    np.testing.assert_allclose(first.measured.pose, known.pose, atol=1e-12)
    np.testing.assert_allclose(poses.perturb(first.fit, first.offset, model.centroid), known.pose, atol=1e-12)
    assert first.weight == pytest.approx(1.0 / np.trace(known.own[3:, 3:]))


def test_a_look_moves_the_common_offset_by_its_share(looked):
    """Solved a millimetre aside: a share of that is taken over, less where more is known."""
    model, settings, sensed, known = looked
    prior = loose(known.pose, known.own, settings)
    aside = poses.perturb(known.pose, [0.0, 0.0, 0.0, 0.001, 0.0, 0.0], model.centroid)
    moved = {}
    for weight in (known.weight, 1e3 * known.weight):
        before = replace(known, weight=weight)
        one = steadied(model, prior, sensed, Measurement(aside, known.own, known.shared), before, settings)
        same = steadied(model, prior, sensed, Measurement(known.pose, known.own, known.shared), before, settings)
        moved[weight] = float(np.linalg.norm((one.offset - same.offset)[3:]))  # turns settle in another facet
        own = 1.0 / np.trace(known.own[3:, 3:])
        assert one.weight == pytest.approx(own + settings.glance.memory * weight)
        assert moved[weight] < 0.001
    assert moved[1e3 * known.weight] < 0.02 * moved[known.weight]


def test_touch_alone_says_nothing_of_a_cameras_errors(looked):
    model, settings, sensed, known = looked
    blind = replace(sensed, looked=replace(sensed.looked, pixels=sensed.looked.pixels.take(np.zeros(0, dtype=int))))
    aside = poses.perturb(known.pose, [0.0, 0.0, 0.0, 0.002, 0.0, 0.0], model.centroid)
    measured = Measurement(aside, known.own, known.shared)
    one = steadied(model, loose(known.pose, known.own, settings), blind, measured, known, settings)
    np.testing.assert_allclose(one.measured.pose, aside, atol=1e-12)


def test_what_a_glance_measures_is_not_what_was_predicted(looked):
    """Rows that count by a part, as they do where the occluder is not known, find an object that is 5 mm beside where
    it was predicted; what they leave open stays there.
    """
    model, settings, sensed, known = looked
    counted, none = sensed.seen.take(np.arange(len(sensed.seen))), sensed.seen.take(np.arange(0))
    counted.rows[:, WEIGHT] *= 0.2
    there = fitted(model, counted, none, known.pose, Prior(known.pose, np.zeros((6, 6))), 20)
    beside = poses.perturb(there, [0.0, 0.0, 0.0, 0.005, 0.0, 0.0], model.centroid)
    predicted = loose(beside, 1e-8 * np.eye(6), settings)
    part = part_counted(model, counted, Measurement(known.pose, known.own, known.shared))
    rougher = Measurement(known.pose, 20.0 * known.own, known.shared)
    assert part_counted(model, counted, rougher) == pytest.approx(0.2 * part_counted(model, sensed.seen, rougher))
    left = {}
    for name, prior in (("held", predicted), ("freed", freed(predicted, part))):
        fit = fitted(model, counted, none, beside, prior, 20)
        left[name] = float(np.linalg.norm(poses.difference(fit, there, model.centroid)[3:]))
    assert left["freed"] < 0.001 < 0.002 < left["held"]
    unseen = fitted(model, none, none, beside, freed(predicted, part), 20)
    np.testing.assert_allclose(unseen, beside, atol=1e-12)


@pytest.mark.parametrize(
    ("told_apart", "steps", "glances", "otherwise"),
    [
        (False, [0.003], 1, False),
        (False, [0.005, 0.006], 2, False),
        (False, [0.005, 0.010], 2, True),
        (True, [0.005], 1, False),
    ],
)
def test_pixels_are_chosen_anew_where_a_glance_has_led(looked, monkeypatch, told_apart, steps, glances, otherwise):
    """Where they are chosen by where the object was expected they hold it there; what still goes on is looked at."""
    model, settings, sensed, known = looked
    begun = []

    def glanced(model, frame, felt, looker, start, *rest):
        begun.append(start[0, 3])
        measured = Measurement(poses.make_pose(None, [steps[len(begun) - 1], 0.0, 0.0]), known.own, known.shared)
        return Glanced(SimpleNamespace(told_apart=told_apart), measured, (), 1.0, 0.0, "")

    monkeypatch.setattr(glancing, "_glanced_at", glanced)
    predicted = Belief(np.eye(4), known.own, known.shared)
    rest = known, sensed.things, False, sensed, Rest(), settings
    found = glancing.glance(model, None, None, None, predicted, *rest)
    assert begun == [0.0, *steps[:-1]][:glances]
    assert found.measured.pose[0, 3] == (steps[-1] if otherwise else steps[0])
    assert bool(found.otherwise) is otherwise


def test_other_ways_round_in_the_leaders_place_do_not_keep_it_from_being_glanced_at(looked):
    model, settings, sensed, known = looked
    settings = replace(settings, glance=GlanceSettings())
    frame, pose = replace(sensed.viewed, index=known.index + 1), known.pose
    state = SimpleNamespace(known=known, index=known.index, renewal=SimpleNamespace(due=known.index + 9), glanced=0)
    leader = Hypothesis(pose, 1e-6 * np.eye(6), 0.0, age=9)

    def beside(moved):
        return may_glance(model, frame, state, (leader, replace(leader, pose=pose @ moved)), settings)

    assert may_glance(model, frame, state, (leader,), settings)
    assert beside(poses.make_pose(poses.exp_rotation([0.0, 0.0, 1.5])))
    assert not beside(poses.make_pose(None, [0.03, 0.0, 0.0]))


def test_what_a_frame_leaves_open_surprises_nobody(rng):
    """A turn about an axis that is left open; across it a step counts as it did, and where nothing is open."""
    own = np.diag(np.repeat([0.01, 0.001], 3) ** 2.0)
    axis = np.concatenate([poses.random_unit_vectors(1, rng)[0], 0.02 * rng.normal(size=3)])
    hidden = np.outer(axis, axis)
    surprise, told = surprise_of(0.5 * axis, own, hidden)
    assert surprise < 1.0
    assert np.linalg.norm(told / np.sqrt(np.diag(own))) < 0.05
    across = np.linalg.cholesky(own) @ np.linalg.svd(np.linalg.solve(np.linalg.cholesky(own), axis)[None])[2][1:].T
    step = 6.0 * across[:, 0]
    surprise, told = surprise_of(step, own, hidden)
    assert surprise == pytest.approx(36.0)
    np.testing.assert_allclose(told, step, atol=1e-12)
    surprise, told = surprise_of(step, own, np.zeros((6, 6)))
    assert surprise == pytest.approx(36.0)
    np.testing.assert_array_equal(told, step)
