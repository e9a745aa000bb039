"""What hides an object besides a hand: a second object, clutter, the border; each by the asked share."""

import numpy as np
import pytest

from scenes.geometry.appearance.rendering import Renderer
from scenes.synthesis import library
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.noise.presets import PRESETS
from scenes.synthesis.recording import SynthesisSettings, synthesize_frames

SETTINGS = SynthesisSettings(mask=True, rgb=True)
EXACT = PRESETS["none"]


def alone(model, frame, camera=None):
    view = Renderer({"object": (model.vertices, model.faces)})
    return view.own_pixels(camera or frame.camera, {"object": frame.camera_from_object_truth}, "object")[0]


@pytest.mark.parametrize("asked", [0.0, 0.4, 0.8, 0.95])
def test_a_second_object_hides_the_asked_share(asked):
    model = library.make("mug")
    frame = synthesize_frames(model, None, 1, asked, noise=EXACT, seed=2, occluders="object", settings=SETTINGS)[0]
    assert 1 - frame.mask.sum() / alone(model, frame) == pytest.approx(asked, abs=0.03)
    assert frame.hand is None


@pytest.mark.parametrize("asked", [0.2, 0.6])
def test_the_border_cuts_off_the_asked_share(asked):
    model = library.make("drill")
    frame = synthesize_frames(model, None, 1, asked, noise=EXACT, seed=3, occluders="border", settings=SETTINGS)[0]
    camera = frame.camera
    wide = type(camera)(camera.fx, camera.fy, camera.cx + 640, camera.cy + 480, 3 * camera.width, 3 * camera.height)
    assert 1 - frame.mask.sum() / alone(model, frame, wide) == pytest.approx(asked, abs=0.03)


@pytest.mark.parametrize("occluders", ["none+clutter", "hand+clutter", "fingers+clutter"])
def test_clutter_stands_about_without_hiding_more(occluders):
    model = library.make("box")
    asked = 0.0 if occluders.startswith("none") else 0.5
    hand = five_finger_hand() if occluders.startswith("hand") else None
    frame, bare = (
        synthesize_frames(model, hand, 1, asked, noise=EXACT, seed=4, occluders=kind, settings=SETTINGS)[0]
        for kind in (occluders, occluders.partition("+")[0])
    )
    assert 1 - frame.mask.sum() / alone(model, frame) == pytest.approx(asked, abs=0.04)
    np.testing.assert_allclose(frame.camera_from_object_truth, bare.camera_from_object_truth)
    assert (np.abs(frame.depth - bare.depth) > 0.005).mean() > 0.01
