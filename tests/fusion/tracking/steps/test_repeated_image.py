"""A driver that hangs: an image that was there before, beside what the robot reports now."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import recording

from fusion import Tracker, track
from fusion.tracking.answer import TrackSettings
from fusion.tracking.memory.last_image import BENT, FELT_ELSEWHERE, MOVED, TURNED, LastImage
from fusion.tracking.memory.state import TrackState
from fusion.tracking.steps.doubts.repeated import of_now
from scenes.geometry import poses
from scenes.geometry.cameras import Camera
from scenes.recordings.frames import Contacts, Frame

SETTINGS = TrackSettings()
CAMERA = Camera(140.0, 140.0, 80.0, 60.0, 160, 120)
# Two fingertips, one of which feels with two taxels.
SENSORS = ["thumb", "index", "index"]


def frame(index, image=0, move=(0.0, 0.0, 0.0), turn=0.0, felt=3, hand=True, shift=0.0, bent=0.0):
    depth = 0.5 + 0.001 * np.random.default_rng(image).normal(size=(120, 160))
    at = poses.make_pose(poses.exp_rotation([turn, 0.0, 0.0]), np.array([0.0, 0.0, 0.6]) + move)
    points = np.array([[0.0, 0.0, 0.5], [0.02, 0.0, 0.5], [0.024, 0.0, 0.5]])
    points[:, 0] += shift
    contacts = Contacts(points[:felt], sensors=SENSORS[:felt]) if felt else Contacts.none()
    joints = {"thumb": 0.2, "index": 0.5 + bent}
    return Frame(
        index, camera=CAMERA, depth=depth, contacts=contacts, world_from_hand=at if hand else None, joints=joints
    )


@pytest.mark.parametrize(
    ("later", "again"),
    [
        ({}, False),
        ({"move": (0.0, 1.5 * MOVED, 0.0)}, True),
        ({"turn": 1.5 * TURNED}, True),
        ({"bent": 1.5 * BENT}, True),
        ({"bent": 0.5 * BENT}, False),
        ({"move": (0.0, 0.5 * MOVED, 0.0), "turn": 0.5 * TURNED}, False),
        # it is another one
        ({"image": 1, "move": (0.0, 0.1, 0.0)}, False),
        # nothing is held: what stands still looks as before
        ({"felt": 0, "move": (0.0, 0.1, 0.0)}, False),
        # nobody says where the hand is, but what it feels is elsewhere; one place alone may have gone along a surface
        ({"hand": False, "shift": 1.5 * FELT_ELSEWHERE}, True),
        ({"hand": False, "shift": 0.5 * FELT_ELSEWHERE}, False),
        ({"hand": False, "felt": 1, "shift": 1.5 * FELT_ELSEWHERE}, False),
    ],
)
def test_an_image_is_that_of_before_if_it_is_alike_and_what_holds_has_moved(later, again):
    first, second = (LastImage.of(one) for one in (frame(0), frame(1, **later)))
    assert first.is_again(second) == again


def test_a_hand_in_view_tells_by_itself():
    first, second = (LastImage.of(frame(n, felt=0, move=(0.0, 0.0, 0.01 * n))) for n in range(2))
    assert first.is_again(second, in_view=True)
    assert not first.is_again(second)


def test_an_image_of_next_to_no_readings_tells_nothing():
    bare = np.zeros((120, 160))
    bare[0, :50] = 0.5
    assert LastImage.of(replace(frame(0), depth=bare)) is None
    assert LastImage.of(replace(frame(0), depth=None)) is None


def test_it_is_that_of_the_frame_that_had_it_first_until_another_comes():
    state = TrackState()
    told = [
        of_now(frame(n, image=max(n, 3) if n < 7 else n, move=(0.0, 0.0, 0.004 * n)), state, SETTINGS)
        for n in (2, 3, 4)
    ]
    assert [one[0].depth is not None for one in told] == [True, False, True]
    assert told[1][1][0] == "its image is not looked at: it is that of frame 2 again"
    # and is, though the hand comes back to where it was, or feels nothing any more
    for later in (
        frame(5, image=4, move=(0.0, 0.0, 0.03)),
        frame(6, image=4, move=(0.0, 0.0, 0.016)),
        frame(7, 4, felt=0),
    ):
        assert of_now(later, state, SETTINGS)[0].depth is None
    # a slow hand has moved after a while
    slowly = [frame(10 + n, image=9, move=(0.0, 0.0, 0.3 * MOVED * n)) for n in range(6)]
    looked = [of_now(one, state, SETTINGS)[0].depth is not None for one in slowly]
    assert looked == [True, True, True, True, False, False]


def test_a_frame_that_stands_still_is_looked_at_for_ever(drill):
    """The same frame again and again, as one tries a tracker out: nothing in it has moved."""
    first = recording(drill, 2)[0]
    tracker = Tracker(drill)
    answers = [tracker.step(replace(first, index=n)) for n in range(5)]
    assert not any("again" in note for answer in answers for note in answer.notes)
    assert answers[-1].verdict == "ok"


def test_what_is_held_goes_with_the_hand_while_its_image_hangs(drill):
    """As where the camera has no image: with that of before the drill would be 4 mm behind after each frame."""
    frames = recording(drill, 14)
    hung = [replace(one, depth=frames[6].depth) if 6 < one.index < 11 else one for one in frames]
    blind = [one.without_vision() if 6 < one.index < 11 else one for one in frames]
    for answer, other, made in zip(track(hung, drill), track(blind, drill), frames):
        np.testing.assert_allclose(answer.pose, other.pose, atol=1e-12)
        assert any("that of frame 6 again" in note for note in answer.notes) == (6 < made.index < 11)
        assert np.linalg.norm(poses.difference(answer.pose, made.camera_from_object_truth, drill.centroid)[3:]) < 0.005
