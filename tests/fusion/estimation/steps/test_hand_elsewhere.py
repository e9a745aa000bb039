"""A hand that is told need not hold the object: where nothing is at it, all the image is looked at."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import off_by

from fusion.estimation.estimate import estimate
from scenes.geometry import poses
from scenes.synthesis import library, motion
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.noise.presets import PRESETS
from scenes.synthesis.recording import SynthesisSettings, synthesize_frames
from vision.look.look import look

SETTINGS = SynthesisSettings(camera=SynthesisSettings().camera.scaled(0.5), rgb=False)


@pytest.fixture(scope="module")
def drill():
    return library.make("drill")


def made(model, away, seed=3):
    """The first frame of a hand that comes from so far (m), without a start."""
    usual = motion.MotionSettings
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(motion, "MotionSettings", lambda: usual(away=away, reach=4))
        frames = synthesize_frames(
            model, five_finger_hand(), 12, 0.4, noise=PRESETS["lab"], seed=seed, settings=SETTINGS, motion="pick"
        )
    return replace(frames[0], prior=None)


def stages(answer):
    return {stage.name: stage for stage in answer.trace}


@pytest.fixture(scope="module")
def far(drill):
    return made(drill, 0.4)


def test_nothing_is_at_the_hand(drill, far):
    assert look(far, drill).empty
    assert not look(made(drill, 0.0), drill).empty
    assert not look(replace(far, mask=far.depth > 0), drill).empty
    assert not look(far, drill, start=far.camera_from_object_truth).empty


def test_what_lies_away_from_the_hand_is_found(drill, far):
    answer = estimate(far, drill)
    degrees, millimetres = off_by(answer, far, drill)
    assert answer.verdict == "ok"
    assert degrees < 5.0
    assert millimetres < 5.0
    assert stages(answer)["look again"].ran
    assert "nothing is at the hand" in stages(answer)["look again"].why


def test_a_hand_behind_the_camera(drill, far):
    behind = replace(far, world_from_hand=poses.make_pose(np.eye(3), [0.0, 0.0, -0.5]))
    assert look(behind, drill).empty
    assert estimate(behind, drill).verdict == "ok"


def test_what_is_hidden_in_the_hand_is_not_taken_for_another_thing(drill):
    """Nothing of the object is in the image."""
    frame = made(drill, 0.0)
    hidden = replace(frame.without_touch(), depth=np.full_like(frame.depth, 1.2))
    before = estimate(replace(hidden), drill)
    assert before.verdict != "ok"
    assert before.confidence < 0.5
