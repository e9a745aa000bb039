"""Cameras imitated from their optics against what is published of the real ones: nothing here knows a noise formula."""

from dataclasses import replace

import numpy as np
import pytest

from scenes.errors import InputError
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera
from scenes.synthesis import library
from scenes.synthesis.noise import presets as noise
from scenes.synthesis.optics import KNOWN_CAMERAS, CameraUnit, Material, TimeOfFlightCamera, draw_unit, take
from scenes.synthesis.optics.time_of_flight import unambiguous
from scenes.synthesis.recording import SynthesisSettings, synthesize_frames

CAMERA = Camera(570.0, 570.0, 119.5, 79.5, 240, 160)
PAINT = Material(albedo=0.5, texture=0.1, grain=0.006)
UNIT = CameraUnit(5)
STEREO = ("d435", "d455", "xtion")
FLIGHT = ("azure-kinect", "l515")


def wall(z, x0=-9.0, x1=9.0, y0=-9.0, y1=9.0, slope=0.0):
    """A rectangle at depth z + slope x."""
    corners = [[x0, y0, z + slope * x0], [x1, y0, z + slope * x1], [x1, y1, z + slope * x1], [x0, y1, z + slope * x0]]
    return corners, [[0, 1, 2], [0, 2, 3]]


def shot(name, walls, seed=0, unit=UNIT, material=PAINT, camera=CAMERA):
    """What the named camera delivers of walls at the identity pose."""
    built = KNOWN_CAMERAS[name] if isinstance(name, str) else name
    names = [f"wall{i}" for i in range(len(walls))]
    renderer = Renderer(dict(zip(names, walls)))
    poses = dict.fromkeys(names, np.eye(4))
    return take(renderer, poses, camera, built, np.random.default_rng(seed), unit, dict.fromkeys(names, material))


def inner(image, left):
    """Away from the borders: what the second eye does not see on the left, windows elsewhere."""
    return image[10:-10, left:-10]


def read(name, z, seed=0, **kwargs):
    """(fill, mean error, spread) in metres of a facing wall."""
    built = KNOWN_CAMERAS[name]
    left = int(CAMERA.fx * getattr(built, "baseline", 0.0) / z) + 12
    depth = inner(shot(name, [wall(z)], seed, **kwargs).depth, left).astype(float)
    error = depth[depth > 0] - z
    return (depth > 0).mean(), error.mean(), error.std()


@pytest.mark.parametrize("name", STEREO)
def test_noise_of_a_match_grows_with_the_square_of_depth(name):
    # Keselman et al., "Intel RealSense stereoscopic depth cameras" (CVPRW 2017): z^2 / (f b) times 0.05 to 0.1 px; on
    # real walls Ahn et al. (UR 2019) and Halmetschlager-Funek et al. (RAM 2019) find up to about twice that. For Kinect
    # Khoshelham and Elberink (Sensors 2012): half a step of 1/8 px and more. Averaged over places within a pixel.
    matches = []
    for middle in (0.6, 1.2):
        spread = [read(name, middle * scale)[2] / scale**2 for scale in (0.99, 1.0, 1.013)]
        matches.append(np.mean(spread) * CAMERA.fx * KNOWN_CAMERAS[name].baseline / middle**2)
    assert 0.04 < matches[0] < 0.2
    assert 0.04 < matches[1] < 0.2
    assert 0.5 < matches[1] / matches[0] < 2.0  # pixels of disparity alike: metres grow by the square, 4


@pytest.mark.parametrize(("name", "z", "least", "most"), [("d435", 0.5, 0.3e-3, 2e-3), ("d435", 1.0, 1.5e-3, 6e-3)])
def test_noise_of_the_d435_has_its_published_size(name, z, least, most):
    # Grunnet-Jepsen et al., "Tuning depth cameras for best performance": 1 % of depth or less, 2.5 to 5 mm at 1 m
    assert least < read(name, z)[2] < most


def test_noise_of_time_of_flight_has_its_published_size():
    # Toelgyessy et al. (Sensors 2021), Azure Kinect: about 1 mm at 1 m, below 2 mm at 2 m. L515 datasheet: 2.5 mm at
    # 1 m, 15.5 mm at 9 m on 95 %.
    assert 0.4e-3 < read("azure-kinect", 1.0)[2] < 1.6e-3
    assert read("azure-kinect", 2.0)[2] < 3e-3
    bright = Material(albedo=0.95)
    assert 1.2e-3 < read("l515", 1.0, material=bright)[2] < 3.5e-3
    assert 8e-3 < read("l515", 8.9, material=bright)[2] < 30e-3


@pytest.mark.parametrize("name", [*STEREO, *FLIGHT])
def test_facing_walls_are_read_in_full(name):
    # Fill rates above 95 to 99 % on white walls: Intel's depth quality testing, "Fill rate"
    for z in (0.6, 1.0):
        fill, mean, _ = read(name, z)
        assert fill > 0.95
        assert abs(mean) < 0.004 * z


