"""The other cameras and the errors that averaging does not remove, each against its formula."""

from dataclasses import replace

import numpy as np
import pytest
from made_depth import CAMERA, FRONTAL, OFF, plane, tilted, two_walls

from scenes.errors import InputError
from scenes.geometry.appearance.rendering import Renderer, Rendering
from scenes.geometry.cameras import Camera
from scenes.recordings.frames import Contacts
from scenes.synthesis.noise import depth as depth_noise
from scenes.synthesis.noise import multipath
from scenes.synthesis.noise import presets as noise


@pytest.mark.parametrize("angle", [0.0, 50.0, 70.0])
def test_time_of_flight_noise_has_the_published_spread(angle):
    view = tilted(np.deg2rad(angle))
    settings = replace(OFF, principle="time of flight", axial=1.0)
    seen = noise.observe_depth(view, CAMERA, settings, np.random.default_rng(1))
    incidence = noise.incidence_angles(view, CAMERA)
    expected = depth_noise.time_of_flight_sigma(view.depth.astype(float), incidence)
    good = incidence < np.deg2rad(80)
    assert np.std(((seen - view.depth) / expected)[good]) == pytest.approx(1.0, abs=0.02)
    # by hand, in millimetres at 2 m and 1 rad
    by_hand = 1.5 - 1.0 + 1.2 + 0.1 * 2**1.5 / (np.pi / 2 - 1) ** 2
    assert 1e3 * depth_noise.time_of_flight_sigma(np.array(2.0), np.array(1.0)) == pytest.approx(by_hand)


def test_stereo_noise_grows_with_the_square_of_depth():
    settings = replace(OFF, principle="stereo", axial=1.0, match_sigma=0.1, baseline=0.05)
    for z in (0.5, 1.0):
        view = plane([0, 0, -1], z)
        seen = noise.observe_depth(view, CAMERA, settings, np.random.default_rng(2))
        assert np.std(seen - view.depth) == pytest.approx(z**2 * 0.1 / (570 * 0.05), rel=0.02)


def test_stereo_errors_of_neighbours_are_alike():
    settings = replace(OFF, principle="stereo", axial=1.0, match_length=3.0)
    error = noise.observe_depth(FRONTAL, CAMERA, settings, np.random.default_rng(3)) - FRONTAL.depth
    for lag in (1, 3, 6):
        across = np.corrcoef(error[:, lag:].ravel(), error[:, :-lag].ravel())[0, 1]
        assert across == pytest.approx(np.exp(-(lag**2) / 18.0), abs=0.05)
    assert np.std(error) == pytest.approx(0.7**2 * 0.08 / (570 * 0.075), rel=0.08)


def test_an_unknown_principle_is_refused():
    with pytest.raises(InputError, match="time of flight, stereo, got 'sonar'"):
        noise.observe_depth(FRONTAL, CAMERA, replace(OFF, principle="sonar", axial=1.0), np.random.default_rng(0))


def bar(width, near=0.6, far=1.0):
    """A vertical bar of so many pixels before a wall."""
    view = two_walls(near, far)
    inside = (np.arange(320) >= 160) & (np.arange(320) < 160 + width)
    depth = np.where(inside, near, far)[None].repeat(240, 0).astype(np.float32)
    return Rendering(depth, np.where(inside, 0, 1)[None].repeat(240, 0), view.names, view.normals, view.region)


@pytest.mark.parametrize(("width", "lost"), [(2, True), (4, True), (5, False), (9, False)])
def test_parts_thinner_than_the_window_are_lost_and_nothing_else(width, lost):
    view = bar(width)
    seen = noise.observe_depth(view, CAMERA, replace(OFF, thin=5), np.random.default_rng(0))
    np.testing.assert_array_equal(seen == 0, (view.ids == 0) & lost)
    # a thin gap between near walls is no thin part
    gap = Rendering((1.6 - view.depth).astype(np.float32), view.ids, view.names, view.normals, view.region)
    assert (noise.observe_depth(gap, CAMERA, replace(OFF, thin=5), np.random.default_rng(0)) > 0).all()


SMALL = Camera(110.0, 110.0, 79.5, 59.5, 160, 120)


