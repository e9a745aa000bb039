"""A colour camera beside depth: the image is off by what its calibration leaves, and by nothing else."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera
from scenes.synthesis import library
from scenes.synthesis.noise.colour_camera import ColourCamera, ColourErrors, colour_image, draw_colour_errors
from scenes.synthesis.noise.presets import NoisePreset, draw_lasting_errors
from scenes.synthesis.recording import synthesize_frames
from scenes.synthesis.settings import SynthesisSettings

LENS = Camera(285.0, 285.0, 159.5, 119.5, 320, 240)
# The object alone, in one colour, before nothing: what is left is where it is.
PLAIN = ColourCamera(blur=(0.5, 0.5), grain=(0.0, 0.0), gains=(1.0, 1.0), patchy=0.0)
EXACT = ColourErrors(np.eye(4), 1.0, 0.0)


def seen(errors, camera=PLAIN, seed=4):
    """The image of a box 0.5 m away, and where depth has it."""
    model = library.make("box")
    renderer = Renderer({"object": (model.vertices, model.faces)})
    scene = {"object": poses.make_pose(poses.exp_rotation(np.array([[0.3, 0.8, 0.2]]))[0], [0.01, -0.02, 0.5])}
    image = colour_image(renderer, scene, LENS, camera, np.random.default_rng(seed), errors)
    return image, renderer.render(LENS, scene).mask("object")


def apart(image):
    """(h, w) what is not the dark ground."""
    return np.abs(image.astype(int) - 20).max(axis=2) > 8


def middle(image):
    """(2,) centre of what is not the dark ground (px)."""
    v, u = np.nonzero(apart(image))
    return np.array([u.mean(), v.mean()])


def test_without_errors_the_image_lies_on_depth():
    image, mask = seen(EXACT)
    found = apart(image)
    grown = cv2.dilate(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    kept = cv2.erode(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    assert not (found & ~grown).any()
    assert found[kept].mean() > 0.99


def test_a_turn_and_a_shift_move_it_as_they_say():
    image, _ = seen(EXACT)
    turned, _ = seen(
        replace(EXACT, moved=poses.make_pose(poses.exp_rotation(np.array([[0.0, 0.01, 0.0]]))[0], [0] * 3))
    )
    moved, _ = seen(replace(EXACT, moved=poses.make_pose(np.eye(3), [0.002, 0.0, 0.0])))
    assert middle(turned) - middle(image) == pytest.approx([0.01 * LENS.fx, 0.0], abs=0.15)
    assert middle(moved) - middle(image) == pytest.approx([0.002 * LENS.fx / 0.5, 0.0], abs=0.15)


def test_a_focal_length_scales_it_about_the_principal_point():
    image, mask = seen(EXACT)
    larger, _ = seen(replace(EXACT, focal=1.1))
    off = middle(image) - [LENS.cx, LENS.cy]
    assert middle(larger) - middle(image) == pytest.approx(0.1 * off, abs=0.3)
    found = apart(larger)
    assert found.sum() == pytest.approx(1.21 * mask.sum(), rel=0.1)


def test_calibrations_are_off_by_one_to_three_pixels():
    rng = np.random.default_rng(1)
    camera, point, lens = ColourCamera(), np.array([[0.05, 0.0, 0.6]]), Camera(570.0, 570.0, 319.5, 239.5, 640, 480)
    drawn = [draw_colour_errors(camera, rng) for _ in range(300)]
    shifts = [np.linalg.norm(lens.project(poses.apply(one.moved, point))[0] - lens.project(point)[0]) for one in drawn]
    assert 1.0 < np.median(shifts) < 3.0
    assert np.quantile(shifts, 0.99) < 8.0
    assert np.std([one.focal for one in drawn]) == pytest.approx(camera.focal, rel=0.2)


def before_a_wall():
    """A box 0.2 m before a wall."""
    model = library.make("box")
    renderer = Renderer({"object": (model.vertices, model.faces)})
    wall = 2.0 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    renderer.add("background", wall, [[0, 1, 2], [0, 2, 3]])
    scene = {
        "object": poses.make_pose(np.eye(3), [0.0, 0, 0.5]),
        "background": poses.make_pose(np.eye(3), [0.0, 0, 0.7]),
    }
    return renderer, scene


def test_things_have_patches_and_one_throws_its_shade():
    renderer, scene = before_a_wall()
    ground = ~renderer.render(LENS, scene).mask("object")
    plain = [colour_image(renderer, scene, LENS, PLAIN, np.random.default_rng(s), EXACT)[ground] for s in range(8)]
    # a shade is a part of the ground, darker than the rest
    shares = [float((one.max(axis=1) < 0.85 * np.median(one.max(axis=1))).mean()) for one in plain]
    assert max(shares) > 0.01
    assert max(shares) < 0.5
    patchy = colour_image(renderer, scene, LENS, ColourCamera(), np.random.default_rng(0), EXACT)
    assert patchy[ground].astype(float).std(axis=0).max() > 5.0


def test_what_things_look_like_lasts_through_a_recording():
    """Blur and grain are each frame's own; colours, patches and light are not."""
    camera = ColourCamera(grain=(0.5, 0.5), blur=(0.7, 0.7))
    renderer, scene = before_a_wall()
    lasting = replace(EXACT, look=5)
    first, second, own = (
        colour_image(renderer, scene, LENS, camera, np.random.default_rng(seed), errors).astype(float)
        for seed, errors in ((0, lasting), (1, lasting), (1, EXACT))
    )
    assert np.abs(first - second).mean() < 1.0
    assert np.abs(first - own).mean() > 10.0


def test_a_recording_has_one_calibration_and_frames_their_own():
    preset = NoisePreset("beside", colour=ColourCamera())
    rng = np.random.default_rng(0)
    lasting = draw_lasting_errors(preset, LENS, [], [], rng)
    assert lasting.colour is not None
    assert lasting.drifted(preset.touch, rng).colour is lasting.colour
    settings = SynthesisSettings(camera=LENS)
    model = library.make("box")
    plain = synthesize_frames(model, None, 1, 0.0, ("point",), "clean", 3, "none", settings)[0]
    first, again = (
        synthesize_frames(model, None, 1, 0.0, ("point",), preset, 3, "none", settings)[0] for _ in range(2)
    )
    assert np.array_equal(first.rgb, again.rgb)
    assert not np.array_equal(first.rgb, plain.rgb)
    assert np.array_equal(first.depth, plain.depth)  # depth is as it was without a colour camera