@pytest.mark.parametrize("name", STEREO)
def test_shadow_lies_left_of_nearer_things_and_is_as_wide_as_disparity_says(name):
    near, far, left = 0.6, 1.0, -0.01
    depth = shot(name, [wall(near, left, 0.05, -0.06, 0.06), wall(far)]).depth
    edge = CAMERA.fx * left / near + CAMERA.cx
    middle = depth[60:100]
    band = [edge - np.flatnonzero(row[: int(edge)] > 0.9).max() - 1 for row in middle]
    expected = CAMERA.fx * KNOWN_CAMERAS[name].baseline * (1 / near - 1 / far)
    window = KNOWN_CAMERAS[name].matcher.window
    assert abs(np.median(band) - expected) < window / 2
    right = CAMERA.fx * 0.05 / near + CAMERA.cx
    after = middle[:, int(right) + window : int(right) + 3 * window]
    assert (after > 0.9).mean() > 0.9  # none to the right


@pytest.mark.parametrize("name", STEREO)
def test_edges_are_off_by_up_to_half_a_window_and_ragged(name):
    # Windows across an edge belong to either side: Scharstein and Szeliski (IJCV 2002), section 3.2
    window = KNOWN_CAMERAS[name].matcher.window
    off = []
    for seed in range(3):
        depth = shot(name, [wall(0.6, -0.01, 0.06, -0.05, 0.05), wall(1.0)], seed, unit=CameraUnit(seed)).depth
        near = (depth > 0.5) & (depth < 0.7)
        rows = np.flatnonzero(near.sum(axis=1) > 20)
        off += [CAMERA.fx * -0.01 / 0.6 + CAMERA.cx - np.flatnonzero(near[row]).min() for row in rows]
    assert abs(np.mean(off)) < window / 2 + 0.5
    assert 0.3 < np.std(off) < window


def test_a_narrow_rod_is_lost_or_fat_by_block_matching():
    # narrower than half a window: its own pixels are a minority in every window that holds it
    depth = shot("xtion", [wall(0.7, 0.0, 0.0015, -0.05, 0.05), wall(1.0)]).depth
    assert ((depth > 0.65) & (depth < 0.75)).mean() < 0.002


def test_structured_light_reads_in_steps_of_an_eighth():
    depth = shot("xtion", [wall(1.0, slope=0.3)]).depth
    steps = CAMERA.fx * 0.075 / depth[depth > 0].astype(float) * 8
    assert np.abs(steps - np.rint(steps)).max() < 1e-3


def concave(angle=np.pi / 2, z=1.0, size=0.5):
    """Two walls that meet in a vertical crease at x = 0, nearest to the camera at its sides."""
    x, near = size * np.sin(angle / 2), z - size * np.cos(angle / 2)
    left = [[-x, -9, near], [0, -9, z], [0, 9, z], [-x, 9, near]]
    right = [[0, -9, z], [x, -9, near], [x, 9, near], [0, 9, z]]
    return [(left, [[0, 1, 2], [0, 2, 3]]), (right, [[0, 1, 2], [0, 2, 3]])]


def test_light_by_detours_reads_corners_too_far():
    # Fuchs (ICPR 2010), Dorrington et al. (2011): concave corners are read centimetres too far and rounded
    white = Material(albedo=0.85)
    still = replace(KNOWN_CAMERAS["azure-kinect"], electrons=1e7, full_well=1e12, scattered=0.0)
    built = {bounces: replace(still, bounces=bounces) for bounces in (0, 1, 2)}
    wide = Camera(150.0, 150.0, 79.5, 59.5, 160, 120)
    truth = Renderer({str(i): w for i, w in enumerate(concave())}).render(wide, {"0": np.eye(4), "1": np.eye(4)}).depth
    error = {n: shot(b, concave(), material=white, camera=wide).depth - truth for n, b in built.items()}
    middle = np.s_[40:80, 40:120]
    assert np.abs(error[0][middle]).mean() < 1e-3
    assert 0.004 < np.median(error[1][middle]) < np.median(error[2][middle]) < 0.06
    black = shot(built[2], concave(), material=Material(albedo=0.1), camera=wide).depth - truth
    assert np.abs(np.median(black[middle])) < np.median(error[2][middle]) / 4


def test_flat_walls_light_no_detours():
    white = Material(albedo=0.85)
    still = replace(KNOWN_CAMERAS["azure-kinect"], electrons=1e7, full_well=1e12)
    np.testing.assert_allclose(shot(still, [wall(0.8)], material=white).depth, 0.8, atol=1e-3)


@pytest.mark.parametrize("name", FLIGHT)
def test_pixels_fly_between_two_depths(name):
    depth = shot(name, [wall(0.60, 0.0021, 9.0), wall(0.70)]).depth
    flying = (depth > 0.615) & (depth < 0.685)
    columns = np.flatnonzero(flying.any(axis=0))
    edge = CAMERA.fx * 0.0021 / 0.6 + CAMERA.cx
    assert len(columns) > 0
    assert np.abs(columns - edge).max() < 3


