"""What has been at rest is where it was, until a picture is better with it elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import off_by, recording

from fusion.benchmarks.tracking.cells import Cell, sequence_of
from fusion.tracking.memory.rest import FRAMES, Rest, apart
from fusion.tracking.memory.state import TrackState
from fusion.tracking.steps.doubts.delays import moved_on
from fusion.tracking.tracker import Tracker
from scenes.geometry import poses
from scenes.synthesis import library


@pytest.fixture(scope="module")
def drill():
    return library.make("drill")


def by(pose, metres):
    return poses.make_pose(np.eye(3), [metres, 0.0, 0.0]) @ pose


def rested(model, steps, world=lambda index: np.eye(4)):
    """Rest after a pose that goes aside by each of `steps` (m) from frame to frame, and the last pose."""
    rest, pose = Rest().followed(model, None, world(0)), np.eye(4)
    for index, step in enumerate(steps, 1):
        pose = by(pose, step)
        rest = rest.followed(model, world(index - 1) @ pose, world(index))
    return rest, pose


@pytest.mark.parametrize(
    ("steps", "rests"),
    [
        ([0.0] * (FRAMES + 1), True),
        ([0.0] * FRAMES, False),
        ([0.001, -0.001, 0.001, 0.0], True),
        ([0.003] * 8, False),
        ([0.0] * 5 + [0.02], False),
        ([0.02] * 5 + [0.0] * (FRAMES + 1), True),
    ],
)
def test_what_has_not_moved_rests(drill, steps, rests):
    rest, pose = rested(drill, steps)
    away = rest.left(drill, by(pose, 0.03))
    assert (away is not None) is rests
    assert rest.left(drill, pose) is None
    if rests:
        assert apart(drill, away, pose) < 0.003


def test_it_rests_in_the_world_and_not_before_the_camera(drill):
    """The camera goes aside by 10 mm a frame."""
    rest, pose = rested(drill, [0.0] * 6, world=lambda index: by(np.eye(4), 0.01 * index))
    np.testing.assert_allclose(rest.left(drill, by(pose, 0.2)), by(pose, 0.06), atol=1e-12)
    assert rest.left(drill, by(pose, 0.06)) is None


def test_what_a_hand_carries_does_not_rest(drill):
    rest, pose = rested(drill, [0.0] * 6)
    rest = rest.followed(drill, None, np.eye(4))
    assert rest.left(drill, by(pose, 0.2)) is None


def test_a_hand_that_nobody_knows_takes_nothing_along():
    """It comes to a drill that lies; without a memory of rest fits of it go 14 mm with the hand."""
    model, frames, _ = sequence_of(Cell("d435", "drill", 0, ("pick",), 36, (), 11, None), "pick")
    tracker = Tracker(model, use=("vision",))
    for frame in frames[:13]:
        answer = tracker.step(replace(frame, hand=None, joints=None, world_from_hand=None))
        degrees, millimetres = off_by(answer, frame, model)
        assert degrees < 5.0
        assert millimetres < 6.0


def test_an_object_that_starts_to_move_is_followed(drill):
    still, moving = recording(drill, 6, step=(0.0,) * 6), recording(drill, 10)
    frames = [*still, *[replace(frame, index=frame.index + 5) for frame in moving[1:]]]
    tracker = Tracker(drill)
    for frame in frames:
        answer = tracker.step(replace(frame.without_touch(), world_from_hand=None))
        degrees, millimetres = off_by(answer, frame, drill)
        assert degrees < 3.0
        assert millimetres < 4.0


def test_a_hand_that_goes_without_the_object_is_no_late_image(drill):
    """It goes by 12 mm a frame, and nobody has a model of it."""
    frames = recording(drill, 10, step=(0.0,) * 6)
    hand, tracker = frames[0].world_from_hand, Tracker(drill)
    for frame in frames:
        hand = poses.make_pose(np.eye(3), [0.012 * min(frame.index, 1), 0.0, 0.0]) @ hand
        depth = np.where(frame.depth > 0, frame.depth, np.float32(1.5))
        answer = tracker.step(replace(frame.without_touch(), depth=depth, world_from_hand=hand))
        assert off_by(answer, frame, drill)[1] < 4.0
        assert not any("frames late" in note for note in answer.notes)


def test_an_answer_of_an_earlier_time_is_moved_on_with_what_is_held_only(drill):
    frame = recording(drill, 1)[0]
    tracker = Tracker(drill)
    answer, on = tracker.step(frame), by(np.eye(4), 0.03)
    held = moved_on(answer, on, tracker._state, None)
    np.testing.assert_allclose(held.pose, on @ answer.pose)
    loose = moved_on(answer, on, TrackState(), None)
    np.testing.assert_array_equal(loose.pose, answer.pose)
