"""A camera that is moved against the robot amid a track: the robot leaps against the image, what it holds does not."""

from dataclasses import replace

import numpy as np
import pytest

from fusion.benchmarks.tracking.cells import Cell, sequence_of
from fusion.tracking.memory.lateness import Lateness
from fusion.tracking.steps.bumped import FAR, bump
from fusion.tracking.tracker import track
from scenes.geometry import poses
from vision.look.hand.hand import HandTold

CENTRE = np.array([0.0, 0.0, 0.6])


def look(move, sigma=0.0005):
    """What a look tells that has the robot's hand elsewhere by a move (3,)."""
    xi = np.concatenate([np.zeros(3), move])
    information = np.diag(np.repeat([0.01, sigma], 3) ** -2.0)
    return HandTold(poses.make_pose(None, move), CENTRE, information, information @ xi)


def test_it_is_what_the_hand_is_seen_to_leap_by():
    before, after = look(np.array([0.002, 0.0, 0.0])), look(np.array([0.002, 0.015, 0.0]))
    np.testing.assert_allclose(bump(before, after, CENTRE)[:3, 3], [0.0, 0.015, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    "after",
    [None, look(np.array([0.0, 0.9 * FAR, 0.0])), look(np.array([0.0, 0.015, 0.0]), sigma=0.01)],
    ids=["no look", "near", "hardly told"],
)
def test_what_is_near_or_hardly_told_is_none(after):
    before = look(np.zeros(3))
    assert bump(before, after, CENTRE) is None
    assert bump(None, before, CENTRE) is None
    assert bump(before, before, CENTRE) is None


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


@pytest.mark.parametrize("seed", [1, 2])
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
        assert np.linalg.norm(gone) < 0.006, frame.index
