"""Each error model against the formula that it claims: sample statistics, not looks."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_depth import CAMERA, FRONTAL, OFF, tilted, two_walls

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Rendering
from scenes.recordings.frames import Contacts
from scenes.synthesis.noise import presets as noise


def test_no_noise_is_the_truth():
    np.testing.assert_array_equal(noise.observe_depth(FRONTAL, CAMERA, "none", np.random.default_rng(0)), FRONTAL.depth)


def test_axial_sigma_is_the_published_one():
    assert noise.axial_sigma(np.array(0.4), np.array(0.2)) == pytest.approx(0.0012)
    assert noise.axial_sigma(np.array(1.4), np.array(0.2)) == pytest.approx(0.0031)
    theta = np.deg2rad(75.0)
    steep = 0.0001 / np.sqrt(0.9) * theta**2 / (np.pi / 2 - theta) ** 2
    assert noise.axial_sigma(np.array(0.9), theta) == pytest.approx(0.0012 + 0.0019 * 0.25 + steep)
    assert np.isfinite(noise.axial_sigma(np.array(0.0), np.array(np.pi / 2)))


@pytest.mark.parametrize("angle", [0.0, 40.0, 70.0])
def test_axial_noise_has_the_formula_s_spread(angle):
    view = tilted(np.deg2rad(angle))
    seen = noise.observe_depth(view, CAMERA, replace(OFF, axial=1.0), np.random.default_rng(1))
    incidence = noise.incidence_angles(view, CAMERA)
    expected = noise.axial_sigma(view.depth.astype(float), incidence)
    good = incidence < np.deg2rad(80)
    standard = ((seen - view.depth) / expected)[good]
    assert np.mean(standard) == pytest.approx(0.0, abs=0.02)
    assert np.std(standard) == pytest.approx(1.0, abs=0.02)
    # Independent from pixel to pixel
    assert (
        abs(np.corrcoef(seen[:, 1:].ravel() - view.depth[:, 1:].ravel(), (seen - view.depth)[:, :-1].ravel())[0, 1])
        < 0.05
    )


def test_incidence_is_the_angle_of_the_plane():
    incidence = noise.incidence_angles(tilted(0.5), CAMERA)
    rays = CAMERA.rays()
    normal = np.array([np.sin(0.5), 0, -np.cos(0.5)])
    expected = np.arccos(-(rays @ normal) / np.linalg.norm(rays, axis=2))
    np.testing.assert_allclose(incidence, expected, atol=1e-9)


def test_lateral_noise_moves_the_look_by_its_sigma():
    """On a plane tilted in x, a shift of u pixels changes inverse depth by a known slope."""
    view = tilted(np.deg2rad(50))
    seen = noise.observe_depth(view, CAMERA, replace(OFF, lateral=1.0), np.random.default_rng(2)).astype(float)
    inverse = 1.0 / view.depth.astype(float)
    slope = np.gradient(inverse, axis=1)
    shift = ((1.0 / seen - inverse) / slope)[:, 10:-10]
    expected = noise.lateral_sigma(noise.incidence_angles(view, CAMERA))[:, 10:-10]
    assert np.std(shift / expected) == pytest.approx(1.0, abs=0.02)
    # Facing the camera there is nothing to see of it
    flat = noise.observe_depth(FRONTAL, CAMERA, replace(OFF, lateral=1.0), np.random.default_rng(2))
    np.testing.assert_allclose(flat, FRONTAL.depth, atol=1e-6)


def test_lateral_noise_never_invents_depths_at_a_step():
    seen = noise.observe_depth(two_walls(), CAMERA, replace(OFF, lateral=1.0), np.random.default_rng(3))
    assert set(np.unique(np.round(seen, 5))) == {np.float32(0.6), np.float32(1.0)}
    assert (seen[:, 150:170] != two_walls().depth[:, 150:170]).any()


def test_quantisation_steps_are_those_of_disparity():
    z = np.linspace(0.4, 1.5, 100001)
    read = noise.quantised(z, 570 * 0.075, 0.125)
    steps = 570 * 0.075 / read / 0.125
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-9)
    np.testing.assert_array_less(np.abs(read - z), 0.51 * z**2 * 0.125 / (570 * 0.075) * 1.01)
    assert noise.quantised(np.zeros(3), 40.0, 0.125).max() == 0.0


def test_bias_is_a_gaussian_field_of_the_asked_length():
    rng = np.random.default_rng(4)
    fields = np.stack([noise.smooth_field((200, 240), 30.0, rng) for _ in range(60)])
    assert fields.mean() == pytest.approx(0.0, abs=0.15)
    assert fields.std() == pytest.approx(1.0, abs=0.08)
    for lag in (15, 30, 60):
        expected = np.exp(-(lag**2) / (2 * 30.0**2))
        across = np.mean(fields[:, :, lag:] * fields[:, :, :-lag])
        down = np.mean(fields[:, lag:] * fields[:, :-lag])
        assert across == pytest.approx(expected, abs=0.08)
        assert down == pytest.approx(expected, abs=0.08)
    seen = noise.observe_depth(FRONTAL, CAMERA, replace(OFF, bias=0.002), np.random.default_rng(5))
    assert 0.0008 < np.std(seen - FRONTAL.depth) < 0.0032
    assert np.abs(np.diff(seen, axis=1)).max() < 0.0005


def test_scale_is_one_factor_per_frame():
    rng = np.random.default_rng(6)
    factors = []
    for _ in range(300):
        ratio = noise.observe_depth(FRONTAL, CAMERA, replace(OFF, scale=0.005), rng) / FRONTAL.depth
        assert np.ptp(ratio) < 1e-6
        factors.append(ratio[0, 0])
    assert np.mean(factors) == pytest.approx(1.0, abs=0.001)
    assert np.std(factors) == pytest.approx(0.005, rel=0.12)


def test_grazing_readings_are_lost_by_the_ramp():
    view = tilted(np.deg2rad(74))
    seen = noise.observe_depth(view, CAMERA, noise.DepthNoise(axial=0, lateral=0), np.random.default_rng(7))
    incidence = np.rad2deg(noise.incidence_angles(view, CAMERA))
    for low, high in ((71, 73), (74, 76), (78, 80)):
        band = (incidence > low) & (incidence < high)
        expected = np.mean((incidence[band] - 70) / 15)
        assert np.mean(seen[band] == 0) == pytest.approx(expected, abs=0.03)
    assert (seen[incidence < 70] > 0).all()
    assert (seen[incidence > 85] == 0).all()


def test_random_dropouts_have_their_share():
    seen = noise.observe_depth(FRONTAL, CAMERA, replace(OFF, dropout=0.1), np.random.default_rng(8))
    assert np.mean(seen == 0) == pytest.approx(0.1, abs=0.01)


def test_flying_pixels_stand_between_the_walls_and_only_at_the_step():
    view = two_walls()
    seen = noise.observe_depth(view, CAMERA, replace(OFF, flying=0.5), np.random.default_rng(9))
    changed = seen != view.depth
    assert set(np.nonzero(changed)[1]) == {159, 160}
    assert np.mean(changed[:, 159:161]) == pytest.approx(0.5, abs=0.08)
    between = seen[changed]
    assert between.min() >= 0.6
    assert between.max() <= 1.0
    assert np.mean(between) == pytest.approx(0.8, abs=0.03)


def test_shadow_is_as_wide_as_the_difference_of_disparities():
    """The projector to the right cannot light the strip left of a near wall."""
    view = two_walls(0.6, 1.0, 160)
    width = 570 * 0.075 * (1 / 0.6 - 1 / 1.0)
    dark = noise.projector_shadow(view.depth.astype(float), 570 * 0.075)
    columns = np.nonzero(dark[0])[0]
    assert columns.max() == 159
    assert len(columns) == pytest.approx(width, abs=2.0)
    # A near wall on the left throws its shadow on itself's other side: nothing
    assert not noise.projector_shadow(view.depth[:, ::-1].astype(float), 570 * 0.075).any()
    assert not noise.projector_shadow(FRONTAL.depth.astype(float), 570 * 0.075).any()
    assert (
        noise.observe_depth(view, CAMERA, replace(OFF, shadow=True), np.random.default_rng(0)) == 0
    ).sum() == dark.sum()


def test_pixels_without_a_surface_stay_empty_under_every_preset():
    view = two_walls()
    depth = view.depth.copy()
    depth[:, :80] = 0
    ids = view.ids.copy()
    ids[:, :80] = -1
    normals = view.normals.copy()
    normals[:, :80] = 0
    empty = Rendering(depth, ids, view.names, normals, view.region)
    for name, preset in noise.PRESETS.items():
        if not isinstance(preset.depth, noise.DepthNoise):
            continue  # photographs scenes instead: test_optics
        seen = noise.observe_depth(empty, CAMERA, name, np.random.default_rng(1))
        assert (seen[:, :80] == 0).all()
        assert seen.dtype == np.float32
        assert np.isfinite(seen).all()
        again = noise.observe_depth(empty, CAMERA, name, np.random.default_rng(1))
        np.testing.assert_array_equal(seen, again)


def test_contact_noise_has_its_sigmas():
    n = 4000
    rng = np.random.default_rng(10)
    truth = Contacts(rng.normal(size=(n, 3)), poses.random_unit_vectors(n, rng))
    seen = noise.observe_contacts(truth, noise.TouchNoise(), rng)
    assert np.std(seen.points - truth.points) == pytest.approx(0.9e-3, rel=0.03)
    np.testing.assert_allclose(np.linalg.norm(seen.normals, axis=1), 1.0)
    angle = np.linalg.norm(np.cross(seen.normals, truth.normals), axis=1)
    assert np.sqrt(np.mean(np.arcsin(angle) ** 2) / 2) == pytest.approx(np.deg2rad(5), rel=0.03)
    assert (seen.sigma_point == 0.9e-3).all()
    perfect = noise.observe_contacts(truth, noise.PRESETS["none"].touch, rng)
    np.testing.assert_array_equal(perfect.points, truth.points)
    np.testing.assert_allclose(perfect.normals, truth.normals, atol=1e-15)
    assert (perfect.sigma_point > 0).all()


def test_contact_offset_is_common_and_along_the_normals():
    truth = Contacts(np.zeros((50, 3)), poses.random_unit_vectors(50, np.random.default_rng(0)))
    seen = noise.observe_contacts(truth, noise.TouchNoise(0, 0, 0.001), np.random.default_rng(11))
    along = np.sum(seen.points * truth.normals, axis=1)
    assert np.ptp(along) < 1e-12
    assert abs(along[0]) > 1e-5
    unknown = noise.observe_contacts(Contacts(np.zeros((2, 3))), noise.TouchNoise(), np.random.default_rng(0))
    assert np.isfinite(unknown.points).all()
    assert not unknown.has_normal.any()


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 10**6))
def test_calibration_error_has_its_sigma_per_axis(seed):
    rng = np.random.default_rng(seed)
    twists = np.array([poses.log(noise.camera_from_robot_error(noise.PRESETS["lab"].robot, rng)) for _ in range(800)])
    np.testing.assert_allclose(twists[:, :3].std(axis=0), np.deg2rad(0.3), rtol=0.15)
    np.testing.assert_allclose(twists[:, 3:].std(axis=0), 0.002, rtol=0.15)
    np.testing.assert_array_equal(noise.camera_from_robot_error(noise.RobotNoise(), rng), np.eye(4))


def test_joint_noise_and_presets():
    joints = {f"j{i}": 0.1 * i for i in range(2000)}
    seen = noise.observe_joints(joints, noise.PRESETS["lab"].robot, np.random.default_rng(0))
    assert list(seen) == list(joints)
    assert np.std([seen[k] - joints[k] for k in joints]) == pytest.approx(np.deg2rad(0.3), rel=0.06)
    assert noise.preset("lab") is noise.preset(noise.PRESETS["lab"])
    with pytest.raises(InputError, match="none, clean, lab, harsh, lab-time-of-flight, lab-stereo"):
        noise.preset("loud")
