"""Synthetic recordings: the asked occlusion, exact truth, errors of the asked kind, the same bits again."""

from dataclasses import replace

import igl
import numpy as np
import pytest

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.synthesis import library
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.noise.presets import PRESETS, NoisePreset, RobotNoise
from scenes.synthesis.recording import SynthesisSettings, synthesize, synthesize_frames

SETTINGS = SynthesisSettings(mask=True, rgb=False)
EXACT = PRESETS["none"]


def hidden_share(model, frame):
    """Measured again from the mask: the object's visible pixels against those it would have alone."""
    alone = Renderer({"object": (model.vertices, model.faces)}).render(
        frame.camera, {"object": frame.camera_from_object_truth}
    )
    return 1 - frame.mask.sum() / alone.mask("object").sum()


def surface_distance(model, points):
    return igl.signed_distance(np.atleast_2d(points), model.vertices, model.faces)[0]


@pytest.mark.parametrize("name", ["mug", "cylinder"])
@pytest.mark.parametrize("asked", [0.0, 0.3, 0.6, 0.8])
def test_a_hand_hides_the_asked_share(name, asked):
    model = library.make(name)
    frame = synthesize_frames(model, five_finger_hand(), occlusion=asked, noise=EXACT, seed=3, settings=SETTINGS)[0]
    assert hidden_share(model, frame) == pytest.approx(asked, abs=0.03)
    assert len(frame.contacts) >= 3


@pytest.mark.parametrize("name", ["drill", "bottle", "wine_glass", "bust"])
@pytest.mark.parametrize("asked", [0.0, 0.3, 0.6, 0.8])
def test_loose_fingers_hide_the_asked_share(name, asked):
    model = library.make(name)
    frame = synthesize_frames(model, occlusion=asked, noise=EXACT, seed=1, settings=SETTINGS)[0]
    assert hidden_share(model, frame) == pytest.approx(asked, abs=0.03)
    assert frame.hand is None
    assert frame.joints is None
    assert len(frame.contacts) == 5


def test_a_skin_feels_the_surface_around_each_fingertip():
    model = library.make("cylinder")
    skin = replace(SETTINGS, contacts_a_finger=6, skin_reach=0.005)
    one, several = (
        synthesize_frames(model, five_finger_hand(), occlusion=0.5, noise=EXACT, seed=7, settings=settings)[0]
        for settings in (SETTINGS, skin)
    )
    assert np.array_equal(one.camera_from_object_truth, several.camera_from_object_truth)
    fingers = one.contacts.sensors
    assert sorted(several.contacts.sensors) == sorted(6 * list(fingers))
    local = poses.apply(poses.inverse(several.camera_from_object_truth), several.contacts.points)
    assert np.abs(surface_distance(model, local)).max() < 5e-4
    for name, point, normal in zip(fingers, one.contacts.points, one.contacts.normals, strict=True):
        of = np.array(several.contacts.sensors) == name
        apart = np.linalg.norm(several.contacts.points[of] - point, axis=1)
        assert 0.001 < apart.max() < 0.005
        assert (several.contacts.normals[of] @ normal > 0.55).all()


@pytest.fixture(scope="module")
def exact_frame():
    return synthesize_frames(
        library.make("cylinder"), five_finger_hand(), occlusion=0.5, touch=("point", "wrench"), noise=EXACT, seed=7,
        settings=SETTINGS,
    )[0]  # fmt: skip


def test_without_noise_everything_agrees(exact_frame):
    model, hand = library.make("cylinder"), five_finger_hand()
    frame = exact_frame
    object_from_camera = poses.inverse(frame.camera_from_object_truth)
    pixels = frame.camera.back_project(frame.depth, frame.mask)
    assert np.abs(surface_distance(model, poses.apply(object_from_camera, pixels))).max() < 2e-4  # 0.1 mm depth steps
    assert np.abs(surface_distance(model, poses.apply(object_from_camera, frame.contacts.points))).max() < 1.5e-4
    # The contacts are on the fingertips that the hand's own kinematics gives
    for name, point in zip(frame.contacts.sensors, frame.contacts.points):
        sensor = frame.world_from_hand @ hand.hand_from_sensor(frame.joints)[name]
        assert np.linalg.norm(sensor[:3, 3] - point) == pytest.approx(hand.sensors[name].radius, abs=2e-4)
    vertices, faces, _ = hand.mesh(frame.joints)
    seen = Renderer({"hand": (vertices, faces)}).render(frame.camera, {"hand": frame.world_from_hand})
    front = (seen.ids == 0) & (frame.depth > 0)
    assert np.median(np.abs(frame.depth - seen.depth)[front]) < 1e-4


