"""A driver that hangs: contacts that were there before, beside where the robot is now."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import recording

from fusion import Tracker
from fusion.tracking.answer import TrackSettings
from fusion.tracking.memory.last_image import BENT, MOVED, TURNED
from fusion.tracking.memory.last_touch import LastTouch
from fusion.tracking.memory.state import TrackState
from fusion.tracking.steps.doubts.repeated import of_now
from scenes.geometry import poses
from scenes.recordings.frames import Contacts, Frame
from scenes.synthesis import library

PLACES = np.array([[0.0, 0.0, 0.5], [0.02, 0.0, 0.5], [0.024, 0.0, 0.5]])


def frame(index, move=0.0, turn=0.0, bent=0.0, felt=3, shift=0.0, hand=True):
    at = poses.make_pose(poses.exp_rotation([0.0, turn, 0.0]), [move, 0.0, 0.6])
    contacts = Contacts(PLACES[:felt] + shift) if felt else Contacts.none()
    return Frame(index, contacts=contacts, world_from_hand=at if hand else None, joints={"index": 0.5 + bent})


@pytest.mark.parametrize(
    ("later", "again"),
    [
        ({}, False),
        ({"move": 1.5 * MOVED}, True),
        ({"turn": 1.5 * TURNED}, True),
        ({"bent": 1.5 * BENT}, True),
        ({"move": 0.5 * MOVED, "turn": 0.5 * TURNED, "bent": 0.5 * BENT}, False),
        # the last bit of a number differs: another reading
        ({"move": 0.1, "shift": 1e-15}, False),
        ({"move": 0.1, "felt": 2}, False),
    ],
)
def test_contacts_are_those_of_before_if_they_are_alike_and_the_hand_has_moved(later, again):
    assert LastTouch.of(frame(0)).is_again(LastTouch.of(frame(1, **later))) == again


@pytest.mark.parametrize("little", [{"felt": 0}, {"felt": 1}, {"hand": False}])
def test_little_that_is_felt_or_no_hand_tells_nothing(little):
    assert LastTouch.of(frame(0, **little)) is None
    state = TrackState()
    for n in range(3):
        one = frame(n, move=0.01 * n, **little)
        assert of_now(one, state, TrackSettings()) == (one, ())


def test_contacts_that_hang_are_left_out_until_others_come():
    state = TrackState()
    told = [
        of_now(frame(n, move=0.004 * n, shift=0.0 if n < 4 else 0.004 * n), state, TrackSettings()) for n in range(6)
    ]
    assert [len(one.contacts) for one, _ in told] == [3, 0, 0, 0, 3, 3]
    assert told[2][1] == ("its contacts are left out: they are those of frame 0 again",)
    # they hang where the hand comes back, too
    state = TrackState()
    back = [of_now(frame(n, move=move), state, TrackSettings())[0] for n, move in enumerate([0.0, 0.01, 0.0])]
    assert [len(one.contacts) for one in back] == [3, 0, 0]


def test_a_track_whose_contacts_hang_follows_what_is_seen():
    model = library.make("drill")
    frames = recording(model)
    hung = [one if n < 4 else replace(one, contacts=frames[3].contacts) for n, one in enumerate(frames)]
    tracker = Tracker(model, seed=1)
    answers = [tracker.step(one) for one in hung]
    assert any("contacts are left out" in note for note in answers[-1].notes)
    for one, answer in list(zip(hung, answers))[4:]:
        assert np.linalg.norm(answer.pose[:3, 3] - one.camera_from_object_truth[:3, 3]) < 0.003
