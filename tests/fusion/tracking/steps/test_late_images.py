"""Images that are of another instant than what the robot reports beside them, told by a hand in view that moves."""

from dataclasses import replace

import numpy as np
import pytest

from fusion.tracking.answer import TrackSettings
from fusion.tracking.filter import Belief
from fusion.tracking.memory.lateness import FASTEST, FEWEST, Lateness
from fusion.tracking.memory.state import TrackState
from fusion.tracking.motion import HandMotion
from fusion.tracking.slip import SlipWatch
from fusion.tracking.steps.predicting import predict
from scenes.recordings.beliefs import CalibrationModel
from scenes.recordings.frames import Frame
from vision.tracking.by_vision import ConstantVelocity

UNITS = np.array([0.06, 0.06, 0.06, 1.0, 1.0, 1.0])


def looked(late, count=12, speed=0.005, seed=0, noise=0.0005, off=0.008):
    """After looks at a hand that moves to and fro, seen by images that are so many frames late."""
    rng, told = np.random.default_rng(seed), Lateness()
    calibration = np.array([0.02, -0.01, 0.0, off, 0.0, -off])
    for n in range(count):
        velocity = np.array([0.01, 0.0, 0.0, 0.0, speed * np.sin(0.7 * n), 0.0])
        scatter = noise * rng.normal(size=6) / UNITS
        told = replace(told, velocity=velocity).looked(np.eye(4), calibration - late * velocity + scatter, UNITS)
    return told


@pytest.mark.parametrize("late", [-1.0, 0.0, 0.1, 1.0, 2.0])
@pytest.mark.parametrize("seed", range(4))
def test_the_delay_is_found_beside_a_calibration(late, seed):
    told = looked(late, seed=seed)
    found, sigma = told.frames
    assert abs(found - late) < 4.0 * sigma < 1.0
    assert told.there == (found if abs(late) >= 1.0 else 0.0)
    assert bool(told.said) == (abs(late) >= 1.0)
    np.testing.assert_allclose(told.smear, told.there * told.velocity)


def test_it_is_said_in_words():
    assert looked(2.0, noise=0.0).said == ("images are 2.0 frames late, as the hand is seen to move: check the stamps",)
    assert "1.0 frames early" in looked(-1.0, noise=0.0).said[0]


@pytest.mark.parametrize("how", [{"count": FEWEST - 1}, {"speed": 0.0}, {"speed": 0.0003, "noise": 0.001}])
def test_few_looks_and_a_hand_that_hardly_moves_tell_of_none(how):
    assert looked(2.0, **how).there == 0.0
    assert not looked(2.0, **how).smear.any()


def test_what_moves_too_fast_for_a_look_does_not_count():
    fast = np.array([0.0, 0.0, 0.0, 1.1 * FASTEST, 0.0, 0.0])
    before = looked(1.0)
    after = replace(before, velocity=fast).looked(np.eye(4), np.zeros(6), UNITS)
    assert after.looks == before.looks
    # nor does a look twice
    seen = np.eye(4)
    once = before.looked(seen, np.zeros(6), UNITS)
    assert once.looked(seen, np.zeros(6), UNITS) is once
    assert before.looked(None, np.zeros(6), UNITS) is before


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
    settings = TrackSettings().sizes
    state = TrackState(belief=Belief(np.eye(4), 1e-6 * np.eye(6), np.zeros((6, 6))))
    plain = state.told(state.belief, settings).covariance
    state.lateness = replace(looked(2.0, noise=0.0), velocity=np.array([0.0, 0.0, 0.0, 0.0, 0.004, 0.0]))
    wide = state.told(state.belief, settings).covariance - plain
    assert wide[4, 4] == pytest.approx(0.008**2, rel=0.05)
    np.testing.assert_allclose(np.delete(np.delete(wide, 4, 0), 4, 1), 0.0, atol=1e-12)
