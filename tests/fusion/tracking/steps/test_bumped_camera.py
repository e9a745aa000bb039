"""A camera that is moved against the robot amid a track: the robot leaps against the image, what it holds does not."""

from dataclasses import replace

import numpy as np
import pytest

from fusion.benchmarks.tracking.cells import Cell, sequence_of
from fusion.tracking.memory.lateness import Lateness
from fusion.tracking.steps.doubts.bumped import FAR, bump, recalibrated
from fusion.tracking.tracker import track
from scenes.geometry import poses
from scenes.recordings.beliefs import Beliefs
from vision.look.hand.hand import HandTold

CENTRE = np.array([0.0, 0.0, 0.6])


def look(move, sigma=0.0005):
    """What a look tells that has the robot's hand elsewhere by a move (3,)."""
    xi = np.concatenate([np.zeros(3), move])
    information = np.diag(np.repeat([0.01, sigma], 3) ** -2.0)
    return HandTold(poses.make_pose(None, move), CENTRE, information, information @ xi)


def seen(frame, move):
    """A frame whose robot reports its hand at -move (3,) beside where it is seen; images are what they were."""
    off = poses.make_pose(None, -np.asarray(move))
    return replace(frame, camera_from_world=off @ frame.camera_from_world)


@pytest.fixture(scope="module")
def clean():
    """A drill in a hand whose camera and calibration are right."""
    model, frames, _ = sequence_of(Cell("clean", "drill", 0, ("carry",), 3, (), 1, None), "carry")
    return model, frames[0]


LEAP = np.array([0.0, 0.015, 0.0])


def test_it_is_what_the_hand_is_seen_to_leap_by(clean):
    model, frame = clean
    before, after = look(np.zeros(3)), look(LEAP)
    found = bump(model, seen(frame, LEAP), frame.camera_from_object_truth, before, after)
    np.testing.assert_allclose(found[:3, 3], LEAP, atol=1e-12)


def test_a_hand_that_is_seen_no_better_there_has_not_leapt(clean):
    model, frame = clean
    pose, looks = frame.camera_from_object_truth, (look(np.zeros(3)), look(LEAP))
    assert bump(model, frame, pose, *looks) is None
    assert bump(model, replace(frame, depth=np.zeros_like(frame.depth)), pose, *looks) is None
    assert bump(model, frame.without_vision(), pose, *looks) is None
    assert bump(model, replace(frame, hand=None), pose, *looks) is None


@pytest.mark.parametrize(
    "after",
    [None, look(np.array([0.0, 0.9 * FAR, 0.0])), look(LEAP, sigma=0.01)],
    ids=["no look", "near", "hardly told"],
)
def test_what_is_near_or_hardly_told_is_none(clean, after):
    model, frame = clean
    there = model, seen(frame, LEAP), frame.camera_from_object_truth
    before = look(np.zeros(3))
    assert bump(*there, before, after) is None
    assert bump(*there, None, before) is None
    assert bump(*there, before, before) is None


def leapt(at, count=12):
    """After a camera was moved by 15 mm before look `at`, of a hand that moves to and fro, as a track tells of it."""
    told, off, here = Lateness(), np.zeros(3), np.zeros(3)
    for n in range(count):
        step = np.array([0.004 * np.sin(0.7 * n), 0.002, 0.0])
        if n == at:
            off = off - np.array([0.0, 0.0, 0.015])
            step = step + np.array([0.0, 0.0, 0.015])
        here = here + step
        told = told.reported(n, poses.make_pose(None, CENTRE + here))
        told = replace(told, velocity=np.concatenate([np.zeros(3), step])).looked(look(off), CENTRE)
        yield told


@pytest.mark.parametrize("at", [3, 6])
def test_it_is_no_delay(at):
    """In the frame of the leap it looks like one; the next tells that the hand is off by as much and has not moved."""
    for told in leapt(at):
        assert told.there == 0.0
        assert not told.said
    assert told.looks < 12 - at + 1  # what was told before is of another calibration
    assert told.before[0][0] >= at


@pytest.mark.parametrize("seed", [2, 3])
def test_what_is_held_goes_where_the_hand_is_seen(seed):
    """The camera's pose leaps by 12 mm and 1 degree; images are what they were."""
    cell = Cell("lab", "drill", 0, ("carry",), 16, (), seed, None)
    model, frames, _ = sequence_of(cell, "carry")
    rng = np.random.default_rng(seed)
    turn, move = poses.random_unit_vectors(2, rng)
    off = poses.make_pose(poses.exp_rotation(np.deg2rad(1.0) * turn), 0.012 * move)
    moved = [replace(one, camera_from_world=off @ one.camera_from_world) for one in frames[8:]]
    told = [*frames[:8], *moved]
    for frame, answer in zip(told, track(told, model, seed=seed)):
        gone = poses.apply(answer.pose, model.centroid[None]) - poses.apply(
            frame.camera_from_object_truth, model.centroid[None]
        )
        assert np.linalg.norm(gone) < 0.0046, frame.index  # 5.3 mm and more where it goes with the camera


def test_its_calibration_may_be_as_far_off_as_it_is_seen_to_be():
    seen = poses.make_pose(poses.exp_rotation([0.0, 0.05, 0.0]), [0.02, 0.0, 0.01])
    was = Beliefs()
    now = recalibrated(was, seen)
    assert now.calibration.rotation_sigma == pytest.approx(0.05 / np.sqrt(3.0))
    assert now.calibration.translation_sigma == pytest.approx(np.hypot(0.02, 0.01) / np.sqrt(3.0))
    assert replace(now, calibration=was.calibration) == was
    assert recalibrated(was, np.eye(4)) == was  # never less than was believed