def corner(half_angle):
    """Two long walls meeting along a vertical line 0.8 m away, open towards the camera."""
    sheet = np.array([[0, -1, 0], [1, -1, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    faces = [[0, 1, 2], [0, 2, 3]]
    walls = {}
    for name, sign in (("left", -1), ("right", 1)):
        vertices = sheet.copy()
        vertices[:, 0] = sign * sheet[:, 0] * np.sin(half_angle)
        vertices[:, 2] = 0.8 - sheet[:, 0] * np.cos(half_angle)
        walls[name] = (vertices, faces)
    renderer = Renderer(walls)
    return renderer.render(SMALL, {name: np.eye(4) for name in walls})


def test_light_takes_no_detour_where_no_two_surfaces_face_each_other():
    np.testing.assert_allclose(multipath.multipath_error(FRONTAL, CAMERA, 0.5), 0.0, atol=1e-12)
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    pose = np.eye(4)
    pose[2, 3] = 0.6
    view = Renderer({"ball": (ball.vertices, ball.faces)}).render(SMALL, {"ball": pose})
    # facets of one sphere see each other at no more than rounding
    assert np.abs(multipath.multipath_error(view, SMALL, 0.5)).max() < 1e-5


def test_corners_read_too_far_and_sharp_ones_more():
    wide, sharp = (multipath.multipath_error(corner(np.deg2rad(a)), SMALL, 0.4) for a in (65.0, 40.0))
    row = 60
    assert wide[row].min() >= 0
    assert sharp[row, 60:100].mean() > wide[row, 60:100].mean() > 0.0005
    dark = multipath.multipath_error(corner(np.deg2rad(40.0)), SMALL, 0.1)
    assert dark[row, 80] == pytest.approx(sharp[row, 80] / 4, rel=0.4)


def test_detours_agree_with_the_integral_over_a_wall():
    """One point of one wall lit by the other, summed in plain NumPy over a fine mesh of that wall."""
    rng = np.random.default_rng(0)
    points = np.array([[0.05, 0.02, 0.7], [0.1, -0.1, 0.6]])
    normals = np.tile([-np.sqrt(0.5), 0.0, -np.sqrt(0.5)], (2, 1))
    senders = np.stack([-rng.uniform(0.05, 0.3, 400), rng.uniform(-0.2, 0.2, 400), rng.uniform(0.5, 0.8, 400)], axis=1)
    sender_normals = np.tile([np.sqrt(0.5), 0.0, -np.sqrt(0.5)], (400, 1))
    areas = rng.uniform(1e-5, 1e-4, 400)
    expected = []
    for p, n in zip(points, normals):
        own = np.linalg.norm(p)
        to = senders - p
        r = np.linalg.norm(to, axis=1)
        far = np.linalg.norm(senders, axis=1)
        cosines = np.maximum(to @ n / r, 0) * np.maximum(-np.sum(to * sender_normals, axis=1) / r, 0)
        lit = np.maximum(-np.sum(senders * sender_normals, axis=1) / far, 0) / far**2
        light = 0.4 * areas * cosines / (np.pi * r**2 + areas) * lit
        direct = -(p @ n) / own / own**2
        expected.append((light * 0.5 * (far + r - own)).sum() / (light.sum() + direct))
    found = multipath.detours(points, normals, senders, sender_normals, areas, 0.4)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    assert (found > 0).all()


def test_lasting_errors_are_the_same_in_every_frame():
    lab = noise.PRESETS["lab"]
    errors = noise.draw_lasting_errors(lab, CAMERA, ["a", "b"], ["tip"], np.random.default_rng(5))
    rng = np.random.default_rng(6)
    settings = replace(OFF, bias=0.002, scale=0.01)
    first, second = (noise.observe_depth(FRONTAL, CAMERA, settings, rng, errors.depth) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert np.std(first / FRONTAL.depth) > 1e-4
    assert set(errors.joints) == {"a", "b"}
    assert not np.allclose(errors.camera_from_robot, np.eye(4))
    again = noise.draw_lasting_errors(lab, CAMERA, ["a", "b"], ["tip"], np.random.default_rng(5))
    np.testing.assert_array_equal(errors.depth.bias, again.depth.bias)


def test_each_fingertip_has_an_offset_of_its_own():
    truth = Contacts(np.zeros((6, 3)), np.tile([0.0, 0, 1], (6, 1)), sensors=["a", "a", "b", "b", "c", "c"])
    touch = noise.TouchNoise(0, 0, 0, shape=0.001)
    drawn = []
    for seed in range(400):
        z = noise.observe_contacts(truth, touch, np.random.default_rng(seed)).points[:, 2]
        assert z[0] == z[1] != z[2] == z[3]
        drawn.append(z[::2])
    assert np.std(drawn) == pytest.approx(0.001, rel=0.08)
    assert abs(np.corrcoef(np.array(drawn).T)[0, 1]) < 0.15


def test_wrenches_have_noise_offset_and_drift():
    touch = noise.TouchNoise(wrench=0.01, force_offset=0.02, torque_offset=1e-4, force_drift=0.01, torque_drift=1e-5)
    truth = np.array([0.5, 0, 3.0, 0, 0.01, 0])
    rng = np.random.default_rng(8)
    seen = np.array([noise.observe_wrench("tip", truth, touch, rng) - truth for _ in range(4000)])
    np.testing.assert_allclose(seen[:, :3].std(axis=0), np.hypot(0.03, 0.02), rtol=0.05)
    np.testing.assert_allclose(seen[:, 3:].std(axis=0), np.hypot(1e-4, 1e-4), rtol=0.05)
    preset = noise.NoisePreset("p", OFF, touch)
    walks = []
    for seed in range(600):
        rng = np.random.default_rng(seed)
        errors = noise.draw_lasting_errors(preset, Camera(10, 10, 4, 4, 8, 8), [], ["tip"], rng)
        start = errors.wrenches["tip"]
        for _ in range(9):
            errors = errors.drifted(touch, rng)
        walks.append(errors.wrenches["tip"] - start)
    np.testing.assert_allclose(np.std(walks, axis=0), np.repeat([0.03, 3e-5], 3), rtol=0.12)


def test_compiled_loops_agree_with_the_formulas():
    from scenes.synthesis.noise import depth_kernels as kernels

    rng = np.random.default_rng(4)
    view = tilted(np.deg2rad(65.0))
    rays = (np.stack(np.meshgrid(np.arange(320), np.arange(240)), -1) - [CAMERA.cx, CAMERA.cy]) / CAMERA.fx
    rays = np.concatenate([rays, np.ones((240, 320, 1))], axis=2)
    cosine = np.abs((rays * view.normals).sum(axis=2)) / np.linalg.norm(rays, axis=2)
    angle = noise.incidence_angles(view, CAMERA)
    np.testing.assert_allclose(angle, np.arccos(np.clip(cosine, 0, 1)), atol=1e-9)

    truth = np.where(rng.random((60, 80)) < 0.1, 0.0, rng.uniform(0.3, 2.0, (60, 80)))
    draws, angle = rng.normal(size=truth.shape), rng.uniform(0.0, np.pi / 2, truth.shape)
    depth = truth.copy()
    kernels.add_structured_light(depth, angle, draws, 0.7, depth_noise.LARGEST_INCIDENCE)
    np.testing.assert_allclose(depth, truth + 0.7 * depth_noise.axial_sigma(truth, angle) * draws, rtol=1e-12)

    read = truth.copy()
    kernels.read_off(read, draws, 0.002, 1.004, 40.0, 0.125)
    np.testing.assert_allclose(read, depth_noise.quantised((truth + 0.002 * draws) * 1.004, 40.0, 0.125), rtol=1e-12)

    steps, near, far = depth_noise.depth_steps(truth, 0.01)
    padded = np.pad(truth, 1, mode="edge")
    around = np.stack([padded[i : i + 60, j : j + 80] for i in range(3) for j in range(3)])
    np.testing.assert_array_equal(far, around.max(axis=0))
    np.testing.assert_array_equal(near, np.where(around > 0, around, np.inf).min(axis=0))
    np.testing.assert_array_equal(steps, (truth > 0) & (far - near > 0.01))