def test_wrenches_are_those_of_the_contacts(exact_frame):
    hand = five_finger_hand()
    assert {w.sensor for w in exact_frame.wrenches} == set(exact_frame.contacts.sensors)
    for wrench in exact_frame.wrenches:
        row = exact_frame.contacts.sensors.index(wrench.sensor)
        camera_from_sensor = exact_frame.world_from_hand @ hand.hand_from_sensor(exact_frame.joints)[wrench.sensor]
        local = exact_frame.contacts.take([row]).moved(poses.inverse(camera_from_sensor))
        twist = wrench.torque - np.cross(local.points[0], wrench.force)
        # the rest is about the normal, and no more than friction can twist
        np.testing.assert_allclose(np.cross(twist, local.normals[0]), 0.0, atol=1e-9)
        assert 1e-7 < np.linalg.norm(twist) <= 0.5 * 5.0 * 0.001
        pressing = wrench.force @ local.normals[0]
        slip = np.linalg.norm(wrench.force - pressing * local.normals[0])
        assert 1.0 <= pressing <= 5.0
        assert slip <= 0.5 * pressing
        # It presses into the fingertip: against the direction from its centre to the contact
        assert wrench.force @ local.points[0] < 0


def test_the_prior_is_off_by_exactly_what_was_said(exact_frame):
    model = library.make("cylinder")
    delta = poses.difference(exact_frame.prior, exact_frame.camera_from_object_truth, model.centroid)
    assert np.linalg.norm(delta[:3]) == pytest.approx(np.deg2rad(16.0), abs=1e-9)
    assert np.linalg.norm(delta[3:]) == pytest.approx(0.033, abs=1e-12)


def test_calibration_moves_hand_and_contacts_together():
    model, hand = library.make("cylinder"), five_finger_hand()
    robot = RobotNoise(np.deg2rad(2.0), 0.01, 0.0)
    shaken = NoisePreset("shaken", EXACT.depth, EXACT.touch, robot)
    frame = synthesize_frames(model, hand, occlusion=0.5, noise=shaken, seed=2, settings=SETTINGS)[0]
    sensors = hand.hand_from_sensor(frame.joints)
    local = frame.contacts.moved(poses.inverse(frame.world_from_hand))
    for name, point in zip(local.sensors, local.points):
        assert np.linalg.norm(sensors[name][:3, 3] - point) == pytest.approx(hand.sensors[name].radius, abs=2e-4)
    in_object = poses.apply(poses.inverse(frame.camera_from_object_truth), frame.contacts.points)
    assert np.abs(surface_distance(model, in_object)).max() > 1e-3


def test_joint_errors_move_the_contacts_with_their_fingers():
    model, hand = library.make("cylinder"), five_finger_hand()
    loose = NoisePreset("loose", EXACT.depth, EXACT.touch, RobotNoise(0.0, 0.0, np.deg2rad(3.0)))
    frame = synthesize_frames(model, hand, occlusion=0.5, noise=loose, seed=2, settings=SETTINGS)[0]
    sensors = hand.hand_from_sensor(frame.joints)
    local = frame.contacts.moved(poses.inverse(frame.world_from_hand))
    for name, point in zip(local.sensors, local.points):
        assert np.linalg.norm(sensors[name][:3, 3] - point) == pytest.approx(hand.sensors[name].radius, abs=2e-4)
    in_object = poses.apply(poses.inverse(frame.camera_from_object_truth), frame.contacts.points)
    assert 5e-4 < np.abs(surface_distance(model, in_object)).max() < 0.02


def same(a, b):
    np.testing.assert_array_equal(a.depth, b.depth)
    np.testing.assert_array_equal(a.contacts.points, b.contacts.points)
    np.testing.assert_array_equal(a.camera_from_object_truth, b.camera_from_object_truth)
    np.testing.assert_array_equal(a.prior, b.prior)


