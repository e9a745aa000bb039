"""A track of which no hand tells goes on as marks in its colour images have moved."""

from dataclasses import replace

import numpy as np
import pytest

from fusion.tracking.checkpoint import restore_tracker, save_tracker
from fusion.tracking.steps.marking import with_marks
from fusion.tracking.tracker import Tracker
from fusion.truth.errors import Judge
from scenes.geometry import poses
from scenes.geometry.cameras import Camera
from scenes.synthesis import library
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.noise.colour_camera import ColourCamera
from scenes.synthesis.noise.presets import PRESETS
from scenes.synthesis.recording import synthesize_frames
from scenes.synthesis.settings import SynthesisSettings
from vision.tracking.by_image import Motion

SMALL = Camera(400.0, 400.0, 239.5, 179.5, 480, 360)
FRAMES = 8


@pytest.fixture(scope="module")
def carried():
    """(model, frames) of a box that a hand carries, and with that hand told."""
    model = library.make("box")
    preset = replace(PRESETS["lab"], name="coloured", colour=ColourCamera(turn=0.0, shift=0.0, focal=0.0, cubic=0.0))
    told = synthesize_frames(
        model, five_finger_hand(), FRAMES, 0.3, (), preset, 4, settings=SynthesisSettings(camera=SMALL), motion="carry"
    )
    return model, [replace(f, hand=None, joints=None, world_from_hand=None) for f in told], told


def predicted(answer):
    """What the prediction went by, in words."""
    return next(stage.why for stage in answer.trace if stage.name == "predict")


def test_marks_in_colour_images_tell_where_it_goes(carried):
    model, frames, _ = carried
    tracker = Tracker(model)
    answers = [tracker.step(frame) for frame in frames]
    assert sum("marks in the image" in predicted(answer) for answer in answers[2:]) >= FRAMES - 3
    judge = Judge(model)
    errors = [judge.errors(a.pose, f.camera_from_object_truth).add_s for a, f in zip(answers, frames, strict=True)]
    assert max(errors) < 0.005


def test_colours_beside_depth_lose_nothing(carried):
    """An image ten pixels beside depth."""
    model, frames, _ = carried
    tracker, judge = Tracker(model), Judge(model)
    for frame in frames:
        answer = tracker.step(replace(frame, rgb=np.roll(frame.rgb, 10, axis=1)))
        assert judge.errors(answer.pose, frame.camera_from_object_truth).add_s < 0.005


def test_a_hand_that_is_told_tells_it_better(carried):
    model, _, told = carried
    tracker = Tracker(model)
    answers = [tracker.step(frame) for frame in told[:4]]
    assert all("with palm" in predicted(answer) or "the palm" in predicted(answer) for answer in answers[1:])


def test_a_grey_recording_goes_on_at_its_velocity(carried):
    model, frames, _ = carried
    tracker = Tracker(model)
    grey = [replace(f, rgb=np.repeat(f.rgb[..., :1], 3, axis=2)) for f in frames[:4]]
    answers = [tracker.step(frame) for frame in grey]
    assert all(predicted(answer) == "at its last velocity" for answer in answers[1:])


def test_marks_are_kept_in_a_checkpoint(carried):
    model, frames, _ = carried
    tracker, again = Tracker(model), Tracker(model)
    for frame in frames[:4]:
        tracker.step(frame)
    restore_tracker(again, save_tracker(tracker))
    for frame in frames[4:6]:
        first, second = tracker.step(frame), again.step(frame)
        assert np.array_equal(first.pose, second.pose)
        assert predicted(first) == predicted(second)
        assert "marks" in predicted(first)


def test_what_marks_do_not_tell_stays_with_the_velocity():
    """Marks know displacements to a tenth of what the velocity does, and nothing of turns."""
    model = library.make("box")
    velocity = np.diag(np.repeat([0.03, 0.003], 3) ** 2)
    marks = np.diag(np.repeat([30.0, 0.0003], 3) ** 2)
    motion = poses.perturb(np.eye(4), np.array([0.0, 0.0, 0.2, 0.004, 0.0, 0.0]), model.centroid)
    pose, noise = with_marks(model, Motion(motion, marks, None), np.eye(4), np.eye(4), velocity)
    step = poses.difference(pose, np.eye(4), model.centroid)
    assert np.allclose(step[:3], 0.0, atol=1e-3)
    assert step[3] == pytest.approx(0.004, rel=0.02)
    assert np.allclose(np.sqrt(np.diag(noise)), [0.03] * 3 + [0.0003] * 3, rtol=0.02)
