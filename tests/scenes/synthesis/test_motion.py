"""Sequences: smooth, with truth in every frame, slips that keep the fingers on the surface, and a way out of view."""

from itertools import pairwise

import igl
import numpy as np
import pytest

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.synthesis import library
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.noise.presets import PRESETS
from scenes.synthesis.recording import SynthesisSettings, synthesize, synthesize_frames

SMALL = SynthesisSettings(mask=True, rgb=False)
TINY = SynthesisSettings(camera=SynthesisSettings().camera.scaled(0.25), mask=True, rgb=False)
MODEL = library.make("cylinder")


def make(motion, frames, **change):
    args = {"occlusion": 0.4, "noise": PRESETS["none"], "seed": 7, "settings": SMALL, **change}
    return synthesize_frames(MODEL, five_finger_hand(), frames, motion=motion, **args)


def hold(frame):
    return poses.inverse(frame.world_from_hand) @ frame.camera_from_object_truth


@pytest.mark.parametrize("motion", ["carry", "turn"])
def test_a_carried_object_moves_smoothly_with_the_hand(motion):
    frames = make(motion, 16)
    for frame in frames:
        np.testing.assert_allclose(hold(frame), hold(frames[0]), atol=1e-9)
    steps = np.array(
        [
            poses.difference(b.camera_from_object_truth, a.camera_from_object_truth, MODEL.centroid)
            for a, b in pairwise(frames)
        ]
    )
    assert np.linalg.norm(steps[:, 3:], axis=1).max() < 0.008
    assert np.abs(np.diff(steps, axis=0)).max() < 0.01
    angle = np.linalg.norm(steps[:, :3], axis=1)
    assert angle.max() > (0.02 if motion == "turn" else 0.005)
    assert np.linalg.norm(steps[0]) < 0.3 * np.linalg.norm(steps[-1])  # from rest
    assert [f.prior is not None for f in frames] == [True] + [False] * 15
    assert all(f.mask.any() for f in frames)


def test_slips_happen_inside_the_hand_and_fingers_stay_on_the_surface(tmp_path):
    capture = synthesize(
        tmp_path / "slip", MODEL, five_finger_hand(), 45, 0.4, ("point",), PRESETS["none"], 7, settings=SMALL,
        motion="slip",
    )  # fmt: skip
    notes = capture.manifest.notes["motion"]
    assert notes["kind"] == "slip"
    assert notes["slips"]
    frames = list(capture)
    slip = notes["slips"][0]
    before, after = frames[slip["first"] - 1], frames[slip["last"]]
    delta = poses.difference(hold(after), hold(before), MODEL.centroid)
    assert np.rad2deg(np.linalg.norm(delta[:3])) == pytest.approx(slip["rotation_deg"], abs=0.01)
    assert 1e3 * np.linalg.norm(delta[3:]) == pytest.approx(slip["translation_mm"], abs=0.01)
    np.testing.assert_allclose(hold(frames[slip["first"] - 1]), hold(frames[0]), atol=1e-6)
    for frame in (before, after):
        points = poses.apply(poses.inverse(frame.camera_from_object_truth), frame.contacts.points)
        assert len(points) >= 2
        assert np.abs(igl.signed_distance(points, MODEL.vertices, MODEL.faces)[0]).max() < 1.5e-4
        hand = frame.hand.points_on_surface(frame.joints)
        seen = poses.apply(poses.inverse(hold(frame)), hand)
        assert igl.signed_distance(seen, MODEL.vertices, MODEL.faces)[0].min() > -1e-4


def test_an_object_leaves_the_view_and_comes_back():
    frames = make("leave", 9)
    seen = np.array([f.mask.sum() for f in frames])
    assert seen[4] == 0
    assert seen[0] > 300
    assert seen[-1] == pytest.approx(seen[0], rel=0.25)  # it has turned a little
    assert all(f.camera_from_object_truth is not None for f in frames)


def test_one_robot_has_the_same_errors_in_all_frames():
    frames = make("carry", 4, noise="lab")
    error = [f.world_from_hand @ poses.inverse(f.camera_from_object_truth @ poses.inverse(hold(f))) for f in frames]
    assert all(np.allclose(e, error[0], atol=1e-9) for e in error)
    assert frames[0].joints == frames[3].joints
    truth = make("carry", 4)
    shifts = [f.world_from_hand @ poses.inverse(t.world_from_hand) for f, t in zip(frames, truth)]
    assert np.linalg.norm(shifts[0] - np.eye(4)) > 1e-4
    np.testing.assert_allclose(shifts[3], shifts[0], atol=1e-9)
    # independent frames of one robot share the calibration; the noise of pixels differs
    one = SynthesisSettings(rgb=False, one_robot=True)
    a, b = make(None, 2, noise="lab", settings=one)
    assert np.abs(a.depth - b.depth).max() > 0


def test_a_sequence_is_the_same_again_and_bad_kinds_are_refused():
    a, b = make("turn", 2, noise="lab"), make("turn", 2, noise="lab")
    np.testing.assert_array_equal(a[1].depth, b[1].depth)
    np.testing.assert_array_equal(a[1].contacts.points, b[1].contacts.points)
    with pytest.raises(InputError, match="carry, turn, slip, slide"):
        make("fly", 2)


