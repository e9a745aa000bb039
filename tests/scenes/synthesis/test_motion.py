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
    with pytest.raises(InputError, match="carry, turn, slip, leave"):
        make("fly", 2)