@pytest.mark.parametrize("name", [*STEREO, *FLIGHT])
def test_dark_things_and_empty_scenes_are_holes(name):
    black = Material(albedo=0.001)
    assert (shot(name, [wall(1.5)], material=black).depth > 0).mean() < 0.2
    for scene in ([], [wall(30.0)], [wall(0.05)], [wall(-1.0)]):
        seen = shot(name, scene)
        assert seen.depth.shape == seen.infrared.shape == (160, 240)
        assert (seen.depth > 0).mean() < 0.02  # a wall before the nearest reading is taken for another now and then


@pytest.mark.parametrize("name", [*STEREO, *FLIGHT])
@pytest.mark.parametrize("size", [(1, 1), (5, 4), (40, 23)])
def test_small_images_are_no_error(name, size):
    camera = Camera(300.0, 280.0, size[0] / 2, size[1] / 2, *size)
    depth = shot(name, [wall(0.8), wall(0.7, 0.0, 9.0)], camera=camera).depth
    assert depth.shape == size[::-1]
    assert np.isfinite(depth).all()


@pytest.mark.parametrize(("name", "albedo"), [("d455", 0.1), ("xtion", 0.5), ("azure-kinect", 0.12), ("l515", 0.04)])
def test_steep_things_are_holes(name, albedo):
    # Nguyen et al. (3DIMPVT 2012): readings of a Kinect are lost beyond 70 to 80 degrees
    fill = []
    for angle in (45.0, 86.0):
        steep = wall(1.2, -0.2, 0.2, slope=np.tan(np.deg2rad(angle)))
        there = Renderer({"wall": steep}).render(CAMERA, {"wall": np.eye(4)}).depth
        asked = (there > 0.8) & (there < 1.6)
        asked[:, :80] = False  # what the second eye of the widest camera does not see at 0.8 m
        fill.append((shot(name, [steep], material=Material(albedo=albedo)).depth[asked] > 0).mean())
    assert fill[0] > 0.8
    assert fill[1] < 0.6 * fill[0]


@pytest.mark.parametrize("name", [*STEREO, *FLIGHT])
def test_the_same_seed_gives_the_same_bits(name):
    walls = [wall(0.6, 0.0, 9.0), wall(1.0, slope=0.2)]
    first, again, other = (shot(name, walls, seed, unit=None) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.depth, again.depth)
    np.testing.assert_array_equal(first.infrared, again.infrared)
    assert (first.depth != other.depth).any()
    assert first.depth.dtype == np.float32
    assert first.infrared.dtype == np.uint8
    assert np.isfinite(first.depth).all()


def test_what_a_camera_does_wrong_lasts_over_frames():
    # bowls and offsets of one unit are the same in each frame: what a mean of frames does not remove
    unit = CameraUnit(5, (0.0, 2.0, 0.0, 0.0, 0.0, 2.0))
    depth = [inner(shot("d435", [wall(1.0)], seed, unit=unit).depth.astype(float), 50) for seed in range(3)]
    bias = np.mean([image[image > 0].mean() - 1.0 for image in depth])
    assert 1e-3 < abs(bias) < 0.02
    assert draw_unit(np.random.default_rng(1)) == draw_unit(np.random.default_rng(1))


def test_frequencies_together_reach_as_far_as_their_divisor():
    assert unambiguous((120e6, 80e6, 16e6)) == pytest.approx(299792458.0 / 2 / 8e6)
    for camera in KNOWN_CAMERAS.values():
        if isinstance(camera, TimeOfFlightCamera):
            assert unambiguous(camera.frequencies) > camera.farthest


def test_presets_have_robots_of_their_own():
    for name in KNOWN_CAMERAS:
        preset = noise.preset(name)
        assert preset.depth is KNOWN_CAMERAS[name]
        for other in ("none", "clean", "lab", "harsh", "lab-stereo", "lab-time-of-flight"):
            assert preset.robot != noise.PRESETS[other].robot
            assert preset.touch != noise.PRESETS[other].touch
    with pytest.raises(InputError, match="photographs a scene"):
        noise.observe_depth(None, CAMERA, "d435", np.random.default_rng(0))


@pytest.mark.parametrize("name", ["d435", "azure-kinect"])
def test_a_synthetic_frame_has_the_infrared_image_for_its_colours(name):
    camera = Camera(285.0, 285.0, 159.5, 119.5, 320, 240)
    box = library.make("box")
    grey, colour = (
        synthesize_frames(box, noise=name, occlusion=0.0, occluders="none", seed=2, settings=settings)[0]
        for settings in (SynthesisSettings(camera), SynthesisSettings(camera, infrared=False))
    )
    assert (grey.depth > 0).mean() > 0.5
    np.testing.assert_array_equal(grey.depth, colour.depth)
    assert (grey.rgb[..., :1] == grey.rgb).all()
    assert not (colour.rgb[..., :1] == colour.rgb).all()