def test_an_object_slides_under_fingers_that_stand_still(tmp_path):
    capture = synthesize(
        tmp_path / "slide", MODEL, five_finger_hand(), 24, 0.4, ("point",), PRESETS["none"], 7, settings=TINY,
        motion="slide",
    )  # fmt: skip
    notes = capture.manifest.notes["motion"]
    frames = list(capture)
    slip = notes["slips"][0]
    before, after = frames[slip["first"] - 1], frames[slip["last"]]
    assert before.joints == after.joints
    delta = poses.difference(hold(after), hold(before), MODEL.centroid)
    assert np.rad2deg(np.linalg.norm(delta[:3])) == pytest.approx(slip["rotation_deg"], abs=0.01)
    points = poses.apply(poses.inverse(after.camera_from_object_truth), after.contacts.points)
    assert np.abs(MODEL.field.distance(points)).max() < 0.0005
    tips = poses.apply(poses.inverse(hold(after)), before.contacts.moved(poses.inverse(before.world_from_hand)).points)
    assert np.abs(MODEL.field.distance(tips)).max() < 0.003  # the fingertips have only given way


def test_a_hand_lets_go_and_takes_the_object_otherwise():
    frames = make("regrasp", 18, settings=TINY)
    touching = [len(f.contacts) for f in frames]
    assert touching[0] >= 2
    assert touching[-1] >= 2
    assert 0 in touching
    delta = poses.difference(hold(frames[-1]), hold(frames[0]), MODEL.centroid)
    assert np.linalg.norm(delta[:3]) * MODEL.radius + np.linalg.norm(delta[3:]) > 0.003
    moved = [
        np.linalg.norm(poses.difference(b.camera_from_object_truth, a.camera_from_object_truth, MODEL.centroid)[3:])
        for a, b in pairwise(frames)
    ]
    assert max(moved) < 0.01  # something else holds the object while it is let go


def test_a_hand_closes_around_an_object_at_rest():
    frames = make("close", 14, settings=TINY)
    assert len(frames[0].contacts) == 0
    assert len(frames[-1].contacts) >= 2
    np.testing.assert_allclose(frames[2].camera_from_object_truth, frames[0].camera_from_object_truth, atol=1e-9)
    assert frames[0].joints != frames[5].joints


def test_a_camera_moves_while_hand_and_object_rest():
    frames = make("camera", 8, settings=TINY)
    world = [poses.inverse(f.camera_from_world) @ f.camera_from_object_truth for f in frames]
    np.testing.assert_allclose(world[-1], world[0], atol=1e-9)
    np.testing.assert_allclose(frames[-1].world_from_hand, frames[0].world_from_hand, atol=1e-9)
    assert not np.allclose(frames[-1].camera_from_world, np.eye(4), atol=1e-3)
    local = poses.apply(poses.inverse(world[-1]), frames[-1].contacts.points)
    assert np.abs(MODEL.field.distance(local)).max() < 2e-4  # contacts are told in the world


def test_a_camera_that_moves_is_written_and_read_in_a_world_that_rests(tmp_path):
    capture = synthesize(tmp_path / "moves", MODEL, five_finger_hand(), 3, 0.3, seed=7, motion="camera", settings=TINY)
    assert capture.world == "robot base"
    frames = list(capture)
    assert not np.allclose(frames[-1].camera_from_world, np.eye(4), atol=1e-4)
    world = [poses.inverse(f.camera_from_world) @ f.camera_from_object_truth for f in frames]
    np.testing.assert_allclose(world[-1], world[0], atol=1e-5)


def test_a_fast_shake_smears_the_image():
    frames = make("shake", 8, settings=TINY)
    still = make("carry", 2, settings=TINY)
    # where the hand sweeps along nothing is read
    assert min((f.depth == 0).sum() for f in frames[3:]) > (still[0].depth == 0).sum()


@pytest.mark.parametrize("motion", ["pick", "put"])
def test_a_hand_comes_to_an_object_that_rests_or_leaves_it(motion):
    frames = make(motion, 18, settings=TINY)
    frames = frames[::-1] if motion == "put" else frames  # as if it came
    held = [len(frame.contacts.points) > 0 for frame in frames]
    first = held.index(True)
    assert first >= 10
    assert all(held[first:])
    for frame in frames[:first]:
        np.testing.assert_allclose(frame.camera_from_object_truth, frames[0].camera_from_object_truth, atol=1e-9)
    for frame in frames[first:]:
        np.testing.assert_allclose(hold(frame), hold(frames[-1]), atol=1e-9)
    away = [np.linalg.norm(frame.world_from_hand[:3, 3] - frames[first].world_from_hand[:3, 3]) for frame in frames]
    assert away[0] == pytest.approx(0.12, abs=0.003)
    assert max(np.abs(np.diff(away[: first + 1]))) < 0.025
    moved = poses.difference(
        frames[-1].camera_from_object_truth, frames[first].camera_from_object_truth, MODEL.centroid
    )
    assert np.linalg.norm(moved[3:]) > 0.002