def test_a_frame_depends_on_seed_and_index_only():
    model = library.make("hammer")
    two = synthesize_frames(model, frames=2, occlusion=0.4, seed=11, settings=SETTINGS)
    one = synthesize_frames(model, frames=1, occlusion=0.4, seed=11, settings=SETTINGS)
    same(two[0], one[0])
    assert np.abs(two[0].camera_from_object_truth - two[1].camera_from_object_truth).max() > 0.01
    other = synthesize_frames(model, frames=1, occlusion=0.4, seed=12, settings=SETTINGS)
    assert np.abs(other[0].camera_from_object_truth - one[0].camera_from_object_truth).max() > 0.01


def test_a_grasp_frame_is_the_same_again():
    args = (library.make("mug"), five_finger_hand())
    same(*(synthesize_frames(*args, occlusion=0.5, seed=4, settings=SETTINGS)[0] for _ in range(2)))


def test_the_background_is_behind_and_can_be_left_out():
    model = library.make("mug")
    frame = synthesize_frames(model, occlusion=0.0, noise=EXACT, seed=5, settings=SETTINGS)[0]
    assert (frame.depth > 0).mean() > 0.99
    assert frame.depth[~frame.mask].min() > frame.camera_from_object_truth[2, 3] - model.radius
    bare = synthesize_frames(
        model, occlusion=0.0, noise=EXACT, seed=5, settings=replace(SETTINGS, background=False, rgb=True, mask=False)
    )[0]
    assert (bare.depth[~frame.mask] == 0).all()
    assert bare.mask is None
    assert bare.rgb.shape == (480, 640, 3)


def test_a_written_capture_gives_the_same_frames(tmp_path):
    model, hand = library.make("cylinder"), five_finger_hand()
    args = {"occlusion": 0.4, "touch": ("point", "wrench"), "noise": "lab", "seed": 6}
    settings = replace(SETTINGS, rgb=True)
    capture = synthesize(tmp_path / "can", model, hand, settings=settings, **args)
    kept = synthesize_frames(model, hand, settings=settings, **args)[0]
    read = next(iter(capture))
    np.testing.assert_allclose(read.depth, kept.depth, atol=1e-7)
    np.testing.assert_array_equal(read.rgb, kept.rgb)
    np.testing.assert_array_equal(read.mask, kept.mask)
    np.testing.assert_allclose(read.contacts.points, kept.contacts.points, atol=1e-9)
    np.testing.assert_allclose(read.camera_from_object_truth, kept.camera_from_object_truth, atol=1e-9)
    np.testing.assert_allclose(read.prior, kept.prior, atol=1e-9)
    np.testing.assert_allclose(read.world_from_hand, kept.world_from_hand, atol=1e-9)
    assert read.joints == pytest.approx(kept.joints, abs=1e-9)
    assert len(read.wrenches) == len(kept.wrenches)
    assert capture.model.symmetries.axes


def test_without_touch_there_are_no_contacts():
    frame = synthesize_frames(library.make("box"), occlusion=0.2, touch=(), seed=1, settings=SETTINGS)[0]
    assert len(frame.contacts) == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"occlusion": 1.2}, "0 to 0.97"),
        ({"frames": 0}, "at least 1"),
        ({"touch": ("smell",)}, "'smell'"),
        ({"touch": ("array",)}, "fingertips measure for 'array'"),
        ({"touch": ("wrench",)}, "fingertips measure for 'wrench'"),
        ({"occluders": "object+fog"}, "object.fog"),
        ({"motion": "carry"}, "a hand that carries"),
        ({"noise": "loud"}, "harsh"),
        ({"occluders": "hand"}, "got none"),
        ({"occluders": "fog"}, "'fog'"),
    ],
)
def test_bad_arguments_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        synthesize_frames(library.make("mug"), **change)


def test_an_occlusion_out_of_reach_says_what_could_be_reached():
    short = replace(SETTINGS, grasps=1, foregrounds=(0.7,), climb_foregrounds=(0.7,))
    with pytest.raises(InputError, match=r"got 0\.97; 1 grasps reached 0\.\d\d to 0\.\d\d"):
        synthesize_frames(library.make("hammer"), five_finger_hand(), occlusion=0.97, seed=1, settings=short)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "wanted"), [("drill", 0.8), ("bust", 0.9)])
def test_shares_that_chance_does_not_meet_are_walked_to(name, wanted):
    model = library.make(name)
    settings = replace(SETTINGS, mask=True, grasps=2, foregrounds=(0.7,))
    frame = synthesize_frames(model, five_finger_hand(), 1, wanted, seed=6, noise="none", settings=settings)[0]
    assert hidden_share(model, frame) == pytest.approx(wanted, abs=0.03)
